"""Standard errors and covariance of a fit by prediction.

    theta_hat - theta = sum_k G_k e_k,   G = (J'J)^-1 J'

with the Jacobian J of the predictions and the noise e_k of the states. `white` takes the noise of
each state as white, `stationary` and `hac` take its autocorrelation from what the fit leaves; a
block bootstrap draws that again. A replicate is one Gauss-Newton step from the fit, not a fit of
its own.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.basis import Array
from models.errors import ConfigurationError
from models.identification.free_parameters import FreeParameters
from models.identification.misfit import Fit
from models.identification.problem import Finding
from models.identification.uncertainty import (
    block_bootstrap,
    check_bootstrap,
    hac_variance,
    stationary_variance,
)

Errors = Literal["white", "stationary", "hac"]


@dataclass(frozen=True)
class Uncertainty:
    """How standard errors are found: by `errors`, or from `bootstrap` replicates where given."""

    errors: Errors
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        check_bootstrap(self.bootstrap, self.block_s)
        if self.errors not in ("white", "stationary", "hac"):
            raise ConfigurationError(
                f"errors: got {self.errors!r}, expected white, stationary or hac"
            )

    def of(
        self, free: FreeParameters, found: Fit, step_s: float, rng: np.random.Generator | None
    ) -> tuple[Array, list[Finding]]:
        """Standard errors of the residual table, NaN where nothing is free, and the covariance."""
        m = len(free)
        directions = np.vstack([free.directions, np.eye(m)])
        gain = (directions @ np.linalg.pinv(found.jacobian)).reshape(-1, *found.rest.shape)
        if self.bootstrap is None:
            spread = deviations(gain, found.rest, self.errors)
        else:
            flat = gain.reshape(len(gain), -1)
            length = round(self.block_s / step_s)
            spread = block_bootstrap(
                lambda e: flat @ e.ravel(), found.rest, length, self.bootstrap,
                rng or np.random.default_rng(0),
            )  # fmt: skip
        unknowns = len(found.point) + found.start.size
        spread = spread * np.sqrt(found.rest.size / max(found.rest.size - unknowns, 1))
        free_entries = np.any(free.directions != 0.0, axis=1)
        table = np.where(free_entries, spread[:-m], np.nan).reshape(free.shape)
        return table, covariance_findings(free, found, spread[-m:])


def deviations(gain: Array, rest: Array, errors: Errors) -> Array:
    """Standard deviation of sum_k G_k e_k for gains (n, N, states) and what is left (N, states)."""
    if errors == "hac":
        variance = hac_variance(np.einsum("eks,ks->ke", gain, rest))
    else:
        variance = np.zeros(len(gain))
        for j in range(rest.shape[1]):
            own = np.asarray(gain[:, :, j])
            if errors == "stationary":
                variance += stationary_variance(np.asarray(own.T), rest[:, j])
            else:
                variance += np.sum(own**2, axis=1) * np.mean(rest[:, j] ** 2)
    return np.sqrt(np.maximum(variance, 0.0))


def covariance_findings(free: FreeParameters, found: Fit, deviation: Array) -> list[Finding]:
    """Covariance of every pair of parameters, i and j counted from 1, j up to i.

    The correlations are those of (J'J)^-1, the standard deviations (m,) the reported ones.
    """
    inverse = np.linalg.pinv(found.jacobian.T @ found.jacobian)
    root = np.sqrt(np.diag(inverse))
    covariance = inverse / np.outer(root, root) * np.outer(deviation, deviation)
    found_rows = []
    for i, j in zip(*np.tril_indices(len(free)), strict=True):
        unit, label = (f"{names[i]} {names[j]}" for names in (free.units, free.labels))
        value = float(covariance[i, j])
        found_rows.append(Finding("covariance", "all", value, unit, int(i) + 1, int(j) + 1, label))
    return found_rows
