"""Model error: an acceleration on every axis that stands for the terms which a model lacks.

The equations are in `calibration`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.vessel.basis import Array

CORRELATION_S = 2.0  # T


@dataclass(frozen=True, eq=False)
class ModelError:
    """The second share of the uncertainty, calibrated on what was left out of the estimation."""

    kappa2: float  # the data count by 1 / kappa2 of their information
    force: Array  # lambda (n_dof,)
    scale: float  # k
    mean_square: Array  # m^2 (n_dof,) [(m/s^2)^2, (rad/s^2)^2]
    noise: Array  # (2 n_dof,) of the measured pose and velocity
    share: float = 1.0  # of what was left out, over which the runs did not diverge

    def accelerations(self, rho2: Array, period_s: float, rng: np.random.Generator) -> Array:
        """Accelerations drawn at their full size, k lambda sqrt((m^2 + rho^2) / 2) a.

        Shape (N, n_dof) [m/s^2, rad/s^2], from rho^2 of a run [(m/s^2)^2, (rad/s^2)^2].
        """
        size = np.sqrt(0.5 * (self.mean_square + rho2))
        return self.scale * self.force * size * gauss_markov(rho2.shape, period_s, rng)

    def diagnostics(self, dofs: Sequence[str]) -> tuple[Diagnostic, ...]:
        """The numbers of which the distribution is made."""
        n = len(dofs)
        rows = [
            Diagnostic("model_error_kappa2", "all", self.kappa2),
            Diagnostic("model_error_scale", "all", self.scale),
            Diagnostic("model_error_share", "all", self.share),
        ]
        for name, values in (
            ("model_error_lambda", self.force),
            ("model_error_mean_square", self.mean_square),
            ("noise_pose", self.noise[:n]),
            ("noise_velocity", self.noise[n:]),
        ):
            rows += [Diagnostic(name, dof, float(v)) for dof, v in zip(dofs, values, strict=True)]
        return tuple(rows)


def gauss_markov(shape: tuple[int, ...], period_s: float, rng: np.random.Generator) -> Array:
    """Stationary paths (N, n) of unit variance and correlation time CORRELATION_S.

    a_k = phi a_(k-1) + sqrt(1 - phi^2) w_k, phi = exp(-h / T), a_0 = w_0; `period_s` is h [s].
    """
    phi = np.exp(-period_s / CORRELATION_S)
    white = rng.standard_normal(shape)
    white[1:] *= np.sqrt(1.0 - phi**2)
    bands = np.full((2, len(white)), [[1.0], [-phi]])  # a_k - phi a_(k-1) = white_k
    return np.asarray(scipy.linalg.solve_banded((1, 0), bands, white, overwrite_b=True))
