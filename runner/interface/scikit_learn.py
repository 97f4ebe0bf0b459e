"""An identifier with scikit-learn's manners, for its searches and cross-validations.

`X` is a list of recordings: of several trials, or the blocks of time that `Recording.blocks` cuts.
So a fold trains on some recordings and is tested on others, never on samples between those it was
fitted to, which would be nearly copies of them. There is no `y`: a recording holds the motion and
the force.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.problem import (
    Identified,
    Identifier,
    Problem,
    check_needs,
    with_interval,
)
from seatrial.models.identification.validation import combined, prediction, scores
from seatrial.models.recording import recording as recordings
from seatrial.models.recording.recording import end_to_end
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.configuration.config import build_as
from seatrial.runner.interface.arguments import overrides_of, text_of
from seatrial.runner.interface.vessel_models import Model
from seatrial.runner.trials.closed_loop import Streams

if TYPE_CHECKING:
    import pandas as pd
    from sklearn.utils import Tags

    from seatrial.runner.sweeps import in_process
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")
    in_process = lazy_loader.load("seatrial.runner.sweeps.in_process", suppress_warning=True)

Recordings = recordings.Recording | Sequence[recordings.Recording]
OWN = ("identifier", "vessel", "seed")  # parameters that are no options of the identifier
HORIZON = "restarts"


class Estimator:
    """An identifier and the vessel it is for, as an estimator of scikit-learn.

    Parameters
    ----------
    identifier
        Name of an option of the group `identifier`, such as `"ls"`, or an `Identifier` of yours.
    vessel
        The nominal vessel: a name, a path, or a `Vessel`.
    seed
        Seed of the random numbers that an identifier may draw.
    **options_
        Options of the identifier, such as `basis="physical"`; a double underscore stands for a
        dot.

    Attributes
    ----------
    model_ : Model
        The identified model, after `fit`.
    identified_ : Identified
        All that the identifier returned: standard errors, diagnostics, warnings.

    Examples
    --------
    >>> from sklearn.model_selection import GridSearchCV, KFold
    >>> estimator = Estimator("ridge", vessel="milliampere")
    >>> search = GridSearchCV(estimator, {"force": ["commanded", "filtered"]}, cv=KFold(5))
    >>> search.fit(recording.blocks(10, gap_s=2.0))  # doctest: +SKIP
    """

    model_: Model
    identified_: Identified

    def __init__(
        self,
        identifier: str | Identifier = "auto",
        vessel: str | Path | Model = "milliampere",
        seed: int = 0,
        **options_: object,
    ) -> None:
        self.identifier = identifier
        self.vessel = vessel
        self.seed = seed
        self.options = options_

    def get_params(self, deep: bool = True) -> dict[str, object]:
        """Return the parameters: identifier, vessel, seed, and the options that are set."""
        return {**{name: getattr(self, name) for name in OWN}, **self.options}

    def set_params(self, **params: object) -> Self:
        """Set parameters; an unknown option of the identifier is reported by `fit`."""
        for name, value in params.items():
            if name in OWN:
                setattr(self, name, value)
            else:
                self.options = {**self.options, name: value}
        return self

    def fit(self, X: Recordings, y: None = None) -> Self:
        """Identify the vessel.

        Parameters
        ----------
        X
            A recording, or several, which are joined with gaps between them. A known thruster lag
            filters the command of each from rest; `recording.with_thruster(lag)` does so before it
            is cut.
        y
            Not used.

        Returns
        -------
        Estimator
            This estimator, with `model_` and `identified_`.

        Raises
        ------
        SeatrialError
            An option is wrong, or the data do not determine the model.
        """
        vessel, identifier = self._parts()
        nominal, lag = vessel.nominal(), vessel.thruster
        training = _with_lag(X, vessel)
        identifier.check(nominal, lag, True)
        check_needs(identifier.needs(), vessel.name, lag, training)
        # Nothing is held out: what tests a model is not for its identification.
        problem = Problem(training, training, nominal, lag)
        drawn = Streams(self.seed).generator("identifier")
        self.identified_ = with_interval(identifier, identifier.identify(problem, drawn))
        self.model_ = Model(self.identified_.model, vessel)
        return self

    def predict(self, X: Recordings) -> "pd.DataFrame":
        """Predict the motion, anew every 30 s from the measured state; see `Model.predict`."""
        return self._fitted().predict(end_to_end(_listed(X)))

    def score(self, X: Recordings, y: None = None) -> float:
        """Return R^2 of the velocity in predictions of 30 s, the mean over the axes that moved.

        It is the metric `velocity_r2_restarts` of a trial. 1 is perfect, 0 as good as the mean of
        the measured velocity, and -inf a model whose prediction diverges.
        """
        model = self._fitted()
        known = _with_lag(X, model.parameters)
        predictor = prediction(model.table, known, model.parameters.thruster)
        ahead = predictor.over(HORIZON)
        if ahead.diverged:
            return float("-inf")
        return combined(np.split(scores(ahead, predictor.mean_motion()).r2, 2)[1])

    @property
    def coefficients_(self) -> "pd.DataFrame":
        """The identified coefficients by term; see `Model.coefficients`."""
        return self._fitted().coefficients

    def _fitted(self) -> Model:
        if not hasattr(self, "model_"):
            raise ConfigurationError("Estimator: got no model yet, expected fit(recordings) before")
        return self.model_

    def _parts(self) -> tuple[VesselParameters, Identifier]:
        """Return the vessel and the identifier with its options."""
        name = self.identifier if isinstance(self.identifier, str) else "none"
        words = [f"vessel={text_of(self.vessel)}", f"identifier={text_of(name)}"]
        if isinstance(self.identifier, str):
            words += overrides_of({f"identifier.{key}": v for key, v in self.options.items()})
        config = in_process.composed(words).config
        vessel = build_as(VesselParameters, config["vessel"], "vessel")
        if isinstance(self.identifier, str):
            return vessel, _identifier(config["identifier"])
        try:
            return vessel, replace(self.identifier, **self.options)  # type: ignore[type-var]
        except TypeError as error:
            raise ConfigurationError(f"identifier: {error}") from None

    def __sklearn_tags__(self) -> "Tags":
        """Describe the estimator to scikit-learn."""
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=False, multi_output=True),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(two_d_array=False),
            non_deterministic=False,
        )

    def __repr__(self) -> str:
        shown = {"identifier": self.identifier, "vessel": self.vessel, **self.options}
        texts = (
            f"{name}={value.name if isinstance(value, Model) else value!r}"
            for name, value in shown.items()
        )
        return f"Estimator({', '.join(texts)})"


def _identifier(node: object) -> Identifier:
    if isinstance(node, dict) and node.get("selection") == "test":
        raise ConfigurationError(
            "identifier.selection: got test, expected a selection by the training data"
        )
    return build_as(Identifier, node, "identifier")  # type: ignore[type-abstract]


def _listed(X: Recordings) -> list[recordings.Recording]:
    parts = [X] if isinstance(X, recordings.Recording) else list(X)
    if not parts or not all(isinstance(part, recordings.Recording) for part in parts):
        kinds = ", ".join(sorted({type(part).__name__ for part in parts})) or "nothing"
        raise ConfigurationError(f"X: got {kinds}, expected recordings")
    return parts


def _with_lag(X: Recordings, vessel: VesselParameters) -> recordings.Recording:
    """Return the recordings as one, with the command filtered by a known thruster lag.

    One that was filtered before it was cut stays as it is.
    """
    lag = vessel.thruster
    return end_to_end(
        [part if part.tau_filtered is not None else part.with_thruster(lag) for part in _listed(X)]
    )
