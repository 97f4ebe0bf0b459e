"""What `seatrial data check` reports of a recording."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, VELOCITY_UNIT, velocities_of
from seatrial.models.recording.column_map import Column, ColumnMap
from seatrial.models.recording.consistency import LONGEST_LAG_S, correlations, lag
from seatrial.models.recording.diagnosis import Examination
from seatrial.models.recording.preprocessing import outliers
from seatrial.models.recording.reader import ColumnReading, Signals, clock_of, first_time, wanted
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.sampling import Sampling, sampling
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.recording.source import Source, column
from seatrial.models.recording.times import EPOCH_S, is_later, seconds
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import unroll

SIMILAR = 0.9  # correlation of two signals that are of the same quantity
COVERED = 0.5  # share of the recording that a signal must cover to be compared
SINGULAR_RATIO = 0.01  # of a singular value, relative to the largest, of terms not told apart
MIN_WEIGHT = 0.3  # relative weight of a term in a combination
MIN_SAMPLES = 50  # samples of a signal that is compared
OFFSET_CUTOFF = 0.2  # of the Nyquist frequency: cut-off for clock offsets
SLOWER = (1.0, 0.5, 0.25, 0.125)  # of that cut-off, until signals agree
MIN_SHARE_LEFT = 0.5  # share of a recording: less is left where ordinary steps count as gaps
BRIDGED = 2.5  # sample times of a source that count as a step of it
MOST_OUTLIERS = 0.02  # share of the samples of a velocity
SHORT_S = 120.0  # [s] below which a recording is short


class Offset(NamedTuple):
    """By how much a source is behind the recording, by the signals that agree best."""

    source: str
    column: str
    signal: str
    seconds: float
    correlation: float


class SignalRange(NamedTuple):
    """Range, noise and outliers of one signal of the recording."""

    name: str
    unit: str
    least: float
    most: float
    deviation: float
    noise: float
    outliers: int


@dataclass(frozen=True)
class Report:
    """Everything that the page shows."""

    path: str
    samplings: Mapping[str, Sampling]
    examination: Examination | None
    why_not: str  # the recording could not be read; empty if it could
    ranges: tuple[SignalRange, ...]
    offsets: tuple[Offset, ...]
    terms: Mapping[str, tuple[str, ...]]  # by axis, terms that the data do not tell apart
    advice: tuple[str, ...]
    readings: tuple[ColumnReading, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def verdict(self) -> tuple[str, ...]:
        """Problems and questions, or that there is none; outliers count, too."""
        known = self.examination
        if known is None:
            return ()
        counts = {r.name: r.outliers for r in self.ranges if r.outliers}
        lines = [f"problem: {problem}" for problem in known.problems]
        names = ", ".join(f"{name} {count}" for name, count in counts.items())
        if max(counts.values(), default=0) > MOST_OUTLIERS * len(known.recording):
            lines.append(f"problem: outliers: {names}; excitation.outliers.replace=true")
        lines += [f"question: {line}" for line in known.questions]
        lines += [f"not compared: {line}" for line in known.not_compared]
        compared = any(axis.excited for axis in known.result.velocities)
        if compared and not [line for line in lines if not line.startswith("not compared")]:
            few = f"; few outliers: {names}" if names else ""
            lines.insert(0, f"no problem: pose and velocity belong together{few}")
        return tuple(lines)


def report(file: RecordedFile, sources: Mapping[str, Source]) -> Report:
    """Examine a recording by its map; what cannot be read is said, the rest is reported."""
    columns, samplings = file.columns, dict[str, Sampling]()
    for name, source in sources.items():
        with suppress(ConfigurationError, RecordingError):
            samplings[name] = sampling(seconds(source, clock_of(source, columns)))
    turning = "yaw" in columns.posed  # its rate may be missing: it is then differentiated
    dofs = tuple(dof for dof in DOFS if dof in columns.moving or (dof == "yaw" and turning))
    used = {name: known for name, known in samplings.items() if _is_used(name, sources, columns)}
    why, known, read = "", None, list[Signals]()
    try:
        known = file.examine(dofs)
        read += file.account(known.recording.dofs if known else dofs) if dofs or known else ()
        if known is None:
            why = "the recording cannot be read in the axes that it is compared in"
    except (ConfigurationError, RecordingError) as error:
        why = str(error)
    readings = tuple(dict.fromkeys(row for signals in read for row in signals.readings))
    left_out = tuple(dict.fromkeys(line for signals in read for line in signals.left_out))
    if known is None:
        advice = _cures(used, why)
        return Report(str(file.path), samplings, None, why, (), (), {}, advice, readings, left_out)
    recording = known.recording
    return Report(
        str(file.path), samplings, known, "", _ranges(recording),
        _offsets(recording, sources, columns), _terms(recording),
        (*_cures(used, ""), *_bridges(used, recording), *_advice(known, str(file.path))),
        readings, left_out,
    )  # fmt: skip


def _is_used(name: str, sources: Mapping[str, Source], columns: ColumnMap) -> bool:
    """Whether a map takes a column from a source."""
    specs = wanted(columns, DOFS)[0].values()
    return len(sources) == 1 or any(_holds(sources, spec, name) for spec in specs)


def _holds(sources: Mapping[str, Source], spec: Column, name: str) -> bool:
    try:
        return column(sources, spec.name)[0].name == name
    except RecordingError:
        return False


def _ranges(recording: Recording) -> tuple[SignalRange, ...]:
    noise = noise_floor(recording.nu, recording.piece_starts, recording.period_s).deviation
    return tuple(
        SignalRange(
            name, VELOCITY_UNIT[dof], float(np.min(values)), float(np.max(values)),
            float(np.std(values)), float(noise[i]), int(np.sum(outliers(values))),
        )
        for i, (name, dof, values) in enumerate(
            zip(velocities_of(recording.dofs), recording.dofs, recording.nu.T, strict=True)
        )
    )  # fmt: skip


def _offsets(
    recording: Recording, sources: Mapping[str, Source], columns: ColumnMap
) -> tuple[Offset, ...]:
    """Clock offsets of the sources, by cross-correlation with pose and velocity.

    There are none where most of the recording is in gaps: what is left says too little.
    """
    if len(sources) < 2 or _kept(recording) < MIN_SHARE_LEFT:
        return ()
    poses = np.column_stack([recording.eta, recording.nu])
    names = [f"pose {dof}" for dof in recording.dofs] + list(velocities_of(recording.dofs))
    start = first_time(sources, columns)
    origin = start if start > EPOCH_S else 0.0  # zero in the recording, where times are dates
    found = []
    for source in sources.values():
        try:
            t = seconds(source, clock_of(source, columns)) - origin
        except (ConfigurationError, RecordingError):
            continue
        best = max(
            (
                offset
                for name, values in signals(source).items()
                if (offset := _offset(source.name, name, t, values, recording, poses, names))
            ),
            key=lambda offset: abs(offset.correlation),
            default=None,
        )
        if best is not None:
            found.append(best)
    return tuple(found)


def signals(source: Source) -> dict[str, Array]:
    """Columns of numbers that move, and the heading of a quaternion; angles are unrolled."""
    result = {}
    for name in source.columns:
        try:
            values = source.numbers(name, gaps=True)
        except RecordingError:
            continue
        known = values[~np.isnan(values)]
        if len(known) >= MIN_SAMPLES and np.ptp(known) > 0.0 and "stamp" not in name:
            result[name] = values
    stem = next((name[:-1] for name in result if name.endswith("_w")), None)
    if stem and f"{stem}z" in result:
        w, z = result[f"{stem}w"], result[f"{stem}z"]
        result[f"heading of {stem.rstrip('_')}"] = unroll(2.0 * np.arctan2(z, w))
    return result


def _offset(
    source: str, name: str, t: Array, values: Array, recording: Recording, known: Array,
    names: Sequence[str],
) -> Offset | None:  # fmt: skip
    """The offset by one column, if it is of the quantity of a signal of the recording."""
    valid = ~(np.isnan(values) | np.isnan(t))
    t, values = t[valid], values[valid]
    t, values = t[is_later(t)], values[is_later(t)]
    inside = (recording.t >= t[0]) & (recording.t <= t[-1]) if len(t) >= MIN_SAMPLES else None
    if inside is None or np.mean(inside) < COVERED:
        return None
    period = recording.period_s
    fine = min(period, float(np.median(np.diff(t))) or period)
    grid = np.arange(recording.t[inside][0], recording.t[inside][-1], fine)
    own = np.interp(grid, t, values)[:, None]
    others = np.column_stack([np.interp(grid, recording.t, column) for column in known.T])
    after = np.clip(np.searchsorted(recording.t, grid[:-1]), 1, len(recording.t) - 1)
    step = np.diff(recording.t)[after - 1]
    for part in SLOWER:  # states that were recorded more slowly than the grid are steps below it
        cutoff = OFFSET_CUTOFF * part * 0.5 / period
        moving, known_rates = (np.diff(lowpass(x, cutoff, fine), axis=0) for x in (own, others))
        inside = step < max(1.5 * period, 0.5 / cutoff)  # longer steps say nothing of this band
        rho = correlations(moving[inside], known_rates[inside])[0]
        best = int(np.argmax(np.abs(rho)))
        if abs(rho[best]) >= SIMILAR - 0.4:
            sign = np.sign(rho[best])
            most = round(LONGEST_LAG_S / fine)
            rate = known_rates[:, [best]]
            behind = lag(sign * moving, rate, most, inside) * fine
            moved = np.interp(grid[:-1] + behind, grid[:-1], moving[:, 0])[:, None]
            agreed = float(correlations(moved[inside], rate[inside])[0, 0])
            if abs(agreed) >= SIMILAR:
                return Offset(source, name, names[best], behind, agreed)
    return None


def _terms(recording: Recording) -> dict[str, tuple[str, ...]]:
    """Terms of a common model that the data do not tell apart, by degree of freedom."""
    speeds = dict(zip(velocities_of(recording.dofs), recording.nu.T, strict=True))
    result = {}
    for i, (dof, name) in enumerate(
        zip(recording.dofs, velocities_of(recording.dofs), strict=True)
    ):
        own = speeds[name]
        terms = {
            f"{name}_dot": recording.nu_dot[:, i],
            name: own,
            f"|{name}|{name}": abs(own) * own,
        }
        for first, second in (("v", "r"), ("u", "r"), ("u", "v")):
            if {first, second} <= set(speeds) and name not in (first, second):
                terms[f"{first}{second}"] = speeds[first] * speeds[second]
        phi = np.column_stack(list(terms.values()))
        size = np.linalg.norm(phi, axis=0)
        if np.any(size == 0.0):
            result[dof] = tuple(n for n, s in zip(terms, size, strict=True) if s == 0.0)
            continue
        _, values, ways = np.linalg.svd(phi / size, full_matrices=False)
        if values[-1] < SINGULAR_RATIO * values[0]:
            weight = np.abs(ways[-1]) / np.max(np.abs(ways[-1]))
            result[dof] = tuple(n for n, w in zip(terms, weight, strict=True) if w > MIN_WEIGHT)
    return result


def _cures(samplings: Mapping[str, Sampling], why: str) -> tuple[str, ...]:
    """What sampling asks for."""
    advice = [why] if why else []
    for name, known in samplings.items():
        if known.not_later:
            advice.append(
                f"{name}: {known.not_later} times are not later than the one before: "
                "columns.time: {column: NAME, uniform: true} if they are rounded"
            )
        if known.gaps and known.missing > 0.01:
            advice.append(
                f"{name}: {known}: excitation.at_gap=split leaves gaps longer than max_gap_s out"
            )
    return tuple(advice)


def _kept(recording: Recording) -> float:
    """The share of a recording that is not in gaps."""
    return len(recording.t) * recording.period_s / float(recording.t[-1] - recording.t[0])


def _bridges(samplings: Mapping[str, Sampling], recording: Recording) -> tuple[str, ...]:
    """Advice where ordinary steps of a slow source count as gaps, so that most is left out."""
    name, slowest = min(samplings.items(), key=lambda item: item[1].rate_hz or np.inf)
    if _kept(recording) > MIN_SHARE_LEFT or not slowest.rate_hz > 0.0:
        return ()
    whole = float(recording.t[-1] - recording.t[0])
    return (
        f"{_kept(recording) * whole:.0f} of {whole:.0f} s are kept, the rest is in gaps: "
        f"excitation.max_gap_s={BRIDGED / slowest.rate_hz:.2g} bridges the steps of {name}",
    )


MANOEUVRES = {
    "surge": "accelerate and stop, at several speeds",
    "sway": "zig-zags of 20 degrees, or sideways steps",
    "heave": "steps in depth",
    "roll": "roll decay, or zig-zags at speed",
    "pitch": "pitch decay, or steps of the trim",
    "yaw": "zig-zags of 10 and 20 degrees and turning circles",
}


def _advice(known: Examination, path: str) -> list[str]:
    """What to run next."""
    advice = [
        f"{axis.dof} hardly moves: {MANOEUVRES[axis.dof]}"
        for axis in known.result.velocities
        if not axis.excited
    ]
    seconds_long = known.recording.t[-1] - known.recording.t[0]
    if seconds_long < SHORT_S:
        advice.append(f"the recording lasts {seconds_long:.0f} s: run several minutes")
    trial = f"seatrial vessel=NAME excitation=recording excitation.path={path}"
    return advice or [f"nothing is missing: {trial} excitation.map=MAP.yaml"]
