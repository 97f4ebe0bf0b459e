"""An identifier as an estimator of scikit-learn, for its searches and cross-validations.

`X` is a list of recordings or frames, such as the blocks that `Recording.blocks` cuts, so that no
fold is tested on samples between those that it was fitted to. A recording needs no `y`.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from seatrial.models.errors import ConfigurationError
from seatrial.models.identification import problem as problems
from seatrial.models.identification.validation import combined, prediction, scores
from seatrial.models.recording import recording as recordings
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.configuration.config import build_as
from seatrial.runner.interface.arguments import overrides_of
from seatrial.runner.interface.recordings import Recording
from seatrial.runner.interface.vessel_models import Model
from seatrial.runner.sweeps import in_process
from seatrial.runner.trials.closed_loop import Streams

Recordings: TypeAlias = recordings.Recording | pd.DataFrame | Sequence[Any]
KINDS = (recordings.Recording, pd.DataFrame)


class Estimator(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """An identifier and the vessel it is for, as an estimator of scikit-learn.

    `identifier` is a name of the group, such as `"ls"`, or an `Identifier`; `vessel` the nominal
    vessel by name, path or as a `Vessel`; `seed` that of what is drawn; `**options_` are options of
    the identifier, such as `basis="physical"`, with a double underscore for a dot. `fit` sets the
    identified `model_`, and `identified_`, all that the identifier returned.
    """

    def __init__(
        self,
        identifier: str | problems.Identifier = "auto",
        vessel: str | Path | Model = "milliampere",
        seed: int = 0,
        **options_: object,
    ) -> None:
        self.__dict__.update(identifier=identifier, vessel=vessel, seed=seed, **options_)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return identifier, vessel, seed, and the options that are set."""
        return {key: value for key, value in vars(self).items() if key.strip("_") == key}

    def set_params(self, **params: object) -> Self:
        """Set parameters; an unknown option of the identifier is reported by `fit`."""
        self.__dict__.update(params)
        return self

    def fit(self, X: Recordings, y: None = None) -> Self:
        """Identify the vessel from a recording, or from several with gaps between them.

        Raises SeatrialError for a wrong option, and for data that do not determine the model.
        """
        options = self.get_params()
        identifier, chosen, seed = (options.pop(name) for name in ("identifier", "vessel", "seed"))
        own = {"vessel": chosen}
        if isinstance(identifier, str):
            named = {f"identifier.{name}": value for name, value in options.items()}
            own |= {"identifier": identifier, **named}
        config: Any = in_process.composed(overrides_of(own)).config
        if not isinstance(identifier, str):
            try:
                identifier = replace(identifier, **options)
            except TypeError as error:
                raise ConfigurationError(f"identifier: {error}") from None
        elif config["identifier"].get("selection") == "test":
            raise ConfigurationError("identifier.selection: got test, expected training data")
        else:
            kind: Any = problems.Identifier  # abstract
            identifier = build_as(kind, config["identifier"], "identifier")
        vessel = build_as(VesselParameters, config["vessel"], "vessel")
        nominal, lag, training = vessel.nominal(), vessel.thruster, _joined(X, vessel)
        identifier.check(nominal, lag, True)
        problems.check_needs(identifier.needs(), vessel.name, lag, training)
        # Nothing is held out: what tests a model is not for its identification.
        problem = problems.Problem(training, training, nominal, lag)
        result = identifier.identify(problem, Streams(seed).generator("identifier"))
        self.identified_ = problems.with_interval(identifier, result)
        self.model_ = Model(self.identified_.model, vessel)
        return self

    def predict(self, X: Recordings) -> pd.DataFrame:
        """Predict the motion, anew every 30 s from the measured state; see `Model.predict`."""
        check_is_fitted(self, "model_")
        return self.model_.predict(_joined(X, self.model_.parameters))

    def score(self, X: Recordings, y: None = None) -> float:
        """Return the metric `velocity_r2_restarts`: 1 is perfect, -inf a diverged prediction."""
        check_is_fitted(self, "model_")
        table, vessel = self.model_.table, self.model_.parameters
        predictor = prediction(table, _joined(X, vessel), vessel.thruster)
        ahead = predictor.over("restarts")
        r2 = scores(ahead, predictor.mean_motion()).r2
        return float("-inf") if ahead.diverged else combined(np.split(r2, 2)[1])

    def __sklearn_tags__(self) -> Any:
        """Describe the estimator to scikit-learn: recordings in, and no `y`."""
        tags = super().__sklearn_tags__()
        tags.target_tags.required, tags.input_tags.two_d_array = False, False
        return tags


def _joined(X: Recordings, vessel: VesselParameters) -> recordings.Recording:
    """Return X as one recording, each command filtered from rest unless it was before a cut."""
    listed = [X] if isinstance(X, KINDS) else list(X)
    if not listed or not all(isinstance(each, KINDS) for each in listed):
        kinds = {type(each).__name__ for each in listed} or {"nothing"}
        raise ConfigurationError(f"X: got {', '.join(kinds)}, expected recordings or frames")
    parts = [Recording.from_frame(x) if isinstance(x, pd.DataFrame) else x for x in listed]
    known = [x if x.tau_filtered is not None else x.with_thruster(vessel.thruster) for x in parts]
    return recordings.end_to_end(known)
