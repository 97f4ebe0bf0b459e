"""A vessel by name, from a file, or from numbers: a model that can be identified."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from seatrial.models.errors import ConfigurationError
from seatrial.runner.interface.arguments import text_of
from seatrial.runner.interface.vessel_models import Model

if TYPE_CHECKING:  # what is slow to import
    from seatrial.models.identification.problem import Identifier
    from seatrial.models.vessel import parameters as vessels
    from seatrial.runner.configuration import config
    from seatrial.runner.interface import scikit_learn
    from seatrial.runner.sweeps import in_process
else:
    import lazy_loader

    vessels, config, in_process, scikit_learn = (
        lazy_loader.load(f"seatrial.{name}", suppress_warning=True)
        for name in (
            *("models.vessel.parameters", "runner.configuration.config"),
            *("runner.sweeps.in_process", "runner.interface.scikit_learn"),
        )
    )


class Vessel(Model):
    """A vessel with its nominal model, by name, from a file, or from numbers.

    Args:
        choice: what the command line takes after `vessel=`: a name, the path of a YAML file or
            `run:17`.
        **numbers: without a choice, the options of a vessel: `name`, `dofs`, `inertia`,
            `derivatives`, `force_limits` or `length_m`, ...
    """

    def __init__(self, choice: str | Path | None = None, **numbers: object) -> None:
        node: object = {"_target_": "seatrial.models.vessel.parameters.VesselParameters", **numbers}
        if choice is not None:
            if numbers:
                raise ConfigurationError(f"Vessel: got {choice} and numbers, expected one of them")
            node = in_process.composed([f"vessel={text_of(choice)}"]).config["vessel"]
        parameters = config.build_as(vessels.VesselParameters, node, "vessel")
        super().__init__(parameters.nominal(), parameters, None if choice is None else str(choice))

    def fit(
        self,
        recordings: "scikit_learn.Recordings",
        identifier: "str | Identifier" = "auto",
        **options: object,
    ) -> Model:
        """Identify the vessel from recordings; the options are those of `Estimator`.

        Returns:
            The identified model.
        """
        estimator = scikit_learn.Estimator(identifier, self, **cast(Any, options))
        return estimator.fit(recordings).model_
