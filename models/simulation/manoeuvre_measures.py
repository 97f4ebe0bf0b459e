"""Measures of standard manoeuvres, of simulated and recorded motion, and the criteria of the IMO.

A manoeuvre is executed when the helm has passed half of its first step: in a recording that
instant is found without knowing the order. Alternatives are the `order`, when the helm leaves its
last value, and `full`, when it is over. Lengths are in ship lengths, from the position and course
at that instant; angles in degrees. Signals are linear between samples, extremes those of a
parabola through three samples. Noise of a recorded track is smoothed away before it is measured.

Sources: IMO resolution MSC.137(76) and MSC/Circ.1053; ITTC recommended procedure 7.5-04-02-01.

Measures of spirals: the steady yaw rate over the helm, and the loop of an unstable ship.

In a direct spiral (Dieudonne) the helm is held at a sequence of angles from one side to the other
and back. A ship that is straight-line unstable turns to either side within a range of helm angles,
the loop. In a reverse spiral (Bech) the yaw rate is held and the helm that it needs is observed.
Helm angles are counted positive to the side to which the ship turns with a large helm.

Sources: ITTC recommended procedure 7.5-04-02-01; Fossen (2021), section 15.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.recording.recording import Mask
from seatrial.models.recording.smoothing import MAX_CUTOFF, SIGNALS, lowpass, noise_floor
from seatrial.models.vessel.basis import Array

Execution = Literal["half", "order", "full"]
LEFT, OVER = 0.05, 0.95  # share of a step at which the helm has left its value, and is over
RESTING_SHARE = 0.1  # of its fastest motion, the helm is at rest below


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
        """A signal at a time [s]."""
        return float(np.interp(time_s, self.t, values))

    def part(self, k: slice) -> "Track":
        """Some of the samples."""
        return self.having({name: getattr(self, name)[k] for name in ("t", "helm", *MOTION)})

    def having(self, signals: Mapping[str, Array]) -> "Track":
        """The track with other signals."""
        return replace(self, **signals)  # type: ignore[arg-type]


MOTION = ("north", "east", "psi", "speed")  # the measured signals of a track, beside the helm


@dataclass(frozen=True, eq=False)
class TrackNoise:
    """White noise of the motion of a track, by signal, and the low-pass filters against it."""

    deviation: Mapping[str, float]  # [m, rad, m/s]
    cutoff_hz: Mapping[str, float]
    period_s: float

    @classmethod
    def of(cls, track: Track) -> "TrackNoise":
        """The noise of each signal, as far as it is worth a filter (`noise_floor`)."""
        deviation, cutoffs = dict[str, float](), dict[str, float]()
        start, period = np.arange(len(track.t)) == 0, float(np.median(np.diff(track.t)))
        for name in MOTION:
            floor = noise_floor(getattr(track, name)[:, None], start, period)
            if (cutoff := floor.cutoff_hz) is not None:
                cutoff = min(SIGNALS * cutoff, MAX_CUTOFF * 0.5 / period)
                deviation[name], cutoffs[name] = float(floor.deviation[0]), cutoff
        return cls(deviation, cutoffs, period)

    def smoothed(self, track: Track) -> Track:
        """A track without its noise."""
        return track.having(
            {
                name: lowpass(getattr(track, name), cutoff, self.period_s)
                for name, cutoff in self.cutoff_hz.items()
            }
        )

    def drawn(self, smooth: Track, rng: np.random.Generator) -> Track:
        """What would be left of a smooth track had it been recorded, with noise, and smoothed."""
        noisy = {
            name: getattr(smooth, name) + deviation * rng.standard_normal(len(smooth.t))
            for name, deviation in self.deviation.items()
        }
        return self.smoothed(smooth.having(noisy))


class Turn(NamedTuple):
    """Measures of a turning circle; NaN for what was not reached. Lengths in ship lengths."""

    execute_s: float
    advance: float  # at a change of heading of 90 degrees
    transfer: float
    tactical_diameter: float  # at 180 degrees
    steady_diameter: float  # over the last half turn
    time_90_s: float
    time_180_s: float
    speed_loss: float  # steady speed over that of the approach, subtracted from 1
    yaw_rate_deg_s: float  # steady
    drift_deg: float  # steady, the bow points into the circle
    initial_turning: float  # track at a change of heading of 10 degrees
    residual_rate_deg_s: float  # after a pull-out; NaN without one
    helm_deg: float  # that was executed


class ZigZagMeasures(NamedTuple):
    """Measures of a zig-zag; angles in degrees."""

    execute_s: tuple[float, ...]  # instants at which the helm was put over
    overshoot_deg: tuple[float, ...]
    overshoot_s: tuple[float, ...]  # time from execute to the extreme heading
    initial_turning: float  # track at the ordered change of heading, in ship lengths
    period_s: float  # of a full cycle of the heading; NaN if there is none
    helm_deg: float  # that was executed
    turn_deg: float  # change of heading at which the helm was ordered over


def executions(track: Track, kind: Execution = "half") -> Array:
    """Instants [s] of the steps of the helm.

    Raises RecordingError if the helm does not move.
    """
    times = []
    for (_, start), (k, end) in pairwise(levels(track.helm)):
        if start == end:  # of a random helm, that rests on both sides at the same angle
            continue
        progress = (track.helm - start) / (end - start)
        half = crossing(track.t, progress - 0.5, k)
        if kind == "order":  # where the line through both instants begins
            before = np.flatnonzero(progress[: k + 1] < LEFT)
            left = crossing(track.t, progress - LEFT, int(before[-1]) + 1 if len(before) else k)
            half = left - (half - left) * LEFT / (0.5 - LEFT)
        elif kind == "full":
            after = np.flatnonzero(progress[k:] >= OVER)
            half = crossing(track.t, progress - OVER, k + int(after[0]) if len(after) else k)
        times.append(half)
    if not times:
        raise RecordingError("manoeuvre: the helm does not move, expected at least one step")
    return np.array(times)


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
    bounds = [0, first, *changes.tolist()]
    rate = np.abs(np.gradient(helm))
    resting = rate < RESTING_SHARE * np.max(rate)
    edges = pairwise([*bounds, len(helm)])
    return [
        (a, _rest(helm[a:b], resting[a:b], approach if a == 0 else helm[b - 1])) for a, b in edges
    ]


def _rest(helm: Array, resting: Mask, otherwise: float) -> float:
    """The value at which the helm rests."""
    return float(np.median(helm[resting])) if resting.any() else float(otherwise)


def crossing(t: Array, values: Array, k: int) -> float:
    """Time [s] between samples k - 1 and k at which a signal is zero."""
    if k == 0 or values[k] == values[k - 1]:
        return float(t[k])
    share = values[k - 1] / (values[k - 1] - values[k])
    return float(t[k - 1] + np.clip(share, 0.0, 1.0) * (t[k] - t[k - 1]))


def _reached(track: Track, angle: float, since_s: float, course: float) -> float:
    """Time [s] at which the heading has changed by an angle [rad] of either sign; NaN: never."""
    change = np.abs(track.psi - course) - angle
    inside = np.flatnonzero((track.t > since_s) & (change >= 0.0))
    return crossing(track.t, change, int(inside[0])) if len(inside) else np.nan


def turn(track: Track, kind: Execution = "half") -> Turn:
    """Measures of a turning circle."""
    steps = executions(track, kind)
    start, end = float(steps[0]), float(steps[1]) if len(steps) > 1 else np.inf
    course = track.at(track.psi, start)
    ahead, aside = way_from(track, start, course)
    quarter, half = (_reached(track, a, start, course) for a in (0.5 * np.pi, np.pi))
    over = 1.0 / track.length_m

    def measure(values: Array, time_s: float) -> float:
        return over * track.at(values, time_s) if np.isfinite(time_s) else np.nan

    circle = _last_half_turn(track, start, end)
    before = track.at(track.speed, start)
    rate = np.abs(np.polyfit(track.t[circle], track.psi[circle], 1)[0]) if circle.any() else np.nan
    steady = float(np.mean(track.speed[circle])) if circle.any() else np.nan
    drift = float(np.mean(np.abs(_drift(track)[circle]))) if circle.any() else np.nan
    tenth = _reached(track, np.radians(10.0), start, course)
    return Turn(
        start, measure(ahead, quarter), abs(measure(aside, quarter)), abs(measure(aside, half)),
        2.0 * steady / rate * over, quarter - start, half - start, 1.0 - steady / before,
        float(np.degrees(rate)), float(np.degrees(drift)),
        path_length(track, start, tenth) * over if np.isfinite(tenth) else np.nan,
        _residual_rate(track, end), float(np.degrees(levels(track.helm)[1][1])),
    )  # fmt: skip


def _residual_rate(track: Track, pull_out_s: float) -> float:
    """Yaw rate [deg/s] over the last quarter of the time after a pull-out; NaN without one."""
    last = track.t > track.t[-1] - 0.25 * (track.t[-1] - pull_out_s)
    if not np.isfinite(pull_out_s) or np.count_nonzero(last) < 2:
        return np.nan
    return float(np.degrees(np.polyfit(track.t[last], track.psi[last], 1)[0]))


def _drift(track: Track) -> Array:
    """Heading minus course over ground [rad]."""
    course = np.arctan2(np.gradient(track.east, track.t), np.gradient(track.north, track.t))
    return np.asarray(np.angle(np.exp(1j * (track.psi - course))))


def way_from(track: Track, start_s: float, course: float) -> tuple[Array, Array]:
    """Way along and across the course from the position at a time [m]."""
    north = track.north - track.at(track.north, start_s)
    east = track.east - track.at(track.east, start_s)
    c, s = np.cos(course), np.sin(course)
    return c * north + s * east, c * east - s * north


def _last_half_turn(track: Track, start_s: float, end_s: float) -> Mask:
    """Samples of the last half turn up to a time, after more than a full circle."""
    change = np.abs(track.psi - track.at(track.psi, start_s))
    last = abs(track.at(track.psi, end_s) - track.at(track.psi, start_s))
    if last < 2.0 * np.pi:
        return np.zeros(len(change), dtype=bool)
    return np.asarray((change > last - np.pi) & (track.t <= end_s))


def zigzag(track: Track, kind: Execution = "half", turn_deg: float | None = None) -> ZigZagMeasures:
    """Measures of a zig-zag.

    The initial turning is to the ordered deviation, or to `turn_deg`: a model under the helm of a
    recording has other headings at the orders.

    An overshoot is how far the heading goes beyond the one at which the helm is ordered over. The
    ordered deviations from the course are a whole number of degrees to both sides; the course is
    midway between the headings at two orders, since a recording rarely begins straight on it. The
    deviation that was meant is that of the helm, if it is as near as an order between two samples
    can tell, else the nearest whole number.
    """
    times, orders = executions(track, kind), executions(track, "order")
    switched = np.interp(orders[1:], track.t, track.psi)
    course, deviation = _course(switched, track.at(track.psi, float(times[0])))
    helm = float(np.degrees(levels(track.helm)[1][1]))
    turned_s = np.interp(orders[1:], track.t, np.abs(np.gradient(np.degrees(track.psi), track.t)))
    between = float(np.max(turned_s, initial=0.0) * np.median(np.diff(track.t)))
    ordered = round(abs(helm) if abs(abs(helm) - deviation) <= 0.5 + between else deviation)
    overshoots, delays, extremes = [], [], []
    for begin, end, heading in zip(times[1:], [*times[2:], track.t[-1]], switched, strict=True):
        k = np.flatnonzero((track.t >= begin) & (track.t <= end))
        deviation = np.sign(heading - course) * (track.psi[k] - course)
        peak = int(np.argmax(deviation))
        if len(k) < 3 or peak == len(k) - 1:
            break
        time, value = _vertex(track.t[k], deviation, peak)
        overshoots.append(float(np.degrees(value)) - ordered)
        delays.append(time - float(begin))
        extremes.append(time)
    period = 2.0 * float(np.mean(np.diff(extremes))) if len(extremes) > 1 else np.nan
    start = float(times[0])
    initial = ordered if turn_deg is None else turn_deg
    turned = _reached(track, np.radians(initial), start, track.at(track.psi, start))
    path = path_length(track, start, turned) if len(switched) and np.isfinite(turned) else np.nan
    return ZigZagMeasures(
        tuple(map(float, times)), tuple(overshoots), tuple(delays), path / track.length_m, period,
        helm, float(ordered),
    )  # fmt: skip


def _course(switched: Array, approach: float) -> tuple[float, float]:
    """The course [rad], and the deviation from it [deg] at the orders."""
    if len(switched) > 1:
        pairs = np.stack([switched[:-1], switched[1:]])
        course = float(np.mean(0.5 * np.sum(pairs, axis=0)))
        deviation = float(np.mean(0.5 * np.abs(pairs[1] - pairs[0])))
    else:
        course = approach
        deviation = float(np.abs(switched[0] - course)) if len(switched) else 0.0
    return course, float(np.degrees(deviation))


def _vertex(t: Array, values: Array, k: int) -> tuple[float, float]:
    """Time and value of the extreme of a parabola through three samples about k."""
    if not 0 < k < len(values) - 1:
        return float(t[k]), float(values[k])
    a, b, c = np.polyfit(t[k - 1 : k + 2] - t[k], values[k - 1 : k + 2], 2)
    if a >= 0.0:
        return float(t[k]), float(values[k])
    shift = -b / (2.0 * a)
    return float(t[k] + shift), float(c + 0.5 * b * shift)


def path_length(track: Track, begin_s: float, end_s: float) -> float:
    """Length of the path between two times [m]."""
    way = np.hypot(np.diff(track.north), np.diff(track.east))
    way = np.concatenate([[0.0], np.cumsum(way)])
    return track.at(way, end_s) - track.at(way, begin_s)


class Stop(NamedTuple):
    """Measures of a stop; NaN if the ship does not come to rest."""

    execute_s: float
    head_reach: float  # along the course of the approach
    track_reach: float  # along the path
    deviation: float  # across the course, positive to starboard
    time_s: float  # from the order until the ship does not move ahead
    heading_change_deg: float


class WilliamsonMeasures(NamedTuple):
    """Measures of a Williamson turn at its end."""

    execute_s: float
    offset: float  # across the track of the approach, positive to starboard of it
    heading_error_deg: float  # from the reciprocal of the course
    widest: float  # largest distance from the track


def stop(track: Track, kind: Execution = "half") -> Stop:
    """Measures of a stop; the helm of the track is the order of the engine."""
    start = float(executions(track, kind)[0])
    velocity = [np.gradient(way, track.t) for way in (track.north, track.east)]
    ahead = np.cos(track.psi) * velocity[0] + np.sin(track.psi) * velocity[1]
    still = np.flatnonzero((track.t > start) & (ahead <= 0.0))
    if not len(still):
        return Stop(start, *[np.nan] * 5)
    end = crossing(track.t, ahead, int(still[0]))
    course, over = track.at(track.psi, start), 1.0 / track.length_m
    along, aside = way_from(track, start, course)
    return Stop(
        start, over * track.at(along, end), over * path_length(track, start, end),
        over * track.at(aside, end), end - start,
        float(np.degrees(track.at(track.psi, end) - course)),
    )  # fmt: skip


def williamson(track: Track, kind: Execution = "half") -> WilliamsonMeasures:
    """Measures of a Williamson turn."""
    start = float(executions(track, kind)[0])
    course, over = track.at(track.psi, start), 1.0 / track.length_m
    _, aside = way_from(track, start, course)
    error = np.angle(np.exp(1j * (track.psi[-1] - course - np.pi)))
    return WilliamsonMeasures(
        start,
        over * float(aside[-1]),
        float(np.degrees(error)),
        over * float(np.max(np.abs(aside))),
    )


HELD_SHARE = 0.01  # of its fastest change, a signal is held below
AVERAGED_SHARE = 0.25  # share of a plateau, at its end, that is averaged
MIN_PLATEAUS = 5  # plateaus of a spiral
MIN_PLATEAU_SHARE = 0.2  # of the longest plateau; shorter ones are passages


class Spiral(NamedTuple):
    """Steady states of a spiral in their order, and its measures."""

    helm_deg: tuple[float, ...]
    rate_deg_s: tuple[float, ...]
    residual_rate_deg_s: float  # larger of both branches at helm 0; 0 for a stable ship
    loop_width_deg: float  # of helm


def plateaus(t: Array, signal: Array) -> list[tuple[int, int]]:
    """First and last sample of the times at which a signal is held."""
    change = np.abs(np.gradient(signal, t))
    still = change <= HELD_SHARE * np.max(change, initial=0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    held = [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
    longest = max((t[b] - t[a] for a, b in held), default=0.0)
    return [(a, b) for a, b in held if b > a and t[b] - t[a] >= MIN_PLATEAU_SHARE * longest]


def _settled(track: Track, held: list[tuple[int, int]]) -> tuple[Array, Array]:
    """Helm and yaw rate [rad, rad/s] at the end of every plateau."""
    if len(held) < MIN_PLATEAUS:
        raise RecordingError(f"spiral: got {len(held)} plateaus, expected at least {MIN_PLATEAUS}")
    helm, rate = [], []
    for a, b in held:
        k = slice(b - max(1, int(AVERAGED_SHARE * (b - a))), b + 1)
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
    zero = [(_roots(helm[k], rate[k]) or [np.nan])[0] for k in branches]  # NaN: no sign change
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


def _at_zero(helm: Array, rate: Array) -> float:
    """Rate at helm 0."""
    order = np.argsort(helm)
    return float(np.interp(0.0, helm[order], rate[order]))
