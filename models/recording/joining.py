"""Joins what was recorded apart: channels of their own clocks, and recordings end to end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import R, joined
from seatrial.models.vessel.basis import Array

MOST_SAMPLES = 100  # on the grid, for each sample of the channel with the most
MIN_STRETCH = 3  # samples of a stretch: a derivative of second order needs as many
BETWEEN = 10  # sample times between two recordings that are joined
UNIFORMITY = 0.01  # largest deviation of a step from the sample time, relative to it
TIME_ROUNDING = 1e-6  # of a sample time
AtGap = Literal["refuse", "split"]


class Channel(NamedTuple):
    """A signal on its own clock: a state is interpolated, a command held until the next."""

    t: Array  # (N,) [s], increasing
    values: Array  # (N,)
    held: bool = False
    name: str = ""  # for messages

    def check(self, key: str) -> None:
        """Raise RecordingError for fewer than two samples, and for times that do not increase."""
        if len(self.t) < 2 or not np.all(np.diff(self.t) > 0.0):
            reason = "expected time to increase" if len(self.t) > 1 else "expected at least 2"
            raise RecordingError(f"{self.name or key}: got {len(self.t)} samples, {reason}")

    def gaps(self, t: Array, longest_s: float) -> Array:
        """The time [s] without a sample at times t (n,), where longer than `longest_s`; else 0."""
        before = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, None)
        if self.held:
            length = t - self.t[before]
        else:
            after = np.minimum(before + 1, len(self.t) - 1)
            on_sample = (t == self.t[before]) | (t == self.t[after])
            length = np.where(on_sample, 0.0, self.t[after] - self.t[before])
        return np.asarray(np.where(length > longest_s * (1.0 + TIME_ROUNDING), length, 0.0))

    def at(self, t: Array, rate_hz: float) -> Array:
        """The values at times t (n,)."""
        if not self.held:
            return np.interp(t, self.t, self.values)
        now = np.searchsorted(self.t, t + TIME_ROUNDING / rate_hz, side="right") - 1
        return np.asarray(self.values[np.maximum(now, 0)])


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


def join_channels(
    channels: Mapping[str, Channel], grid: TimeGrid
) -> tuple[Array, dict[str, Array]]:
    """Interpolate states linearly, and hold commands, on one uniform grid.

    The grid starts where the last channel starts and ends where the first one ends; a command
    holds for at most `max_gap_s`. Angles must be unrolled. There is no anti-aliasing filter.

    Args:
        channels: signals on clocks of their own.
        grid: the rate, and what a gap is.

    Returns:
        The common times (n,) [s], of which a step longer than the sample time is a gap, and the
        columns (n,) on them.

    Raises:
        RecordingError: channels cannot be joined, or there is a gap and `at_gap` is `refuse`.
    """
    for key, channel in channels.items():
        channel.check(key)

    def end(c: Channel) -> float:
        return float(c.t[-1]) + grid.max_gap_s * c.held

    last, first = max(channels.values(), key=lambda c: c.t[0]), min(channels.values(), key=end)
    start, stop = float(last.t[0]), min(end(first), max(float(c.t[-1]) for c in channels.values()))
    count = int(np.floor((stop - start) * grid.rate_hz * (1.0 + 1e-12) + 1e-9)) + 1
    if count < 2:
        raise RecordingError(
            f"got channels that overlap by fewer than two samples at {grid.rate_hz:g} Hz: "
            f"{last.name} begins at {start:g} s, {first.name} ends at {stop:g} s"
        )
    if count > MOST_SAMPLES * (most := max(len(channel.t) for channel in channels.values())):
        raise RecordingError(
            f"got {count:.3g} samples from the {most} recorded, at resample_hz={grid.rate_hz:g}; "
            f"expected at most {MOST_SAMPLES} times as many"
        )
    t = start + np.arange(count) / grid.rate_hz
    inside = np.ones(count, dtype=np.bool_)
    for channel in channels.values():
        gaps = channel.gaps(t, grid.max_gap_s)
        if grid.at_gap == "refuse" and np.any(gaps):
            k = int(np.argmax(gaps > 0.0))
            before = channel.t[channel.t <= t[k]][-1]
            raise RecordingError(
                f"{channel.name}: got no sample for {gaps[k]:.6g} s after {before:.6g} s, expected "
                f"at most {grid.max_gap_s:g} s; excitation.at_gap=split leaves gaps out"
            )
        inside &= gaps == 0.0
    edges = np.flatnonzero(np.diff(inside.astype(np.int8), prepend=0, append=0))
    for a, b in edges.reshape(-1, 2):
        inside[a:b] = b - a >= MIN_STRETCH
    if not np.any(inside):
        raise RecordingError(
            f"got no {MIN_STRETCH} samples of {1.0 / grid.rate_hz:g} s without a gap of more than "
            f"{grid.max_gap_s:g} s in one of {', '.join(c.name for c in channels.values())}"
        )
    t = t[inside]
    return t, {key: channel.at(t, grid.rate_hz) for key, channel in channels.items()}


def end_to_end(parts: Sequence[R]) -> R:
    """Recordings as one with gaps in time between them; consecutive blocks stay together.

    Loads that some of them lack are NaN there. Raises RecordingError if they differ in degrees of
    freedom, sample time or what was measured.
    """
    if names := next((part.load_names for part in parts if part.load_names), ()):
        absent = {"load_names": names}
        parts = [
            part if part.load_names
            else replace(part, **absent, loads=np.full((len(part), len(names)), np.nan))  # type: ignore[arg-type]
            for part in parts
        ]  # fmt: skip
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
        t.append(part.t if follows else part.t + (end + BETWEEN * period - float(part.t[0])))
        end = float(t[-1][-1])
    return replace(joined(parts), t=np.concatenate(t))
