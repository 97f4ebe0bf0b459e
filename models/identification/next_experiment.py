"""What to sail next: the interval of a prediction that is expected after a candidate.

What is known of a model is a normal distribution of its parameters, p = p_hat + B u with standard
normal u. Free runs of the velocities along the motion of a candidate, whose initial velocities are
unknown, depend on u by J, and a prediction z (a measure, the coefficients) by G, a regression over
draws. By Bayes' rule for linear models with normal errors of covariance Sigma (Chaloner and
Verdinelli (1995), section 2)

    I_q = J' Sigma^-1 J,  P = (I + sum_q I_q)^-1,  cov z = G P G'

which is what a fit of free runs (`free_run_fit.py`) leaves open. For terms of a table J is that of
`information.py`, integrated along the motion.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.identification.free_parameters import (
    FreeParameters,
    free_parameters,
    nonzero_labels,
    with_devices,
)
from seatrial.models.identification.free_run_fit import FreeRuns, segments
from seatrial.models.identification.validation import restart_length
from seatrial.models.notation import ACCELERATIONS
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

NORMAL_90 = 1.6449  # half the width of a 90 % interval over the standard deviation
LEAST_DEVIATION = 1e-6  # of a direction of B, relative to the largest
DRAWS, SHARE = 120, 0.25  # of a gradient, and of the deviations that they have
KNOWN_UNITS = ("m", "m^2", "kg/m^3")  # of parameters of devices that nobody doubts
Value = Callable[[Array], Array]  # what is predicted (k,) at u (m,); raises what cannot be done


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known of a model: its parameters (n,), and B (n, m)."""

    free: FreeParameters
    basis: Array

    def at(self, u: Array) -> Vessel:
        """The model at coordinates u (m,); devices stay in their ranges."""
        return self.free.model(self.free.nominal, self.free.values + self.basis @ u)

    def about(self, u: Array) -> "Belief":
        """The same doubt about the model at coordinates u (m,)."""
        values = self.free.values + self.basis @ u
        return Belief(replace(self.free, nominal=self.at(u), values=values), self.basis)

    def gradient(self, value: Value, u: Array) -> tuple[Array, Array]:
        """z (k,) and G = dz/du (k, m) at u (m,), by regression over draws.

        What draws cannot do is left out; raises ConfigurationError if too few are left.
        """
        own = value(u)
        near = SHARE * np.random.default_rng(0).standard_normal((DRAWS + len(u), len(u)))
        change = np.full((len(near), len(own)), np.nan)
        for row, step in zip(change, near, strict=True):
            with suppress(SeatrialError):
                row[:] = value(u + step) - own
        known = np.all(np.isfinite(change), axis=1)
        if np.sum(known) <= len(u):
            raise ConfigurationError(
                f"{np.sum(known)} of {len(near)} models near {self.free.nominal.name} reach what "
                f"is asked for, expected more than {len(u)}"
            )
        return own, np.linalg.lstsq(near[known], change[known], rcond=None)[0].T

    def free_runs(
        self, motion: Recording, lag: SecondOrderLag | None, deviation: Array
    ) -> tuple[Array, Array]:
        """J (N, n_dof, m) of a motion and what p_hat does not explain (N, n_dof) [m/s, rad/s].

        Both without what the initial velocities explain, by least squares over the deviations
        (n_dof,) of errors.
        """
        length_s, size = restart_length(self.free.nominal, motion), np.hypot.reduce(self.basis.T)
        runs = FreeRuns(segments(motion, self.free, lag, None, length_s), size)
        states = len(runs.begin), len(runs.predictor.spread)
        point = runs.point(np.zeros(len(size)), np.zeros(states))
        J, by_start = runs.slopes(point)
        both = np.concatenate([J @ self.basis, point.rest[..., None]], axis=2)
        scale = deviation[:, None]
        left = scale * runs.project(by_start / scale, both / scale)[0].reshape(both.shape)
        return left[..., :-1], left[..., -1]


