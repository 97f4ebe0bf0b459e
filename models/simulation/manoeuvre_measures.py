"""Measures of standard manoeuvres, of simulated and recorded motion.

A manoeuvre is executed when the helm has passed half of its first step: in a recording that
instant is found without knowing the order. Signals are linear between samples, extremes those of a
parabola through three samples. The measures have the names of `notation.MEASURES`, with their
units: lengths in ship lengths from the position and course at the execution, angles in degrees.
What was not reached is NaN.

In a direct spiral (Dieudonne) the helm is held at a sequence of angles from one side to the other
and back. A ship that is straight-line unstable turns to either side within a range of helm angles,
the loop. In a reverse spiral (Bech) the yaw rate is held and the helm that it needs is observed.
Helm angles are counted positive to the side to which the ship turns with a large helm.

Sources: IMO resolution MSC.137(76) and MSC/Circ.1053; ITTC recommended procedure 7.5-04-02-01;
Fossen (2021), section 15.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from seatrial.models.errors import RecordingError
from seatrial.models.recording.signals import MAX_CUTOFF, SIGNALS, lowpass, noise_floor
from seatrial.models.vessel.basis import Array

Measures = dict[str, float]
LEFT = 0.05  # share of a step at which the helm has left its value
RESTING_SHARE = 0.1  # of its fastest motion, the helm is at rest below
ROUNDING = 1e-9  # [m, rad, m/s] of equal samples
HELD, REVERSALS = 0.95, 0.1  # shares of changes and their reversals, of a coarsely rounded signal
MOTION = ("north", "east", "psi", "speed")  # the measured signals of a track, beside the helm


@dataclass(frozen=True, eq=False)
class Track:
    """Motion of a manoeuvre, one row a sample; SI units, radians, heading unrolled."""

    t: Array
    north: Array
    east: Array
    psi: Array
    helm: Array
    speed: Array  # over ground
    length_m: float

    def at(self, values: Array, time_s: float) -> float:
        """A signal at a time [s]; NaN at NaN."""
        return float(np.interp(time_s, self.t, values))

    def part(self, k: slice) -> "Track":
        """Some of the samples."""
        return self.having({name: getattr(self, name)[k] for name in ("t", "helm", *MOTION)})

    def having(self, signals: Mapping[str, Array]) -> "Track":
        """The track with other signals."""
        return replace(self, **signals)  # type: ignore[arg-type]


class TrackNoise:
    """The white noise of each signal of a motion that is worth a filter, and its resolution.

    A slow signal that is rounded coarsely, such as a heading to 0.1 degrees, stays at one value for
    many samples; then it is known best where it changes, and a spline leads through these instants.
    """

    def __init__(self, track: Track) -> None:
        start, self.period_s = np.arange(len(track.t)) == 0, float(np.median(np.diff(track.t)))
        self.signals: dict[str, tuple[float, float]] = {}  # deviation, cut-off [Hz]
        self.steps: dict[str, float] = {}
        for name in MOTION:
            values = getattr(track, name)
            floor = noise_floor(values[:, None], start, self.period_s)
            if floor.cutoff_hz is None:
                continue
            changes = np.diff(values)[np.abs(np.diff(values)) > ROUNDING]
            turned = np.count_nonzero(changes[1:] * changes[:-1] < 0.0)
            if turned < REVERSALS * len(changes) and len(changes) < HELD * len(values):
                self.steps[name] = float(np.median(np.abs(changes)))
            else:
                cutoff = min(SIGNALS * floor.cutoff_hz, MAX_CUTOFF * 0.5 / self.period_s)
                self.signals[name] = float(floor.deviation[0]), cutoff

    def smooth(self, track: Track) -> Track:
        """A track without its noise."""
        smooth = {
            name: lowpass(getattr(track, name), cutoff, self.period_s)
            for name, (_, cutoff) in self.signals.items()
        }
        for name, step in self.steps.items():
            values = getattr(track, name)
            k = np.flatnonzero(np.abs(np.diff(values)) > ROUNDING)
            middle = 0.5 * (track.t[k] + track.t[k + 1]), 0.5 * (values[k] + values[k + 1])
            knots = [np.r_[a[0], b, a[-1]] for a, b in zip((track.t, values), middle, strict=True)]
            spline = scipy.interpolate.CubicSpline(*knots)(track.t)
            smooth[name] = np.clip(spline, values - 0.5 * step, values + 0.5 * step)
        return track.having(smooth)

    def draw(self, track: Track, rng: np.random.Generator) -> Track:
        """A smooth track with noise of the same size, or rounded as the recorded one is."""
        noisy = {
            name: getattr(track, name) + deviation * rng.standard_normal(len(track.t))
            for name, (deviation, _) in self.signals.items()
        }
        for name, step in self.steps.items():
            origin = step * rng.random()
            noisy[name] = origin + step * np.round((getattr(track, name) - origin) / step)
        return track.having(noisy)


def executions(track: Track) -> tuple[Array, Array]:
    """Instants [s] of the steps of the helm: at half of each, and where it leaves its last value.

    Raises RecordingError if the helm does not move.
    """
    times, orders = [], []
    for (_, start), (k, end) in pairwise(levels(track.helm)):
        if start == end:  # of a random helm, that rests on both sides at the same angle
            continue
        progress = (track.helm - start) / (end - start)
        half = crossing(track.t, progress - 0.5, k)
        before = np.flatnonzero(progress[: k + 1] < LEFT)
        left = crossing(track.t, progress - LEFT, int(before[-1]) + 1 if len(before) else k)
        times.append(half)
        orders.append(left - (half - left) * LEFT / (0.5 - LEFT))  # on the line through both
    if not times:
        raise RecordingError("manoeuvre: the helm does not move, expected at least one step")
    return np.array(times), np.array(orders)


def levels(helm: Array) -> list[tuple[int, float]]:
    """The values at which the helm rests in turn: first sample past half of the step, and value.

    The helm is to one side, to the other, or amidships; passing amidships between two sides is no
    rest.
    """
    approach = helm[0]
    reach = float(np.max(np.abs(helm - approach)))
    if reach <= 0.0:
        return []
    side = np.sign(helm - approach) * (np.abs(helm - approach) >= 0.5 * reach)
    both = np.min(side) < 0.0 < np.max(side)
    first = int(np.flatnonzero(side)[0])
    sides = np.sign(helm - approach) if both else side
    samples = first + np.flatnonzero(sides[first:] if both else np.ones(len(helm) - first))
    changes = samples[1:][sides[samples[1:]] != sides[samples[:-1]]]
    rate = np.abs(np.gradient(helm))
    resting = rate < RESTING_SHARE * np.max(rate)
    found = []
    for a, b in pairwise([0, first, *changes.tolist(), len(helm)]):
        otherwise = approach if a == 0 else helm[b - 1]
        at_rest = helm[a:b][resting[a:b]]
        found.append((a, float(np.median(at_rest) if len(at_rest) else otherwise)))
    return found


def crossing(t: Array, values: Array, k: int) -> float:
    """Time [s] between samples k - 1 and k at which a signal is zero."""
    if k == 0 or values[k] == values[k - 1]:
        return float(t[k])
    share = values[k - 1] / (values[k - 1] - values[k])
    return float(t[k - 1] + np.clip(share, 0.0, 1.0) * (t[k] - t[k - 1]))


def way_from(track: Track, start_s: float) -> tuple[Array, Array]:
    """Way along and across the course from the position at a time, in ship lengths."""
    north = track.north - track.at(track.north, start_s)
    east = track.east - track.at(track.east, start_s)
    course = track.at(track.psi, start_s)
    c, s = np.cos(course), np.sin(course)
    return (c * north + s * east) / track.length_m, (c * east - s * north) / track.length_m


def _path_length(track: Track, begin_s: float, end_s: float) -> float:
    """Length of the path between two times, in ship lengths."""
    way = np.hypot(np.diff(track.north), np.diff(track.east))
    way = np.concatenate([[0.0], np.cumsum(way)]) / track.length_m
    return track.at(way, end_s) - track.at(way, begin_s)


def _reached(track: Track, angle: float, since_s: float) -> float:
    """Time [s] at which the heading has changed by an angle [rad] to either side."""
    change = np.abs(track.psi - track.at(track.psi, since_s)) - angle
    inside = np.flatnonzero((track.t > since_s) & (change >= 0.0))
    return crossing(track.t, change, int(inside[0])) if len(inside) else np.nan


def turn(track: Track) -> Measures:
    """Measures of a turning circle, whose steady values are those of the last half turn.

    The drift angle is positive, the bow points into the circle. There is a residual yaw rate after
    a pull-out only: over the last quarter of the time after it.
    """
    start, pull_out = map(float, [*executions(track)[0], np.inf][:2])
    ahead, aside = way_from(track, start)
    tenth, quarter, half = (_reached(track, np.radians(a), start) for a in (10.0, 90.0, 180.0))
    change = np.abs(track.psi - track.at(track.psi, start))
    whole = abs(track.at(track.psi, pull_out) - track.at(track.psi, start))
    steady = rate = drift = np.nan
    if whole >= 2.0 * np.pi:
        circle = (change > whole - np.pi) & (track.t <= pull_out)
        rate = abs(float(np.polyfit(track.t[circle], track.psi[circle], 1)[0]))
        steady = float(np.mean(track.speed[circle]))
        course = np.arctan2(np.gradient(track.east, track.t), np.gradient(track.north, track.t))
        drifts = np.abs(np.angle(np.exp(1j * (track.psi - course))))
        drift = float(np.mean(drifts[circle]))
    measures = {
        "helm": float(np.degrees(levels(track.helm)[1][1])),
        "advance": track.at(ahead, quarter),
        "transfer": abs(track.at(aside, quarter)),
        "tactical diameter": abs(track.at(aside, half)),
        "steady diameter": 2.0 * steady / rate / track.length_m,
        "track at 10 deg": _path_length(track, start, tenth),
        "time to 90 deg": quarter - start,
        "time to 180 deg": half - start,
        "speed loss": 100.0 * (1.0 - steady / track.at(track.speed, start)),
        "drift angle": float(np.degrees(drift)),
        "yaw rate": float(np.degrees(rate)),
    }
    last = track.t > track.t[-1] - 0.25 * (track.t[-1] - pull_out)
    if np.isfinite(pull_out) and np.count_nonzero(last) > 1:
        residual = np.polyfit(track.t[last], track.psi[last], 1)[0]
        measures["residual yaw rate"] = float(np.degrees(residual))
    return measures


ORDINALS = ("first", "second", "third", "fourth")  # overshoots of a zig-zag that are measured


def zigzag(
    track: Track, turn_deg: float | None = None, ordered_deg: float | None = None
) -> Measures:
    """Measures of a zig-zag.

    The initial turning is to the ordered deviation, or to `turn_deg`: a model under the helm of a
    recording has other headings at the orders.

    An overshoot is how far the heading goes beyond the one at which the helm is ordered over, its
    time that from the execution to the extreme heading. The ordered deviations from the course are
    a whole number of degrees to both sides; the course is midway between the headings at two
    orders, since a recording rarely begins straight on it. The deviation that was meant is that of
    the helm, if it is as near as an order between two samples can tell, else the nearest whole
    number, unless `ordered_deg` states it.
    """
    times, orders = executions(track)
    start, helm = float(times[0]), float(np.degrees(levels(track.helm)[1][1]))
    switched = np.interp(orders[1:], track.t, track.psi)
    course, deviation = track.at(track.psi, start), 0.0
    if len(switched) > 1:
        course = float(np.mean(0.5 * (switched[:-1] + switched[1:])))
        deviation = float(np.degrees(np.mean(0.5 * np.abs(np.diff(switched)))))
    elif len(switched):
        deviation = float(np.degrees(abs(switched[0] - course)))
    turned_s = np.interp(orders[1:], track.t, np.abs(np.gradient(np.degrees(track.psi), track.t)))
    between = float(np.max(turned_s, initial=0.0) * np.median(np.diff(track.t)))
    meant = round(abs(helm) if abs(abs(helm) - deviation) <= 0.5 + between else deviation)
    ordered = float(meant) if ordered_deg is None else ordered_deg
    measures, extremes = {"helm": helm, "change of heading": ordered}, []
    for i, (begin, end) in enumerate(pairwise([*times[1:], track.t[-1]])):
        k = np.flatnonzero((track.t >= begin) & (track.t <= end))
        deviations = np.sign(switched[i] - course) * (track.psi[k] - course)
        peak = int(np.median(np.flatnonzero(deviations == np.max(deviations))))  # of rounded ones
        if len(k) < 3 or peak == len(k) - 1:
            break
        time, value = _vertex(track.t[k], deviations, peak)
        extremes.append(time)
        if i < len(ORDINALS):
            measures[f"{ORDINALS[i]} overshoot"] = float(np.degrees(value)) - ordered
            measures[f"{ORDINALS[i]} overshoot, time"] = time - float(begin)
    turned = _reached(track, np.radians(ordered if turn_deg is None else turn_deg), start)
    measures["initial turning"] = _path_length(track, start, turned) if len(switched) else np.nan
    measures["period P"] = 2.0 * float(np.mean(np.diff(extremes))) if len(extremes) > 1 else np.nan
    return measures


def _vertex(t: Array, values: Array, k: int) -> tuple[float, float]:
    """Time and value of the extreme of a parabola through three samples about k."""
    if not 0 < k < len(values) - 1:
        return float(t[k]), float(values[k])
    a, b, c = np.polyfit(t[k - 1 : k + 2] - t[k], values[k - 1 : k + 2], 2)
    if a >= 0.0:
        return float(t[k]), float(values[k])
    shift = -b / (2.0 * a)
    return float(t[k] + shift), float(c + 0.5 * b * shift)


def stop(track: Track) -> Measures:
    """Measures of a stop, until the ship does not move ahead; the helm is the engine's order.

    The head reach is along the course of the approach, the lateral deviation positive to
    starboard.
    """
    start = float(executions(track)[0][0])
    velocity = [np.gradient(way, track.t) for way in (track.north, track.east)]
    speed_ahead = np.cos(track.psi) * velocity[0] + np.sin(track.psi) * velocity[1]
    still = np.flatnonzero((track.t > start) & (speed_ahead <= 0.0))
    end = crossing(track.t, speed_ahead, int(still[0])) if len(still) else np.nan
    along, aside = way_from(track, start)
    turned = track.at(track.psi, end) - track.at(track.psi, start)
    return {
        "track reach": _path_length(track, start, end),
        "head reach": track.at(along, end),
        "lateral deviation": track.at(aside, end),
        "time to stop": end - start,
        "change of heading": float(np.degrees(turned)),
    }


def williamson(track: Track) -> Measures:
    """Measures of a Williamson turn at its end; the heading is that of the reciprocal course."""
    start = float(executions(track)[0][0])
    _, aside = way_from(track, start)
    error = np.angle(np.exp(1j * (track.psi[-1] - track.at(track.psi, start) - np.pi)))
    return {
        "offset from the track": float(aside[-1]),
        "error of the heading": float(np.degrees(error)),
        "largest distance from the track": float(np.max(np.abs(aside))),
    }


HELD_SHARE = 0.01  # of its fastest change, a signal is held below
AVERAGED_SHARE = 0.25  # share of a plateau, at its end, that is averaged
MIN_PLATEAUS = 5  # plateaus of a spiral
MIN_PLATEAU_SHARE = 0.2  # of the longest plateau; shorter ones are passages


def plateaus(t: Array, signal: Array) -> list[tuple[int, int]]:
    """First and last sample of the times at which a signal is held."""
    change = np.abs(np.gradient(signal, t))
    still = change <= HELD_SHARE * np.max(change, initial=0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    held = [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
    longest = max((t[b] - t[a] for a, b in held), default=0.0)
    return [(a, b) for a, b in held if b > a and t[b] - t[a] >= MIN_PLATEAU_SHARE * longest]


def steady_states(track: Track, held: Array) -> tuple[Array, Array]:
    """Helm and yaw rate [rad, rad/s] at the end of every plateau of the signal `held`.

    Raises RecordingError if there are too few plateaus for a spiral.
    """
    found = plateaus(track.t, held)
    if len(found) < MIN_PLATEAUS:
        raise RecordingError(f"spiral: got {len(found)} plateaus, expected at least {MIN_PLATEAUS}")
    ends = [slice(b - max(1, int(AVERAGED_SHARE * (b - a))), b + 1) for a, b in found]
    helm = np.array([np.mean(track.helm[k]) for k in ends])
    rate = np.array(
        [np.polyfit(track.t[k] - track.t[k.stop - 1], track.psi[k], 1)[0] for k in ends]
    )
    return helm * np.sign(np.sum(helm * rate)), rate


def spiral(track: Track) -> Measures:
    """Measures of a direct spiral; the width is that between the changes of sign of the rate."""
    helm, rate = steady_states(track, track.helm)
    first = int(np.argmax(np.abs(helm) > 0.999 * np.max(np.abs(helm))))
    side = np.sign(helm[first])
    last = first + int(np.argmin(side * helm[first:]))
    branches = slice(first, last + 1), slice(last, len(helm))
    there, back = ((_roots(helm[k], rate[k]) or [np.nan])[0] for k in branches)
    residual = []
    for k in branches:
        order = np.argsort(helm[k])
        if len(order) > 1:
            residual.append(abs(np.interp(0.0, helm[k][order], rate[k][order])))
    return {
        "residual yaw rate": float(np.degrees(max(residual))),
        "width of the loop": float(np.degrees(side * (back - there))),
    }


def reverse_spiral(track: Track) -> Measures:
    """Measures of a reverse spiral; the width is that of the fold of the helm over the rate."""
    helm, rate = steady_states(track, np.gradient(track.psi, track.t))
    order = np.argsort(rate)
    helm, rate = helm[order], rate[order]
    low, high = helm[rate <= 0.0], helm[rate >= 0.0]
    fold = np.max(low, initial=-np.inf) - np.min(high, initial=np.inf)
    residual = max(map(abs, _roots(rate, helm)), default=0.0)
    return {
        "residual yaw rate": float(np.degrees(residual)),
        "width of the loop": float(np.degrees(max(0.0, fold))),
    }


def _roots(x: Array, y: Array) -> list[float]:
    """Where the line through points changes its sign."""
    points = pairwise(zip(x, y, strict=True))
    return [
        float(a - v * (b - a) / (w - v)) for (a, v), (b, w) in points if v != w and v * w <= 0.0
    ]
