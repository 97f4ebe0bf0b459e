"""The thruster lag out of a recording: the one that makes the filtered force most explicable.

For each natural frequency and damping the command is passed through the lag and regressed on the
basis; the pair with the largest R^2 *of the filtered force* wins,

    maximise mean over dof of 1 - |rest|^2 / |f - mean f|^2,    f = lag(command).

Dividing by the variance of the lack of fit instead would reward a lag that makes the force, and
with it the lack of fit, large. Standard errors of coefficients are those at the lag that was
found. An axis that is hardly excited near the lag's frequency does not tell a lag from inertia.
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.errors import IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import Problem
from seatrial.models.identification.residual import ResidualOptions
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.thruster import SecondOrderLag

SETTLE_S = 10.0  # the lag's state at the start is not known; its effect is gone by then
FREQUENCIES = np.geomspace(0.3, 20.0, 9)  # [rad/s] where the search begins
DAMPINGS = np.geomspace(0.3, 2.0, 4)
NOTHING_LEFT = 1e-12  # share of the force below which a better fit is rounding


@dataclass(frozen=True, eq=False)
class _Search:
    """What does not change while the lag does."""

    options: ResidualOptions
    problem: Problem
    keep: slice
    fitted: Array  # (N, n_dof) force that the nominal model needs
    u: Array  # (N, rank) orthonormal columns of the basis

    def unexplained(self, logs: Array) -> float:
        """Mean over dof of 1 - R^2 of the filtered force, for (log frequency, log damping)."""
        force = self.force(SecondOrderLag(*np.exp(logs)))
        rest = force - self.fitted
        rest -= self.u @ (self.u.T @ rest)
        moves = np.var(force, axis=0) > 0.0
        if not np.any(moves):
            return 1.0
        ratios = np.mean(rest[:, moves] ** 2, axis=0) / np.var(force[:, moves], axis=0)
        return float(np.mean(ratios))

    def force(self, lag: SecondOrderLag) -> Array:
        """Filtered and low-passed command [N, Nm], (N, n_dof)."""
        return self.options.filtered(self.problem.training, lag).force("filtered")[self.keep]


def thruster_of(
    options: ResidualOptions, problem: Problem
) -> tuple[SecondOrderLag | None, tuple[Finding, ...]]:
    """The lag to filter the command with, by `options.thruster`, and what was found of it."""
    if options.thruster == "known":
        return problem.thruster, ()
    if options.thruster == "none":
        return None, ()
    return estimate(options, problem)


def estimate(
    options: ResidualOptions, problem: Problem
) -> tuple[SecondOrderLag, tuple[Finding, ...]]:
    """The lag of the largest R^2, by a grid and then the simplex of Nelder and Mead."""
    from scipy.optimize import minimize  # slow to import

    search = _prepare(options, problem)
    grid = np.array([(np.log(w), np.log(d)) for w in FREQUENCIES for d in DAMPINGS])
    start = grid[int(np.argmin([search.unexplained(point) for point in grid]))]
    found = minimize(
        lambda logs: np.log(search.unexplained(np.clip(logs, -5.0, 6.0)) + NOTHING_LEFT),
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-5, "fatol": 1e-6, "maxiter": 500},
    )
    frequency, damping = (float(value) for value in np.exp(np.clip(found.x, -5.0, 6.0)))
    lag = SecondOrderLag(frequency, damping)
    r2 = 1.0 - search.unexplained(found.x)
    return lag, (
        Finding("thruster_natural_frequency", "all", lag.natural_frequency_rad_s, "rad/s"),
        Finding("thruster_damping", "all", lag.damping),
        Finding("thruster_r2", "all", r2),
    )


def _prepare(options: ResidualOptions, problem: Problem) -> _Search:
    """The basis with cos(psi), sin(psi) beside it, so that a constant force does not mislead."""
    training = problem.training
    any_lag = SecondOrderLag(1.0, 1.0)
    samples = options.samples(training, problem.nominal, any_lag)
    settle = round(SETTLE_S / training.period_s)
    if len(samples) < settle + 2 * len(samples.terms):
        raise IdentificationError(
            f"thruster=estimated: the training part has {len(samples)} samples, expected at "
            f"least {settle + 2 * len(samples.terms)}"
        )
    keep = slice(settle, None)
    columns = np.hstack([samples.phi, samples.heading])[keep]
    size = np.sqrt(np.mean(columns**2, axis=0))
    u, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    fitted = (samples.force - samples.epsilon)[keep]
    return _Search(options, problem, keep, fitted, u[:, s > 1e-10 * s[0]])
