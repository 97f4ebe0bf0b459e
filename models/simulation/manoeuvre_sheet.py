"""Measures of standard manoeuvres, simulated or recorded, and the criteria of the IMO for them.

A manoeuvre is executed when the helm has passed half of its first step: in a recording that
instant is found without knowing the order. Signals are linear between samples, extremes those of a
parabola through three samples. The measures have the names of `notation.MEASURES`, with their
units: lengths in ship lengths from the position and course at the execution, angles in degrees.
What was not reached is NaN.

In a direct spiral (Dieudonne) the helm is held at a sequence of angles from one side to the other
and back. A ship that is straight-line unstable turns to either side within a range of helm angles,
the loop. In a reverse spiral (Bech) the yaw rate is held and the helm that it needs is observed.
Helm angles are counted positive to the side to which the ship turns with a large helm.

The criteria hold for a ship of full scale: L / V of a model is multiplied by the square root of its
scale. Limits on turning are for the largest helm, taken to be 30 degrees or more; those on the
overshoot for zig-zags of 10/10 and 20/20.

Sources: IMO resolution MSC.137(76) and MSC/Circ.1053; ITTC recommended procedure 7.5-04-02-01;
Fossen (2021), section 15.1.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy

from seatrial.models.errors import RecordingError
from seatrial.models.notation import MEASURES, PLANAR, Manoeuvre, OrderedManoeuvre
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.signals import lowpass, noise_floor, smoothing_for
from seatrial.models.vessel.basis import Array

Measures = dict[str, float]
MOTION = ("north", "east", "psi", "speed")  # the measured signals of a track, beside the helm
LEFT = 0.05  # share of a step at which the helm has left its value
RESTING_SHARE = 0.1  # of its fastest motion, the helm is at rest below
AMIDSHIPS = 0.1  # of the largest helm, below which it is not to a side
ORDINALS = ("first", "second", "third", "fourth")  # overshoots of a zig-zag that are measured
HELD_SHARE = 0.01  # of its fastest change, a signal is held below
AVERAGED_SHARE = 0.25  # share of a plateau, at its end, that is averaged
MIN_PLATEAUS = 5  # plateaus of a spiral
MIN_PLATEAU_SHARE = 0.2  # of the longest plateau; shorter ones are passages
ROUNDING = 1e-9  # [m, rad, m/s] of equal samples
HELD, REVERSALS = 0.95, 0.1  # shares of changes and their reversals, of a coarsely rounded signal
NOISE_DRAWS, LEVEL = 60, 0.9
# Of the deviations of drawn models: at whole ones a model leaves the curved valley of the fit, and
# the tactical diameters of KVLCC2 spread 1.6 times as far as estimates do.
DEVIATION_SHARE = 0.25
# A diagnostic of a measure that was recorded or predicted: the beginning of its name, and its j.
DIAGNOSTIC = "recorded_manoeuvre_"
COMPARED = ("measured", "nominal model", "identified model", "low", "high")
UNLIMITED = (
    "no limits: MSC.137(76) has them for turns with helm 10 or at least 30, zig-zags of 10/10 and "
    "20/20, and stops"
)
UNSTATED = OrderedManoeuvre()


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

    def first(self, values: Array, after_s: float) -> float:
        """The first time [s] after another at which a signal changes its sign; NaN if none."""
        times = crossings(self.t, values)
        return float(next(iter(times[times > after_s]), np.nan))

    def path(self, begin_s: float, end_s: float) -> float:
        """Length of the path between two times [s], in ship lengths."""
        north, east = (np.diff(x, prepend=x[0]) for x in (self.north, self.east))
        way = np.cumsum(np.hypot(north, east))
        return (self.at(way, end_s) - self.at(way, begin_s)) / self.length_m

    def part(self, k: slice) -> "Track":
        """Some of the samples."""
        parts: dict[str, Any] = {name: getattr(self, name)[k] for name in ("t", "helm", *MOTION)}
        return replace(self, **parts)


def crossings(x: Array, values: Array) -> Array:
    """Where values, linear between those of x, change their sign."""
    step = np.diff(values)
    k = np.flatnonzero((values[1:] * values[:-1] <= 0.0) & (step != 0.0))
    return np.asarray(x[k] - values[k] * np.diff(x)[k] / step[k])


def executions(track: Track) -> tuple[Array, Array]:
    """Instants [s] of the steps of the helm: at half of each, and where it leaves its last value.

    Raises RecordingError if the helm does not move.
    """
    times, orders = [], []
    for (_, start), (k, end) in pairwise(levels(track.helm)):
        if start == end:  # of a random helm, that rests on both sides at the same angle
            continue
        progress = (track.helm - start) / (end - start)
        halves, lefts = (crossings(track.t, progress - share) for share in (0.5, LEFT))
        nearest = halves[np.argmin(np.abs(halves - track.t[k]))]
        half, left = np.clip(nearest, *track.t[k - 1 : k + 1]), lefts[lefts <= nearest][-1]
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
    offset = helm - helm[0]
    reach = float(np.max(np.abs(offset)))
    if reach <= 0.0:
        return []
    side = np.sign(offset) * (np.abs(offset) >= 0.5 * reach)
    first = int(np.flatnonzero(side)[0])
    samples = np.arange(first, len(helm))
    if np.min(side) < 0.0 < np.max(side):
        side = np.sign(offset)
        samples = samples[side[first:] != 0.0]
    changes = samples[1:][np.diff(side[samples]) != 0.0]
    rate = np.abs(np.gradient(helm))
    resting = rate < RESTING_SHARE * np.max(rate)
    found = []
    for a, b in pairwise([0, first, *changes.tolist(), len(helm)]):
        at_rest = helm[a:b][resting[a:b]]
        found.append((a, float(np.median(at_rest) if len(at_rest) else helm[b - 1 if a else 0])))
    return found


def way_from(track: Track, start_s: float) -> tuple[Array, Array]:
    """Way along and across the course from the position at a time, in ship lengths."""
    north = track.north - track.at(track.north, start_s)
    east = track.east - track.at(track.east, start_s)
    course = track.at(track.psi, start_s)
    c, s = np.cos(course), np.sin(course)
    return (c * north + s * east) / track.length_m, (c * east - s * north) / track.length_m


def turn(track: Track) -> Measures:
    """Measures of a turning circle, whose steady values are those of the last half turn.

    The drift angle is positive, the bow points into the circle. There is a residual yaw rate after
    a pull-out only: over the last quarter of the time after it.
    """
    start, pull_out = map(float, [*executions(track)[0], np.inf][:2])
    ahead, aside = way_from(track, start)
    change = np.abs(track.psi - track.at(track.psi, start))
    tenth, quarter, half = (track.first(change - np.radians(a), start) for a in (10, 90, 180))
    whole = abs(track.at(track.psi, pull_out) - track.at(track.psi, start))
    steady = rate = drift = np.nan
    if whole >= 2.0 * np.pi:
        circle = (change > whole - np.pi) & (track.t <= pull_out)
        rate = abs(float(np.polyfit(track.t[circle], track.psi[circle], 1)[0]))
        steady = float(np.mean(track.speed[circle]))
        course = np.arctan2(np.gradient(track.east, track.t), np.gradient(track.north, track.t))
        drift = float(np.mean(np.abs(np.angle(np.exp(1j * (track.psi - course))))[circle]))
    measures = {
        "helm": float(np.degrees(levels(track.helm)[1][1])),
        "advance": track.at(ahead, quarter),
        "transfer": abs(track.at(aside, quarter)),
        "tactical diameter": abs(track.at(aside, half)),
        "steady diameter": 2.0 * steady / rate / track.length_m,
        "track at 10 deg": track.path(start, tenth),
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


def zigzag(track: Track, ordered: float | None = None) -> Measures:
    """Measures of a zig-zag.

    An overshoot is how far the heading goes beyond the one at which the helm is ordered over, its
    time that from the execution to the extreme heading. The ordered deviations from the course are
    a whole number of degrees to both sides; the course is midway between the headings at two
    orders, since a recording rarely begins straight on it. The deviation that was meant is that of
    the helm, if it is as near as an order between two samples can tell, else the nearest whole
    number, unless `ordered` [deg] states it: a model under the helm of a recording has other
    headings at the orders.
    """
    times, orders = executions(track)
    start, helm = float(times[0]), float(np.degrees(levels(track.helm)[1][1]))
    switched, course = np.interp(orders[1:], track.t, track.psi), track.at(track.psi, start)
    if len(switched) > 1:
        course = float(np.mean(0.5 * (switched[:-1] + switched[1:])))
    if ordered is None:
        deviation = float(np.degrees(np.sum(np.abs(switched - course)) / max(len(switched), 1)))
        rate = np.abs(np.gradient(np.degrees(track.psi), track.t))
        fastest = np.max(np.interp(orders[1:], track.t, rate), initial=0.0)
        between = float(fastest * np.median(np.diff(track.t)))
        as_helm = abs(abs(helm) - deviation) <= 0.5 + between
        ordered = float(round(abs(helm) if as_helm else deviation))
    measures, extremes = {"helm": helm, "change of heading": ordered}, []
    for i, (begin, end) in enumerate(pairwise([*times[1:], track.t[-1]])):
        k = np.flatnonzero((track.t >= begin) & (track.t <= end))
        deviations = np.sign(switched[i] - course) * (track.psi - course)
        highest = np.flatnonzero(deviations[k] == np.max(deviations[k]))
        peak = k[int(np.median(highest))]  # of rounded headings that are equal
        if len(k) < 3 or peak == k[-1]:
            break
        near = slice(peak - 1, peak + 2)
        a, b, value = np.polyfit(track.t[near] - track.t[peak], deviations[near], 2)
        shift = -b / (2.0 * a) if a < 0.0 and peak > k[0] else 0.0
        extremes.append(track.t[peak] + shift)
        if i < len(ORDINALS):
            overshoot = f"{ORDINALS[i]} overshoot"
            measures[overshoot] = float(np.degrees(value + 0.5 * b * shift)) - ordered
            measures[f"{overshoot}, time"] = float(extremes[-1] - begin)
    change = np.abs(track.psi - track.at(track.psi, start))
    turned = track.first(change - np.radians(ordered), start)
    measures["initial turning"] = track.path(start, turned) if len(switched) else np.nan
    measures["period P"] = 2.0 * float(np.mean(np.diff(extremes))) if len(extremes) > 1 else np.nan
    return measures


def stop(track: Track) -> Measures:
    """Measures of a stop, until the ship does not move ahead; the helm is the engine's order.

    The head reach is along the course of the approach, the lateral deviation positive to
    starboard.
    """
    start = float(executions(track)[0][0])
    velocity = [np.gradient(way, track.t) for way in (track.north, track.east)]
    end = track.first(np.cos(track.psi) * velocity[0] + np.sin(track.psi) * velocity[1], start)
    along, aside = way_from(track, start)
    turned = track.at(track.psi, end) - track.at(track.psi, start)
    return {
        "track reach": track.path(start, end),
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


def steady_states(track: Track, held: Array) -> tuple[Array, Array]:
    """Helm and yaw rate [rad, rad/s] at the end of every time for which the signal `held` is held.

    Raises RecordingError if there are too few such plateaus for a spiral.
    """
    change = np.abs(np.gradient(held, track.t))
    still = change <= HELD_SHARE * np.max(change)
    runs = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0)).reshape(-1, 2)
    lengths = track.t[runs[:, 1] - 1] - track.t[runs[:, 0]]
    runs = runs[(lengths > 0.0) & (lengths >= MIN_PLATEAU_SHARE * np.max(lengths, initial=0.0))]
    if len(runs) < MIN_PLATEAUS:
        raise RecordingError(f"spiral: got {len(runs)} plateaus, expected at least {MIN_PLATEAUS}")
    ends = [slice(b - 1 - max(1, int(AVERAGED_SHARE * (b - 1 - a))), b) for a, b in runs]
    helm = np.array([np.mean(track.helm[k]) for k in ends])
    rate = np.array([np.polyfit(track.t[k] - track.t[k][-1], track.psi[k], 1)[0] for k in ends])
    return helm * np.sign(np.sum(helm * rate)), rate


def spiral(track: Track) -> Measures:
    """Measures of a direct spiral; the width is that between the changes of sign of the rate."""
    helm, rate = steady_states(track, track.helm)
    first = int(np.argmax(np.abs(helm) > 0.999 * np.max(np.abs(helm))))
    side = np.sign(helm[first])
    last = first + int(np.argmin(side * helm[first:]))
    branches = slice(first, last + 1), slice(last, len(helm))
    there, back = (next(iter(crossings(helm[k], rate[k])), np.nan) for k in branches)
    residual = np.concatenate([crossings(rate[k], helm[k]) for k in branches])
    return _loop(residual, side * (back - there))


def reverse_spiral(track: Track) -> Measures:
    """Measures of a reverse spiral; the width is that of the fold of the helm over the rate."""
    helm, rate = steady_states(track, np.gradient(track.psi, track.t))
    order = np.argsort(rate)
    helm, rate = helm[order], rate[order]
    low, high = helm[rate <= 0.0], helm[rate >= 0.0]
    fold = np.max(low, initial=-np.inf) - np.min(high, initial=np.inf)
    return _loop(crossings(rate, helm), max(0.0, fold))


def _loop(residual: Array, width: float) -> Measures:
    """Measures of a spiral: the yaw rates with the helm amidships, and the width [rad]."""
    return {
        "residual yaw rate": float(np.degrees(np.max(np.abs(residual), initial=0.0))),
        "width of the loop": float(np.degrees(width)),
    }


MEASURED: Mapping[str, Callable[..., Measures]] = {
    kind.__name__: kind for kind in (turn, zigzag, spiral, reverse_spiral, williamson, stop)
}


class SheetEntry(NamedTuple):
    """One line of a sheet; `limit` is the largest value allowed, in the same unit.

    `low` and `high` are the bounds of what a recorded value may be, NaN of a simulated one.
    """

    quantity: str
    value: float
    unit: str  # L: ship lengths
    limit: float | None = None
    low: float = np.nan
    high: float = np.nan

    @property
    def verdict(self) -> Literal["pass", "fail", "not settled"] | None:
        """Whether the value is within its limit; None without a limit or a value."""
        if self.limit is None or not np.isfinite(self.value):
            return None
        if self.low <= self.limit < self.high:
            return "not settled"
        return "pass" if self.value <= self.limit else "fail"


class Sheet(NamedTuple):
    """The measures of one manoeuvre."""

    manoeuvre: Manoeuvre
    entries: tuple[SheetEntry, ...]
    start_s: float  # of the execution; of a spiral that of the track
    length_m: float
    speed_m_s: float  # of the approach
    length_over_speed_s: float  # at full scale

    @property
    def values(self) -> Measures:
        """The values of the quantities by name."""
        return {entry.quantity: entry.value for entry in self.entries}

    @property
    def ordered(self) -> OrderedManoeuvre:
        """What was ordered, as it was stated or found."""
        turn_deg = self.values["change of heading"] if self.manoeuvre == "zigzag" else None
        return OrderedManoeuvre(self.manoeuvre, turn_deg=turn_deg)


class TrackNoise:
    """The white noise of each signal of a motion that is worth a filter, and its resolution.

    A slow signal that is rounded coarsely, such as a heading to 0.1 degrees, stays at one value for
    many samples; then it is known best where it changes, and a spline leads through these instants.
    """

    def __init__(self, track: Track) -> None:
        self.period_s = float(np.median(np.diff(track.t)))
        self.white, self.steps = dict[str, tuple[float, float]](), dict[str, float]()
        for name in MOTION:
            values = getattr(track, name)
            floor = noise_floor(values[:, None], np.arange(len(values)) == 0, self.period_s)
            cutoff_hz = smoothing_for(floor.cutoff_hz, self.period_s).signals_hz
            if cutoff_hz is None:
                continue
            changes = np.diff(values)[np.abs(np.diff(values)) > ROUNDING]
            turned = np.count_nonzero(changes[1:] * changes[:-1] < 0.0)
            if turned < REVERSALS * len(changes) and len(changes) < HELD * len(values):
                self.steps[name] = float(np.median(np.abs(changes)))
            else:
                self.white[name] = float(floor.deviation[0]), cutoff_hz

    def smooth(self, track: Track) -> Track:
        """A track without its noise."""
        smooth: dict[str, Any] = {
            name: lowpass(getattr(track, name), cutoff_hz, self.period_s)
            for name, (_, cutoff_hz) in self.white.items()
        }
        for name, step in self.steps.items():
            values = getattr(track, name)
            k = np.flatnonzero(np.abs(np.diff(values)) > ROUNDING)
            knots = (np.r_[x[0], 0.5 * (x[k] + x[k + 1]), x[-1]] for x in (track.t, values))
            spline = scipy.interpolate.CubicSpline(*knots)(track.t)
            smooth[name] = np.clip(spline, values - 0.5 * step, values + 0.5 * step)
        return replace(track, **smooth)

    def draw(self, track: Track, rng: np.random.Generator) -> Track:
        """A smooth track with noise of the same size, or rounded as the recorded one is."""
        noisy: dict[str, Any] = {
            name: getattr(track, name) + deviation * rng.standard_normal(len(track.t))
            for name, (deviation, _) in self.white.items()
        }
        for name, step in self.steps.items():
            origin = step * rng.random()
            noisy[name] = origin + step * np.round((getattr(track, name) - origin) / step)
        return replace(track, **noisy)


def limits(kind: Manoeuvre, helm_deg: float, turn_deg: float | None, ratio_s: float) -> Measures:
    """The largest values allowed, for L / V [s] at full scale. MSC.137(76), 5.3."""
    if kind == "stop":
        return {"track reach": 15.0}
    if kind == "turn":
        full = {"advance": 4.5, "tactical diameter": 5.0} if helm_deg >= 30.0 else {}
        return full | ({"track at 10 deg": 2.5} if round(helm_deg) == 10 else {})
    if kind != "zigzag" or round(helm_deg) != turn_deg:
        return {}
    if turn_deg == 10.0:
        ratio = float(np.clip(ratio_s, 10.0, 30.0))
        overshoots = {"first overshoot": 5.0 + 0.5 * ratio, "second overshoot": 17.5 + 0.75 * ratio}
        return {**overshoots, "initial turning": 2.5}
    return {"first overshoot": 25.0} if turn_deg == 20.0 else {}


def track_of(recording: Recording, helm: str, length_m: float) -> Track:
    """The motion of a recording in the plane with one of its inputs as the helm.

    Raises RecordingError for a recording with a gap: a manoeuvre is measured in one piece.
    """
    if (count := int(np.count_nonzero(recording.piece_starts))) > 1:
        raise RecordingError(f"manoeuvre: got {count} pieces with gaps between, expected one piece")
    assert recording.inputs is not None
    k = [recording.dofs.index(dof) for dof in PLANAR]
    (north, east, psi), (u, v, _) = recording.eta[:, k].T, recording.nu[:, k].T
    values = recording.inputs[:, recording.input_names.index(helm)]
    return Track(recording.t, north, east, psi, values, np.hypot(u, v), length_m)


def sheet(track: Track, ordered: OrderedManoeuvre = UNSTATED, scale: float = 1.0) -> Sheet:
    """Measures and criteria of a manoeuvre; one that is not stated is a turn or a zig-zag.

    The helm and the change of heading of what was ordered decide on the limits; `scale` is the
    length of the ship over that of the model. Raises RecordingError if the helm does not move.
    """
    kind = ordered.kind
    if kind is None:
        rests = [0.0, *(value - track.helm[0] for _, value in levels(track.helm))]
        side = AMIDSHIPS * max(map(abs, rests))
        kind = "zigzag" if min(rests) < -side < side < max(rests) else "turn"
    values = MEASURED[kind](track, *((ordered.turn_deg,) if kind == "zigzag" else ()))
    start = float(track.t[0]) if "spiral" in kind else float(executions(track)[0][0])
    speed = track.at(track.speed, start)
    ratio = float(np.sqrt(scale) * track.length_m / speed) if speed > 0.0 else np.inf
    helm = abs(ordered.helm_deg or values.get("helm", np.nan))
    limit = limits(kind, helm, values.get("change of heading"), ratio)
    entries = (SheetEntry(n, value, MEASURES[n], limit.get(n)) for n, value in values.items())
    return Sheet(kind, tuple(entries), start, track.length_m, speed, ratio)


def measured_sheet(track: Track, ordered: OrderedManoeuvre = UNSTATED, scale: float = 1.0) -> Sheet:
    """The sheet of a recorded track, whose noise is smoothed away, with 90 % intervals.

    The intervals hold what the noise leaves open, by `NOISE_DRAWS` tracks with noise of the same
    size, rounded as the recorded one is, that are smoothed and measured in the same way (symmetric
    bootstrap), and how far a value depends on the sampling: what half of the samples say. Arguments
    and errors are those of `sheet`.
    """
    noise, rng = TrackNoise(track), np.random.default_rng(0)
    smooth = noise.smooth(track)
    result = sheet(smooth, ordered, scale)
    meant, half = replace(ordered, kind=result.manoeuvre), dict.fromkeys(result.values, 0.0)
    count = NOISE_DRAWS if noise.white or noise.steps else 0
    draws = (noise.smooth(noise.draw(smooth, rng)) for _ in range(count))
    coarse = (smooth.part(slice(first, None, 2)) for first in (0, 1))
    for tracks, level in ((draws, LEVEL), (coarse, 1.0)):
        for name, values in drawn_values(result.values, tracks, meant).items():
            away = np.abs(values - result.values[name])
            half[name] += float(np.quantile(away, level)) if len(away) else 0.0
    entries = (
        entry._replace(low=entry.value - around, high=entry.value + around)
        for entry, around in zip(result.entries, half.values(), strict=True)
    )
    return result._replace(entries=tuple(entries))


def drawn_values(
    own: Measures, tracks: Iterable[Track], ordered: OrderedManoeuvre
) -> dict[str, Array]:
    """The values (n,) of the quantities of a sheet in those of other tracks that have them."""
    drawn = []
    for track in tracks:
        with suppress(RecordingError):  # of a helm that moves between two samples
            drawn.append(sheet(track, ordered).values)
    found = {name: np.array([values.get(name, np.nan) for values in drawn]) for name in own}
    return {name: values[np.isfinite(values)] for name, values in found.items()}


def interval(own: float, drawn: Array, level: float = LEVEL) -> tuple[float, float]:
    """The interval of a quantity of an identified model from those of models drawn near it.

    Their parameters deviate by `DEVIATION_SHARE` of what was drawn from their distribution; the
    bounds are quantiles of the deviations over that share. NaN if no draw reaches the quantity.
    """
    finite = drawn[np.isfinite(drawn)]
    if not len(finite):
        return np.nan, np.nan
    low, high = np.quantile(finite - own, [0.5 - 0.5 * level, 0.5 + 0.5 * level]) / DEVIATION_SHARE
    return own + float(low), own + float(high)