def information(J: Array, deviation: Array) -> Array:
    """I_q (m, m) of derivatives (N, n_dof, m), for errors with deviations (n_dof,)."""
    weighted = (J / deviation[:, None]).reshape(-1, J.shape[2])
    return np.asarray(weighted.T @ weighted)


def doubted(model: Vessel, doubt: float) -> Belief:
    """A model of whose parameters nothing is known but a doubt, half the 90 % interval over size.

    Accelerations, dimensions and densities are taken as known, and so is what lies at the end of
    its range: it is the form of a law, such as a thrust that is quadratic.
    """
    installed = model.installed
    rows = zip(installed.labels, installed.bounds, installed.parameters, strict=True)
    table = nonzero_labels(model, "free")
    free = with_devices(
        free_parameters(
            model, [label for label, term in table if term.name not in ACCELERATIONS], "free", False
        ),
        [
            label
            for label, bounds, value in rows
            if bounds.low < value < bounds.high and value and bounds.unit not in KNOWN_UNITS
        ],
    )
    return Belief(free, np.diag(np.abs(free.values)) * doubt / NORMAL_90)


def learnt(model: Vessel, draws: Sequence[Vessel], share: float) -> Belief:
    """What draws tell that deviate by `share` of their deviations.

    Raises ConfigurationError if nothing is uncertain.
    """
    terms, devices = draws[0].terms, model.installed.labels
    labels = [f"{dof}.{term.name}" for term in terms for dof in model.dofs] + [*devices]
    values, *drawn = (
        np.concatenate([each.on(terms).theta.ravel(), each.installed.parameters])
        for each in (model, *draws)
    )
    change = (np.array(drawn) - values) / share
    moved = np.any(change != 0.0, axis=0)
    if not np.any(moved):
        raise ConfigurationError(
            f"{model.name}: nothing of the model is uncertain, expected a model with a distribution"
        )
    unsure = [label for label, each in zip(labels, moved, strict=True) if each]
    table = [label for label in unsure if label not in devices]
    free = free_parameters(model.on(terms), table, "free", False)
    free = with_devices(free, [label for label in unsure if label in devices])
    change, size = change[:, moved], np.sqrt(np.mean(change[:, moved] ** 2, axis=0))
    _, deviation, right = np.linalg.svd(change / size / np.sqrt(len(change)), full_matrices=False)
    kept = deviation > LEAST_DEVIATION * deviation[0]
    return Belief(free, size[:, None] * (right[kept].T * deviation[kept]))


@dataclass(frozen=True, eq=False)
class Purpose:
    """What is to be predicted: k numbers with G (k, m) in percent, and what they are in words.

    The width of their intervals is the root mean square, or of `coefficients` the median, since
    some cannot be told at all.
    """

    name: str
    gradient: Array
    text: str = ""

    def width(self, *informations: Array) -> float:
        """Half of the 90 % interval expected after candidates with information (m, m) each [%]."""
        posterior = np.linalg.inv(np.eye(self.gradient.shape[1]) + sum(informations))
        variance = np.einsum("ki,ij,kj->k", self.gradient, posterior, self.gradient)
        widths = NORMAL_90 * np.sqrt(np.maximum(variance, 0.0))
        median = self.name == "coefficients"
        return float(np.median(widths) if median else np.sqrt(np.mean(widths**2)))


def ranked(purpose: Purpose, known: Array, informations: Array, seconds: Array) -> list[int]:
    """Order of candidates by the logarithm of the width that they save in a second, the best first.

    `known` is the information (m, m) of what is chosen already, `informations` (q, m, m) those of
    the candidates, `seconds` their time (q,).
    """
    now, widths = purpose.width(known), [purpose.width(known, told) for told in informations]
    gain = np.log(now / np.maximum(widths, 1e-12 * now)) / seconds
    return [int(number) for number in np.argsort(-gain, kind="stable")]
