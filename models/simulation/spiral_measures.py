"""Measures of spirals: the steady yaw rate over the helm, and the loop of an unstable ship.

In a direct spiral (Dieudonne) the helm is held at a sequence of angles from one side to the other
and back. A ship that is straight-line unstable turns to either side within a range of helm angles,
the loop. In a reverse spiral (Bech) the yaw rate is held and the helm that it needs is observed.
Helm angles are counted positive to the side to which the ship turns with a large helm.

Sources: ITTC recommended procedure 7.5-04-02-01; Fossen (2021), section 15.1.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.simulation.manoeuvre_measures import Track
from seatrial.models.vessel.basis import Array

STILL = 0.01  # of its fastest change, a signal is held below
SETTLED = 0.25  # share of a plateau, at its end, that is averaged
FEWEST = 5  # plateaus of a spiral
SHORTEST = 0.2  # of the longest plateau; shorter ones are passages


class Spiral(NamedTuple):
    """Steady states of a spiral in their order, and its measures."""

    helm_deg: tuple[float, ...]
    rate_deg_s: tuple[float, ...]
    residual_rate_deg_s: float  # larger of both branches at helm 0; 0 for a stable ship
    loop_width_deg: float  # of helm


def plateaus(t: Array, signal: Array) -> list[tuple[int, int]]:
    """First and last sample of the times at which a signal is held."""
    change = np.abs(np.gradient(signal, t))
    still = change <= STILL * np.max(change, initial=0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    held = [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
    longest = max((t[b] - t[a] for a, b in held), default=0.0)
    return [(a, b) for a, b in held if b > a and t[b] - t[a] >= SHORTEST * longest]


def _settled(track: Track, held: list[tuple[int, int]]) -> tuple[Array, Array]:
    """Helm and yaw rate [rad, rad/s] at the end of every plateau."""
    if len(held) < FEWEST:
        raise RecordingError(f"spiral: got {len(held)} plateaus, expected at least {FEWEST}")
    helm, rate = [], []
    for a, b in held:
        k = slice(b - max(1, int(SETTLED * (b - a))), b + 1)
        helm.append(float(np.mean(track.helm[k])))
        rate.append(float(np.polyfit(track.t[k] - track.t[b], track.psi[k], 1)[0]))
    return np.array(helm), np.array(rate)


def spiral(track: Track) -> Spiral:
    """Measures of a direct spiral; the width is that between the changes of sign of the rate."""
    held = plateaus(track.t, track.helm)
    helm, rate = _settled(track, held)
    helm = helm * np.sign(np.sum(helm * rate))
    first = int(np.argmax(np.abs(helm) > 0.999 * np.max(np.abs(helm))))
    side = np.sign(helm[first])
    turn = first + int(np.argmin(side * helm[first:]))
    branches = (slice(first, turn + 1), slice(turn, len(helm)))
    zero = [_crossing(helm[k], rate[k]) for k in branches]
    residual = [abs(_at_zero(helm[k], rate[k])) for k in branches if len(helm[k]) > 1]
    width = side * (zero[1] - zero[0])
    return Spiral(
        tuple(np.degrees(helm).tolist()),
        tuple(np.degrees(rate).tolist()),
        float(np.degrees(max(residual))),
        float(np.degrees(width)),
    )


def reverse_spiral(track: Track) -> Spiral:
    """Measures of a reverse spiral; the width is that of the fold of the helm over the rate."""
    rate = np.gradient(track.psi, track.t)
    helm, rate = _settled(track, plateaus(track.t, rate))
    helm = helm * np.sign(np.sum(helm * rate))
    order = np.argsort(rate)
    helm, rate = helm[order], rate[order]
    low, high = helm[rate <= 0.0], helm[rate >= 0.0]
    fold = np.max(low, initial=-np.inf) - np.min(high, initial=np.inf)
    roots = [abs(r) for r in _roots(rate, helm)]
    return Spiral(
        tuple(np.degrees(helm).tolist()),
        tuple(np.degrees(rate).tolist()),
        float(np.degrees(max(roots, default=0.0))),
        float(np.degrees(max(0.0, fold))),
    )


def _roots(x: Array, y: Array) -> list[float]:
    """Where the line through points changes its sign."""
    points = pairwise(zip(x, y, strict=True))
    return [
        float(a - v * (b - a) / (w - v)) for (a, v), (b, w) in points if v != w and v * w <= 0.0
    ]


def _crossing(helm: Array, rate: Array) -> float:
    """Helm at which the rate changes its sign; NaN if it does not."""
    roots = _roots(helm, rate)
    return roots[0] if roots else np.nan


def _at_zero(helm: Array, rate: Array) -> float:
    """Rate at helm 0."""
    order = np.argsort(helm)
    return float(np.interp(0.0, helm[order], rate[order]))
