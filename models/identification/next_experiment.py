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
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.identification.free_parameters import (
    FreeParameters,
    free_parameters,
    nonzero_labels,
    with_devices,
)
from seatrial.models.identification.free_run_fit import FreeRuns, segments
from seatrial.models.identification.least_squares import triangle
from seatrial.models.identification.validation import restart_length
from seatrial.models.notation import ACCELERATIONS
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

NORMAL_90 = 1.6449  # half the width of a 90 % interval over the standard deviation
LEAST_DEVIATION = 1e-6  # of a direction of B, relative to the largest
DRAWS, SHARE = 120, 0.25  # of a gradient, and of the deviations that they have
MOST, SHORTER = 20, 1e-6  # candidates of a plan, and by how much an exchange shortens it
ALL = "coefficients"  # a purpose: all that are uncertain
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

    The width of their intervals is the root mean square, or of `coefficients` the geometric mean,
    since some cannot be told at all.
    """

    name: str
    gradient: Array
    text: str = ""

    @cached_property
    def _rows(self) -> Array:
        """G' (m, k), or where squares are averaged at most m columns that have the same mean."""
        G = self.gradient
        return (G if self.name == ALL else triangle([G / np.sqrt(len(G))])).T

    def widths(self, informations: Array) -> Array:
        """Half of the 90 % interval (...) that is expected after information (..., m, m) [%]."""
        rows = self._rows
        variance = np.sum(rows * np.linalg.solve(np.eye(len(rows)) + informations, rows), axis=-2)
        geometric = self.name == ALL
        mean = np.exp(np.mean(np.log(variance), -1)) if geometric else np.sum(variance, -1)
        return np.asarray(NORMAL_90 * np.sqrt(mean))

    def width(self, information: Array | float = 0.0) -> float:
        """Half of the interval after all that is known, of one information (m, m)."""
        return float(self.widths(np.asarray(information)))


def ranked(purpose: Purpose, known: Array, told: Array, seconds: Array, target: float) -> list[int]:
    """Order of candidates: first those that are expected to reach the target soonest, together.

    They are found twice, one after the other by what they save in a second, of the purpose down to
    the target or of log det as in a D-optimal design. Then one is left out, or one or two are
    exchanged for a shorter one, as long as the target is still reached (after Fedorov (1972),
    Theory of optimal experiments, chapter 3). The better one is first by the logarithm of the
    width that each saves in a second, and so are the others behind it.

    Args:
        purpose: what is to be predicted.
        known: information (m, m) of what is chosen already.
        told: that of the candidates (q, m, m).
        seconds: their time (q,).
        target: half the 90 % interval that is wanted [%].
    """

    one_more = np.concatenate([np.zeros_like(told[:1]), told])  # or none

    def after(chosen: Sequence[int]) -> Array:
        return np.asarray(known + np.sum(told[[*chosen]], axis=0))

    def reaching(chosen: Sequence[int]) -> NDArray[np.bool_]:
        return purpose.widths(after(chosen) + one_more) <= target

    def saved(now: Array) -> Array:
        return np.asarray(-np.log(np.maximum(purpose.widths(now + one_more), target)))

    def volume(now: Array) -> Array:
        return np.asarray(np.linalg.slogdet(np.eye(len(now)) + now + one_more)[1])

    found = list[list[int]]()
    for value in (saved, volume):
        chosen = list[int]()
        while len(chosen) < MOST and not reaching(chosen)[0]:
            none, *each = value(after(chosen))
            chosen.append(int(np.argmax((each - none) / seconds)))
        while reaching(chosen)[0] and (fewer := _exchanged(chosen, seconds, reaching)):
            chosen = fewer
        found.append(chosen)
    plan = min(found, key=lambda own: (max(purpose.width(after(own)), target), sum(seconds[own])))
    rate = np.log(purpose.width(known) / purpose.widths(known + told)) / seconds
    return sorted(range(len(told)), key=lambda number: (number not in plan, -rate[number]))


def _exchanged(
    chosen: Sequence[int], seconds: Array, reaching: Callable[[Sequence[int]], NDArray[np.bool_]]
) -> list[int]:
    """One or two left out, or exchanged for a shorter one; empty if none can be.

    `reaching` says of a list whether it reaches the target, and with each candidate more, (1 + q,).
    """
    places = range(len(chosen))
    for out in chain(combinations(places, 1), combinations(places, 2)):
        rest = [number for place, number in enumerate(chosen) if place not in out]
        time = sum(seconds[chosen[place]] for place in out)
        alone, *each = reaching(rest)
        shorter = [n for n in np.flatnonzero(each).tolist() if seconds[n] < (1.0 - SHORTER) * time]
        if alone or shorter:
            return rest if alone else [*rest, min(shorter, key=lambda n: seconds[n])]
    return []
