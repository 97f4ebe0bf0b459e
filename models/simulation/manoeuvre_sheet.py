"""The sheet of a manoeuvre: its measures beside the criteria of IMO resolution MSC.137(76).

The criteria hold for a ship of full scale: L / V of a model is multiplied by the square root of its
scale. Limits on turning are for the largest helm, taken to be 30 degrees or more; those on the
overshoot for zig-zags of 10/10 and 20/20.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_measures import (
    MIN_PLATEAUS,
    Execution,
    Spiral,
    Stop,
    Track,
    TrackNoise,
    Turn,
    WilliamsonMeasures,
    ZigZagMeasures,
    levels,
    plateaus,
    reverse_spiral,
    spiral,
    stop,
    turn,
    williamson,
    zigzag,
)
from seatrial.models.vessel.basis import Array

Manoeuvre = Literal["turn", "zigzag", "spiral", "reverse_spiral", "williamson", "stop"]
Measures = Turn | ZigZagMeasures | Spiral | Stop | WilliamsonMeasures
DEVIATION_SHARE = (
    0.25  # of the deviations: at whole ones a model leaves the curved valley of the fit, and
)
# the tactical diameters of KVLCC2 spread 1.6 times as far as estimates do
INSTANTS: Mapping[Execution, str] = {
    "half": "the instant at which the helm has passed half of its first step",
    "order": "the instant at which the helm leaves its value",
    "full": "the instant at which the helm has reached its order",
}
# A diagnostic of a measure that was recorded or predicted: the beginning of its name, and its j.
DIAGNOSTIC = "recorded_manoeuvre_"
COMPARED = ("measured", "nominal model", "identified model", "low", "high")
FULL_HELM_DEG = 30.0
NOISE_DRAWS, LEVEL = 60, 0.9
ADVANCE, TACTICAL, INITIAL, TRACK_REACH = 4.5, 5.0, 2.5, 15.0  # [L]


Verdict = Literal["pass", "fail", "not settled"]


class SheetEntry(NamedTuple):
    """One line of a sheet; `limit` is the largest value allowed, in the same unit.

    `low` and `high` are the bounds of what a recorded value may be, None of one without noise.
    """

    quantity: str
    value: float
    unit: str  # L: ship lengths
    limit: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def verdict(self) -> Verdict | None:
        """Whether the value is within its limit; None without a limit or a value."""
        if self.limit is None or not np.isfinite(self.value):
            return None
        low, high = (self.value if one is None else one for one in (self.low, self.high))
        if low <= self.limit < high:
            return "not settled"
        return "pass" if high <= self.limit else "fail"


class Sheet(NamedTuple):
    """The measures of one manoeuvre."""

    manoeuvre: Manoeuvre
    execution: Execution
    measures: Measures
    entries: tuple[SheetEntry, ...]
    length_m: float
    speed_m_s: float  # of the approach
    length_over_speed_s: float  # at full scale

    @property
    def turn_deg(self) -> float | None:
        """Change of heading [deg] that a zig-zag orders; None for other manoeuvres."""
        return self.measures.turn_deg if isinstance(self.measures, ZigZagMeasures) else None

    @property
    def unlimited(self) -> str | None:
        """Why the resolution does not limit the manoeuvre; None if it does."""
        if any(entry.limit is not None for entry in self.entries):
            return None
        measures = self.measures
        if isinstance(measures, ZigZagMeasures):
            got = f"this one is {abs(measures.helm_deg):.3g}/{measures.turn_deg:g}"
            return f"no limits: they are for zig-zags of 10/10 and 20/20, {got}"
        if isinstance(measures, Turn):
            got = f"this one has {abs(measures.helm_deg):.3g}"
            helms = f"10 or at least {FULL_HELM_DEG:g}"
            return f"no limits: they are for turns with helm {helms}, {got}"
        return "no limits: the resolution has none for this manoeuvre"

    @property
    def values(self) -> dict[str, float]:
        """The values of the quantities by name."""
        return {entry.quantity: entry.value for entry in self.entries}


def track_of(recording: Recording, helm: str, length_m: float) -> Track:
    """The motion of a recording in the plane with one of its inputs as the helm.

    Raises RecordingError for a recording with a gap: a manoeuvre is measured in one piece.
    """
    if (count := int(np.count_nonzero(recording.piece_starts))) > 1:
        raise RecordingError(f"manoeuvre: got {count} pieces with gaps between, expected one piece")
    names = recording.dofs
    north, east, psi = (recording.eta[:, names.index(dof)] for dof in ("surge", "sway", "yaw"))
    u, v = (recording.nu[:, names.index(dof)] for dof in ("surge", "sway"))
    assert recording.inputs is not None
    values = recording.inputs[:, recording.input_names.index(helm)]
    return Track(recording.t, north, east, psi, values, np.hypot(u, v), length_m)


def manoeuvre_of(track: Track) -> Manoeuvre:
    """Which manoeuvre a track is, by its helm and heading."""
    held = plateaus(track.t, track.helm)
    values = np.array([np.mean(track.helm[a : b + 1]) for a, b in held])
    reach = float(np.max(np.abs(track.helm - track.helm[0])))
    distinct = np.unique(np.round(values / max(reach, 1e-12) * 10.0))
    if len(distinct) > MIN_PLATEAUS:
        return "spiral"
    offsets = np.array([value for _, value in levels(track.helm)]) - track.helm[0]
    both = np.min(offsets) < -0.1 * reach and np.max(offsets) > 0.1 * reach
    if not both:
        return "turn"
    turned = float(np.max(np.abs(track.psi - track.psi[0])))
    return "williamson" if turned > np.radians(120.0) else "zigzag"


def sheet(
    track: Track,
    manoeuvre: Manoeuvre | None = None,
    execution: Execution = "half",
    scale: float = 1.0,
    turn_deg: float | None = None,
) -> Sheet:
    """Measures and criteria of a manoeuvre; None: by the helm and heading of the track.

    `scale` is the length of the ship over that of the model; `turn_deg` [deg] the heading to which
    the initial turning of a zig-zag is measured, None: that of the orders. Raises RecordingError if
    the helm does not move.
    """
    kind = manoeuvre or manoeuvre_of(track)
    measures = MEASURES[kind](track, execution, turn_deg)
    start = 0.0 if isinstance(measures, Spiral) else np.ravel(measures.execute_s)[0]
    speed = track.at(track.speed, float(start))
    ratio = np.sqrt(scale) * track.length_m / speed if speed > 0.0 else np.inf
    entries = tuple(_entries(measures, ratio))
    return Sheet(kind, execution, measures, entries, track.length_m, speed, float(ratio))


def measured_sheet(
    track: Track,
    manoeuvre: Manoeuvre | None = None,
    execution: Execution = "half",
    scale: float = 1.0,
    turn_deg: float | None = None,
) -> Sheet:
    """The sheet of a recorded track, whose noise is smoothed away, with 90 % intervals.

    The intervals hold what the noise leaves open, by `NOISE_DRAWS` tracks with noise of the same
    size that are smoothed and measured in the same way (symmetric bootstrap), and how far a value
    depends on the sampling: what half of the samples say. Arguments and errors are those of
    `sheet`.
    """
    noise = TrackNoise.of(track)
    smooth = noise.smoothed(track)
    result = sheet(smooth, manoeuvre, execution, scale, turn_deg)

    def again(other: Track) -> dict[str, float]:
        try:
            return sheet(other, result.manoeuvre, execution, scale, result.turn_deg).values
        except RecordingError:  # of a helm that moves between two samples
            return {}

    rng = np.random.default_rng(0)
    draws = [again(noise.drawn(smooth, rng)) for _ in range(NOISE_DRAWS if noise.deviation else 0)]
    halves = [again(smooth.part(slice(first, None, 2))) for first in (0, 1)]
    entries = []
    for entry in result.entries:
        name, value = entry.quantity, entry.value
        known = np.array([drawn[name] for drawn in draws if np.isfinite(drawn.get(name, np.nan))])
        coarse = [abs(half[name] - value) for half in halves if np.isfinite(half.get(name, np.nan))]
        half = max(coarse, default=0.0)
        if len(known):
            half += float(np.quantile(np.abs(known - value), LEVEL))
        entries.append(entry._replace(low=value - half, high=value + half))
    return result._replace(entries=tuple(entries))


MEASURES: Mapping[Manoeuvre, Callable[[Track, Execution, float | None], Measures]] = {
    "turn": lambda track, execution, _: turn(track, execution),
    "zigzag": zigzag,
    "spiral": lambda track, *_: spiral(track),
    "reverse_spiral": lambda track, *_: reverse_spiral(track),
    "williamson": lambda track, execution, _: williamson(track, execution),
    "stop": lambda track, execution, _: stop(track, execution),
}


def overshoot_limits(ratio_s: float) -> tuple[float, float]:
    """First and second overshoot [deg] allowed at 10/10 for L / V [s]. MSC.137(76), 5.3.3."""
    ratio = float(np.clip(ratio_s, 10.0, 30.0))
    return 5.0 + 0.5 * ratio, 17.5 + 0.75 * ratio


def _entries(measures: Measures, ratio_s: float) -> list[SheetEntry]:
    if isinstance(measures, Turn):
        return _of_turn(measures)
    if isinstance(measures, ZigZagMeasures):
        return _of_zigzag(measures, ratio_s)
    if isinstance(measures, Spiral):
        return [
            SheetEntry("residual yaw rate", measures.residual_rate_deg_s, "deg/s"),
            SheetEntry("width of the loop", measures.loop_width_deg, "deg"),
        ]
    if isinstance(measures, Stop):
        return [
            SheetEntry("track reach", measures.track_reach, "L", TRACK_REACH),
            SheetEntry("head reach", measures.head_reach, "L"),
            SheetEntry("lateral deviation", measures.deviation, "L"),
            SheetEntry("time to stop", measures.time_s, "s"),
            SheetEntry("change of heading", measures.heading_change_deg, "deg"),
        ]
    return [
        SheetEntry("offset from the track", measures.offset, "L"),
        SheetEntry("error of the heading", measures.heading_error_deg, "deg"),
        SheetEntry("largest distance from the track", measures.widest, "L"),
    ]


def _of_turn(measures: Turn) -> list[SheetEntry]:
    full = abs(measures.helm_deg) >= FULL_HELM_DEG
    ten = round(abs(measures.helm_deg)) == 10
    entries = [
        SheetEntry("helm", measures.helm_deg, "deg"),
        SheetEntry("advance", measures.advance, "L", ADVANCE if full else None),
        SheetEntry("transfer", measures.transfer, "L"),
        SheetEntry(
            "tactical diameter", measures.tactical_diameter, "L", TACTICAL if full else None
        ),
        SheetEntry("steady diameter", measures.steady_diameter, "L"),
        SheetEntry("track at 10 deg", measures.initial_turning, "L", INITIAL if ten else None),
        SheetEntry("time to 90 deg", measures.time_90_s, "s"),
        SheetEntry("time to 180 deg", measures.time_180_s, "s"),
        SheetEntry("speed loss", 100.0 * measures.speed_loss, "%"),
        SheetEntry("drift angle", measures.drift_deg, "deg"),
        SheetEntry("yaw rate", measures.yaw_rate_deg_s, "deg/s"),
    ]
    if np.isfinite(measures.residual_rate_deg_s):
        entries.append(SheetEntry("residual yaw rate", measures.residual_rate_deg_s, "deg/s"))
    return entries


def _of_zigzag(measures: ZigZagMeasures, ratio_s: float) -> list[SheetEntry]:
    helm, turned = abs(measures.helm_deg), measures.turn_deg
    nominal = round(helm) == turned
    limits: dict[int, float] = {}
    if nominal and turned == 10.0:
        limits = dict(enumerate(overshoot_limits(ratio_s)))
    elif nominal and turned == 20.0:
        limits = {0: 25.0}
    entries = [
        SheetEntry("helm", measures.helm_deg, "deg"),
        SheetEntry("change of heading", turned, "deg"),
    ]
    names = ("first", "second", "third", "fourth")
    pairs = zip(names, measures.overshoot_deg, measures.overshoot_s, strict=False)
    for k, (name, angle, time) in enumerate(pairs):
        entries.append(SheetEntry(f"{name} overshoot", angle, "deg", limits.get(k)))
        entries.append(SheetEntry(f"{name} overshoot, time", time, "s"))
    initial = INITIAL if nominal and turned == 10.0 else None
    entries.append(SheetEntry("initial turning", measures.initial_turning, "L", initial))
    entries.append(SheetEntry("period P", measures.period_s, "s"))
    return entries


def intervals(
    own: Track, draws: Iterable[Track], manoeuvre: Manoeuvre,
    execution: Execution = "half", scale: float = 1.0, level: float = 0.9,
    turn_deg: float | None = None,
) -> dict[str, tuple[float, float]]:  # fmt: skip
    """Intervals of the quantities of a sheet about those of an identified model's own track.

    `draws` are the tracks of models whose parameters deviate from the identified ones by
    `DEVIATION_SHARE` of what was drawn from their distribution, by their covariance or a bootstrap.
    A quantity that some of these reach but not the own track, such as one overshoot more, has no
    interval.
    """

    def measured(track: Track) -> dict[str, float]:
        return sheet(track, manoeuvre, execution, scale, turn_deg).values

    known = measured(own)
    values: dict[str, list[float]] = {name: [] for name in known}
    for track in draws:
        for name, value in measured(track).items():
            if name in known:
                values[name].append(value)
    return {name: interval(known[name], np.array(drawn), level) for name, drawn in values.items()}


def interval(own: float, drawn: Array, level: float = 0.9) -> tuple[float, float]:
    """The interval of a quantity from models drawn by `DEVIATION_SHARE` of their deviations.

    The bounds are quantiles of the deviations over that share. A draw that does not reach the
    quantity is left out of them; NaN if none does.
    """
    finite = drawn[np.isfinite(drawn)]
    if not len(finite):
        return np.nan, np.nan
    low, high = np.quantile(finite - own, [0.5 - 0.5 * level, 0.5 + 0.5 * level]) / DEVIATION_SHARE
    return own + float(low), own + float(high)
