"""The sheet of a manoeuvre: its measures beside the criteria of IMO resolution MSC.137(76).

The criteria hold for a ship of full scale: L / V of a model is multiplied by the square root of its
scale. Limits on turning are for the largest helm, taken to be 30 degrees or more; those on the
overshoot for zig-zags of 10/10 and 20/20.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import MEASURES, Manoeuvre, OrderedManoeuvre
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_measures import (
    MIN_PLATEAUS,
    Measures,
    Track,
    TrackNoise,
    executions,
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

# Of the deviations of drawn models: at whole ones a model leaves the curved valley of the fit, and
# the tactical diameters of KVLCC2 spread 1.6 times as far as estimates do.
DEVIATION_SHARE = 0.25
# A diagnostic of a measure that was recorded or predicted: the beginning of its name, and its j.
DIAGNOSTIC = "recorded_manoeuvre_"
COMPARED = ("measured", "nominal model", "identified model", "low", "high")
FULL_HELM_DEG = 30.0
UNSTATED = OrderedManoeuvre()
NOISE_DRAWS, LEVEL = 60, 0.9
MEASURED: Mapping[Manoeuvre, Callable[..., Measures]] = {
    "turn": turn,
    "zigzag": zigzag,
    "spiral": spiral,
    "reverse_spiral": reverse_spiral,
    "williamson": williamson,
    "stop": stop,
}

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
    def turn_deg(self) -> float | None:
        """Change of heading [deg] that a zig-zag orders; None for other manoeuvres."""
        return self.values["change of heading"] if self.manoeuvre == "zigzag" else None

    @property
    def unlimited(self) -> str | None:
        """Why the resolution does not limit the manoeuvre; None if it does."""
        if any(entry.limit is not None for entry in self.entries):
            return None
        helm = abs(self.values.get("helm", np.nan))
        helms = f"10 or at least {FULL_HELM_DEG:g}"
        reasons = {
            "zigzag": "they are for zig-zags of 10/10 and 20/20, this one is "
            f"{helm:.3g}/{self.turn_deg or 0.0:g}",
            "turn": f"they are for turns with helm {helms}, this one has {helm:.3g}",
        }
        reason = reasons.get(self.manoeuvre, "the resolution has none for this manoeuvre")
        return f"no limits: {reason}"


def limits(manoeuvre: Manoeuvre, measures: Measures, ratio_s: float) -> Measures:
    """The largest values allowed, for L / V [s] at full scale. MSC.137(76), 5.3."""
    helm = abs(measures.get("helm", np.nan))
    if manoeuvre == "stop":
        return {"track reach": 15.0}
    if manoeuvre == "turn":
        full = {"advance": 4.5, "tactical diameter": 5.0} if helm >= FULL_HELM_DEG else {}
        return full | ({"track at 10 deg": 2.5} if round(helm) == 10 else {})
    if manoeuvre != "zigzag" or round(helm) != measures["change of heading"]:
        return {}
    if round(helm) == 10:
        first, second = overshoot_limits(ratio_s)
        return {"first overshoot": first, "second overshoot": second, "initial turning": 2.5}
    return {"first overshoot": 25.0} if round(helm) == 20 else {}


def overshoot_limits(ratio_s: float) -> tuple[float, float]:
    """First and second overshoot [deg] allowed at 10/10 for L / V [s]. MSC.137(76), 5.3.3."""
    ratio = float(np.clip(ratio_s, 10.0, 30.0))
    return 5.0 + 0.5 * ratio, 17.5 + 0.75 * ratio


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
    if not np.min(offsets) < -0.1 * reach < 0.1 * reach < np.max(offsets):
        return "turn"
    turned = float(np.max(np.abs(track.psi - track.psi[0])))
    return "williamson" if turned > np.radians(120.0) else "zigzag"


def sheet(
    track: Track,
    ordered: OrderedManoeuvre = UNSTATED,
    scale: float = 1.0,
    turn_deg: float | None = None,
) -> Sheet:
    """Measures and criteria of a manoeuvre.

    Args:
        track: the motion.
        ordered: what was ordered; its helm and change of heading decide on the limits.
        scale: length of the ship over that of the model.
        turn_deg: heading [deg] to which the initial turning of a zig-zag is measured; None: that
            of the orders.

    Raises:
        RecordingError: the helm does not move.
    """
    kind = ordered.kind or manoeuvre_of(track)
    meant = (turn_deg, ordered.turn_deg) if kind == "zigzag" else ()
    measures = MEASURED[kind](track, *meant)
    start = float(track.t[0]) if "spiral" in kind else float(executions(track)[0][0])
    speed = track.at(track.speed, start)
    ratio = float(np.sqrt(scale) * track.length_m / speed) if speed > 0.0 else np.inf
    helm = ordered.helm_deg or measures.get("helm", np.nan)
    limit = limits(kind, {**measures, "helm": helm}, ratio)
    entries = tuple(
        SheetEntry(name, value, MEASURES[name], limit.get(name)) for name, value in measures.items()
    )
    return Sheet(kind, entries, start, track.length_m, speed, ratio)


def measured_sheet(
    track: Track,
    ordered: OrderedManoeuvre = UNSTATED,
    scale: float = 1.0,
    turn_deg: float | None = None,
) -> Sheet:
    """The sheet of a recorded track, whose noise is smoothed away, with 90 % intervals.

    The intervals hold what the noise leaves open, by `NOISE_DRAWS` tracks with noise of the same
    size, rounded as the recorded one is, that are smoothed and measured in the same way (symmetric
    bootstrap), and how far a value depends on the sampling: what half of the samples say. Arguments
    and errors are those of `sheet`.
    """
    noise, rng = TrackNoise(track), np.random.default_rng(0)
    smooth = noise.smooth(track)
    result = sheet(smooth, ordered, scale, turn_deg)
    meant = replace(ordered, kind=result.manoeuvre)

    def again(other: Track) -> Measures:
        try:
            return sheet(other, meant, scale, result.turn_deg).values
        except RecordingError:  # of a helm that moves between two samples
            return {}

    count = NOISE_DRAWS if noise.signals or noise.steps else 0
    draws = [again(noise.smooth(noise.draw(smooth, rng))) for _ in range(count)]
    halves = [again(smooth.part(slice(first, None, 2))) for first in (0, 1)]
    entries = []
    for entry in result.entries:
        away, coarse = (
            np.abs([each.get(entry.quantity, np.nan) - entry.value for each in others])
            for others in (draws, halves)
        )
        half = float(np.max(coarse[np.isfinite(coarse)], initial=0.0))
        if np.any(known := np.isfinite(away)):
            half += float(np.quantile(away[known], LEVEL))
        entries.append(entry._replace(low=entry.value - half, high=entry.value + half))
    return result._replace(entries=tuple(entries))


def intervals(
    own: Measures, draws: Iterable[Track], ordered: OrderedManoeuvre, turn_deg: float | None = None
) -> dict[str, tuple[float, float]]:
    """Intervals of the quantities of a sheet about an identified model's own ones.

    `draws` are the tracks of models whose parameters deviate from the identified ones by
    `DEVIATION_SHARE` of what was drawn from their distribution, by their covariance or a bootstrap.
    A quantity that only some of these reach, such as one overshoot more, has no interval.
    """
    drawn = [sheet(track, ordered, turn_deg=turn_deg).values for track in draws]
    return {
        name: interval(value, np.array([each[name] for each in drawn if name in each]))
        for name, value in own.items()
    }


def interval(own: float, drawn: Array, level: float = LEVEL) -> tuple[float, float]:
    """The interval of a quantity from models drawn by `DEVIATION_SHARE` of their deviations.

    The bounds are quantiles of the deviations over that share. A draw that does not reach the
    quantity is left out of them; NaN if none does.
    """
    finite = drawn[np.isfinite(drawn)]
    if not len(finite):
        return np.nan, np.nan
    low, high = np.quantile(finite - own, [0.5 - 0.5 * level, 0.5 + 0.5 * level]) / DEVIATION_SHARE
    return own + float(low), own + float(high)
