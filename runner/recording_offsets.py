"""By how much the clocks of the sources of a recording are apart, by cross-correlation."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import velocities_of
from seatrial.models.recording.consistency import LONGEST_LAG_S, correlations, lag
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import lowpass
from seatrial.models.recording.source import Source
from seatrial.models.recording.times import is_later
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import unroll

SIMILAR = 0.9  # correlation of two signals that are of the same quantity
COVERED = 0.5  # share of the recording that a signal must cover to be compared
MIN_SAMPLES = 50  # samples of a signal that is compared
OFFSET_CUTOFF = 0.2  # of the Nyquist frequency: cut-off for clock offsets
SLOWER = (1.0, 0.5, 0.25, 0.125)  # of that cut-off, until signals agree


class Offset(NamedTuple):
    """By how much a source is behind the recording, by the signals that agree best."""

    source: str
    column: str
    signal: str
    seconds: float
    correlation: float


def offsets(
    recording: Recording, sources: Mapping[str, Source], times: Mapping[str, Array]
) -> list[Offset]:
    """Offset of the clock of each source from the pose and velocity of a recording.

    Args:
        recording: the recording
        sources: its columns, by source
        times: times [s] of the sources that have some, from the same zero as the recording's
    """
    poses = np.column_stack([recording.eta, recording.nu])
    names = [f"pose {dof}" for dof in recording.dofs] + list(velocities_of(recording.dofs))
    best = []
    for name, t in times.items():
        own = [offset_of(name, column, t, values, recording, poses, names)
               for column, values in signals(sources[name]).items()]  # fmt: skip
        if known := [offset for offset in own if offset]:
            best.append(max(known, key=lambda offset: abs(offset.correlation)))
    return best


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


def offset_of(
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
