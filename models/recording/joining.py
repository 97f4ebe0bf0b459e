"""Joins what was recorded apart: channels of their own clocks, and recordings end to end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import SHARED, Mask, Recording
from seatrial.models.vessel.basis import Array

MOST_SAMPLES = 100  # on the grid, for each sample of the channel with the most
MIN_STRETCH = 3  # samples of a stretch: a derivative of second order needs as many
BETWEEN = 10  # sample times between two recordings that are joined
UNIFORMITY = 0.01  # largest deviation of a step from the sample time, relative to it
TIME_ROUNDING = 1e-6  # of a sample time
AtGap = Literal["refuse", "split"]
R = TypeVar("R", bound=Recording)


class Channel(NamedTuple):
    """A signal on its own clock: a state is interpolated, a command held until the next."""

    t: Array  # (N,) [s], increasing
    values: Array  # (N,)
    held: bool = False
    name: str = ""  # for messages


@dataclass(frozen=True)
class TimeGrid:
    """The grid that channels are joined on.

    At a gap, which is a time longer than `max_gap_s` [s] without a sample of one of the channels,
    the recording is refused, or split in stretches: no sample of the grid lies in a gap.
    """

    rate_hz: Positive
    max_gap_s: Positive
    at_gap: AtGap = "refuse"

    def __post_init__(self) -> None:
        check_ranges(self)


class JoinedChannels(NamedTuple):
    """Channels on one grid; a step longer than the sample time is a gap."""

    t: Array  # (N,) [s]
    columns: dict[str, Array]  # (N,) each


def join_channels(
    channels: Mapping[str, Channel | tuple[Array, Array, bool]], grid: TimeGrid
) -> JoinedChannels:
    """Interpolate states linearly, and hold commands, on one uniform grid.

    The grid starts where the last channel starts and ends where the first one ends; a command
    holds after its last sample, for at most `max_gap_s`. Angles must be unrolled and quaternions
    free of sign flips. There is no anti-aliasing filter.

    Args:
        channels: t (N,) [s], values (N,), and whether it is held, by name.
        grid: the rate, and what a gap is.

    Returns:
        The common times and the columns on them.

    Raises:
        RecordingError: a channel has fewer than two samples or times that do not increase, the
            channels do not overlap, or there is a gap and `at_gap` is `refuse`.
    """
    known = {name: Channel(*channel) for name, channel in channels.items()}
    known = {key: c._replace(name=c.name or key) for key, c in known.items()}
    for channel in known.values():
        _check(channel.name, channel)
    t = _times(known, grid)
    inside = np.ones(len(t), dtype=np.bool_)
    for channel in known.values():
        covered = _covered(channel, t, grid.max_gap_s)
        if grid.at_gap == "refuse" and not np.all(covered):
            raise _gap(channel.name, channel, grid.max_gap_s)
        inside &= covered
    inside = _long_enough(inside)
    if not np.any(inside):
        raise RecordingError(
            f"got no {MIN_STRETCH} samples of {1.0 / grid.rate_hz:g} s without a gap of more than "
            f"{grid.max_gap_s:g} s in one of {', '.join(c.name for c in known.values())}"
        )
    t = t[inside]
    return JoinedChannels(
        t, {name: _on(channel, t, grid.rate_hz) for name, channel in known.items()}
    )


def _check(name: str, channel: Channel) -> None:
    if len(channel.t) < 2:
        raise RecordingError(f"{name}: got {len(channel.t)} samples, expected at least 2")
    wrong = ~(np.diff(channel.t) > 0.0)  # True for NaN
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{name}, sample {k + 2}: got {channel.t[k + 1]:.6f} s after {channel.t[k]:.6f} s, "
            "expected time to increase"
        )


def _times(channels: Mapping[str, Channel], grid: TimeGrid) -> Array:
    """The uniform grid on which every channel has begun and none has ended."""

    def end(name: str) -> float:
        channel = channels[name]
        return float(channel.t[-1]) + grid.max_gap_s * channel.held

    last = max(channels, key=lambda name: channels[name].t[0])
    first = min(channels, key=end)
    start, stop = float(channels[last].t[0]), end(first)
    stop = min(stop, max(float(channel.t[-1]) for channel in channels.values()))
    count = int(np.floor((stop - start) * grid.rate_hz * (1.0 + 1e-12) + 1e-9)) + 1
    if count < 2:
        raise RecordingError(
            f"got channels that overlap by fewer than two samples at {grid.rate_hz:g} Hz: "
            f"{channels[last].name} begins at {start:g} s, {channels[first].name} ends at "
            f"{stop:g} s"
        )
    most = max(len(channel.t) for channel in channels.values())
    if count > MOST_SAMPLES * most:
        raise RecordingError(
            f"got {count:.3g} samples from the {most} recorded, at resample_hz={grid.rate_hz:g}; "
            f"expected at most {MOST_SAMPLES} times as many"
        )
    return np.asarray(start + np.arange(count) / grid.rate_hz)


def _covered(channel: Channel, t: Array, max_gap_s: float) -> Mask:
    """Whether the samples around each time t (N,) are near enough, shape (N,)."""
    tight = max_gap_s * (1.0 + TIME_ROUNDING)
    before = np.clip(np.searchsorted(channel.t, t, side="right") - 1, 0, None)
    if channel.held:
        return np.asarray(t - channel.t[before] <= tight)
    after = np.minimum(before + 1, len(channel.t) - 1)
    step = channel.t[after] - channel.t[before]
    return np.asarray((step <= tight) | (t == channel.t[before]) | (t == channel.t[after]))


def _gap(name: str, channel: Channel, max_gap_s: float) -> RecordingError:
    steps = np.diff(channel.t)
    k = int(np.argmax(steps > max_gap_s)) if np.any(steps > max_gap_s) else len(steps)
    length = f"{steps[k]:.6g} s" if k < len(steps) else "the rest of the recording"
    return RecordingError(
        f"{name}: got no sample for {length} after {channel.t[k]:.6g} s, expected at most "
        f"{max_gap_s:g} s; excitation.at_gap=split leaves gaps out"
    )


def _long_enough(inside: Mask) -> Mask:
    """The mask (N,) without stretches of fewer than FEWEST samples."""
    edges = np.flatnonzero(np.diff(inside.astype(np.int8), prepend=0, append=0))
    kept = inside.copy()
    for begin, end in edges.reshape(-1, 2):
        kept[begin:end] = end - begin >= MIN_STRETCH
    return kept


def _on(channel: Channel, t: Array, rate_hz: float) -> Array:
    if not channel.held:
        return np.interp(t, channel.t, channel.values)
    now = np.searchsorted(channel.t, t + TIME_ROUNDING / rate_hz, side="right") - 1
    return np.asarray(channel.values[np.maximum(now, 0)])


def end_to_end(parts: Sequence[R]) -> R:
    """Recordings as one with gaps in time between them; consecutive blocks stay together.

    Raises RecordingError if they differ in degrees of freedom, sample time or what was measured.
    """
    parts = _with_loads(parts)
    first = parts[0]
    period, t, end = first.period_s, [first.t], float(first.t[-1])
    for part in parts[1:]:
        if part.dofs != first.dofs or abs(part.period_s - period) > UNIFORMITY * period:
            raise RecordingError(
                f"recordings: got {', '.join(part.dofs)} every {part.period_s:g} s, "
                f"expected {', '.join(first.dofs)} every {period:g} s as in the first"
            )
        steps = (float(part.t[0]) - end) / period
        follows = steps > 0.5 and abs(steps - round(steps)) < UNIFORMITY
        shift = 0.0 if follows else end + BETWEEN * period - float(part.t[0])
        t.append(part.t + shift)
        end = float(t[-1][-1])
    columns: dict[str, Any] = {"t": np.concatenate(t)}
    for field in fields(first):
        if field.name in (*SHARED, "t"):
            continue
        values = [getattr(part, field.name) for part in parts]
        if len({value is None for value in values}) > 1:
            raise RecordingError(f"recordings: {field.name} is in some, expected it in all or none")
        columns[field.name] = None if values[0] is None else np.concatenate(values)
    return replace(first, **columns)


def _with_loads(parts: Sequence[R]) -> Sequence[R]:
    """The recordings with the same loads: NaN in those that have none."""
    names = next((part.load_names for part in parts if part.load_names), ())
    if not names:
        return parts
    return [
        part
        if part.load_names
        else replace(part, load_names=names, loads=np.full((len(part), len(names)), np.nan))
        for part in parts
    ]
