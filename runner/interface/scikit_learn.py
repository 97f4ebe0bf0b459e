"""An identifier as an estimator of scikit-learn, for its searches and cross-validations.

`X` is a list of recordings, frames or arrays, such as the blocks that `Recording.blocks` cuts, so
that no fold is tested on samples between those that it was fitted to. A recording needs no `y`.
"""

from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from seatrial.models.identification.problem import Identifier
from seatrial.models.identification.validation import combined, prediction, scores
from seatrial.runner.interface.models import Model, Recordings, fitted, joined


class Estimator(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """An identifier and the vessel it is for, as an estimator of scikit-learn.

    `identifier` is a name of the group, such as `"ls"`, or an `Identifier`; `vessel` the nominal
    vessel by name, path or as a `Vessel`; `seed` that of what is drawn; `**options_` are options of
    the identifier, such as `basis="physical"`, with a double underscore for a dot. `fit` sets
    `model_`, and `model_.identified` to all that the identifier returned.
    """

    def __init__(
        self, identifier: str | Identifier = "auto", vessel: str | Path | Model = "milliampere",
        seed: int = 0, **options_: object,
    ) -> None:  # fmt: skip
        self.__dict__.update(identifier=identifier, vessel=vessel, seed=seed, **options_)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return identifier, vessel, seed, and the options that are set."""
        return {key: value for key, value in vars(self).items() if key.strip("_") == key}

    def set_params(self, **params: object) -> Self:
        """Set parameters; an unknown option of the identifier is reported by `fit`."""
        self.__dict__.update(params)
        return self

    def fit(self, X: Recordings, y: None = None) -> Self:
        """Identify the vessel from a recording, or from several with gaps between them."""
        options = self.get_params()
        identifier, vessel, seed = (options.pop(name) for name in ("identifier", "vessel", "seed"))
        self.model_ = fitted(X, vessel, identifier, seed, options)
        return self

    def predict(self, X: Recordings) -> pd.DataFrame:
        """Predict the motion, anew every 30 s from the measured state; see `Model.predict`."""
        check_is_fitted(self, "model_")
        return self.model_.predict(joined(X, self.model_.parameters))

    def score(self, X: Recordings, y: None = None) -> float:
        """Return the metric `velocity_r2_restarts`: 1 is perfect, -inf a diverged prediction."""
        check_is_fitted(self, "model_")
        table, vessel = self.model_.table, self.model_.parameters
        predictor = prediction(table, joined(X, vessel), vessel.thruster)
        ahead = predictor.over("restarts")
        r2 = scores(ahead, predictor.mean_motion()).r2
        return float("-inf") if ahead.diverged else combined(np.split(r2, 2)[1])

    def __sklearn_tags__(self) -> Any:
        """Describe the estimator to scikit-learn: recordings in, and no `y`."""
        tags = super().__sklearn_tags__()
        tags.target_tags.required, tags.input_tags.two_d_array = False, False
        return tags
