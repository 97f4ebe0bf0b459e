"""Channels of their own clocks on one uniform grid."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.recording.recording import piece_edges
from seatrial.models.recording.times import is_later
from seatrial.models.vessel.basis import Array

MOST_SAMPLES = 100  # on the grid, for each sample of the channel with the most
MIN_STRETCH = 3  # samples of a stretch: a derivative of second order needs as many
TIME_ROUNDING = 1e-6  # of a sample time
AtGap = Literal["refuse", "split"]


class Channel(NamedTuple):
    """A signal on its own clock: a state is interpolated, a command held until the next."""

    t: Array  # (N,) [s], increasing
    values: Array  # (N,)
    held: bool = False
    name: str = ""  # for messages

    def gaps(self, t: Array, longest_s: float) -> Array:
        """The time [s] without a sample at times t (n,), where longer than `longest_s`; else 0."""
        before = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, None)
        after = np.minimum(before + 1, len(self.t) - 1)
        on_sample = (t == self.t[before]) | (t == self.t[after])
        length = np.where(on_sample, 0.0, self.t[after] - self.t[before])
        length = t - self.t[before] if self.held else length
        return np.asarray(np.where(length > longest_s * (1.0 + TIME_ROUNDING), length, 0.0))

    def at(self, t: Array, rate_hz: float) -> Array:
        """The values at times t (n,)."""
        if not self.held:
            return np.interp(t, self.t, self.values)
        now = np.searchsorted(self.t, t + TIME_ROUNDING / rate_hz, side="right") - 1
        return np.asarray(self.values[np.maximum(now, 0)])

    def cleaned(self, notes: list[str]) -> "Channel":
        """Without missing values, and samples that are not later than all before; `notes` tell."""
        valid = ~(np.isnan(self.values) | np.isnan(self.t))
        if timeless := int(np.sum(np.isnan(self.t))):
            notes.append(f"{timeless} rows have no time: left out")
        t, values = self.t[valid], self.values[valid]
        if not np.all(later := is_later(t)):
            back, same = int(np.sum(np.diff(t) < 0.0)), int(np.sum(np.diff(t) == 0.0))
            notes.append(
                f"{self.name}: {int(np.sum(~later))} samples are not later than the one before "
                f"({same} times repeat, {back} go back): left out"
            )
        return self._replace(t=t[later], values=values[later])


def join_channels(
    channels: Mapping[str, Channel], rate_hz: float, max_gap_s: float, at_gap: AtGap = "refuse"
) -> tuple[Array, dict[str, Array]]:
    """Interpolate states linearly, and hold commands, on one uniform grid.

    The grid starts where the last channel starts and ends where the first one ends; a command
    holds for at most `max_gap_s`. Angles must be unrolled. There is no anti-aliasing filter.

    Args:
        channels: signals on clocks of their own.
        rate_hz: of the grid.
        max_gap_s: a longer time [s] without a sample of one of the channels is a gap.
        at_gap: refuse the recording, or split it: no sample of the grid lies in a gap.

    Returns:
        The common times (n,) [s], of which a step longer than the sample time is a gap, and the
        columns (n,) on them.

    Raises:
        RecordingError: channels cannot be joined, or there is a gap and `at_gap` is `refuse`.
    """
    for key, c in channels.items():
        if len(c.t) < 2 or not np.all(np.diff(c.t) > 0.0):
            reason = "expected time to increase" if len(c.t) > 1 else "expected at least 2"
            raise RecordingError(f"{c.name or key}: got {len(c.t)} samples, {reason}")
    start, last = max((float(c.t[0]), c.name) for c in channels.values())
    end, first = min((float(c.t[-1]) + max_gap_s * c.held, c.name) for c in channels.values())
    stop = min(end, max(float(c.t[-1]) for c in channels.values()))
    count = int(np.floor((stop - start) * rate_hz * (1.0 + 1e-12) + 1e-9)) + 1
    if count < 2:
        raise RecordingError(
            f"got channels that overlap by fewer than two samples at {rate_hz:g} Hz: "
            f"{last} begins at {start:g} s, {first} ends at {stop:g} s"
        )
    if count > MOST_SAMPLES * (most := max(len(channel.t) for channel in channels.values())):
        raise RecordingError(
            f"got {count:.3g} samples from the {most} recorded, at resample_hz={rate_hz:g}; "
            f"expected at most {MOST_SAMPLES} times as many"
        )
    rows = np.arange(count)  # of the grid, without those in gaps of the channels before
    for channel in channels.values():
        t = start + rows / rate_hz
        gaps = channel.gaps(t, max_gap_s)
        if at_gap == "refuse" and np.any(gaps):
            k = int(np.argmax(gaps > 0.0))
            before = channel.t[channel.t <= t[k]][-1]
            raise RecordingError(
                f"{channel.name}: got no sample for {gaps[k]:.6g} s after {before:.6g} s, expected "
                f"at most {max_gap_s:g} s; excitation.at_gap=split leaves gaps out"
            )
        rows = rows[gaps == 0.0]
    stretches = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    rows = np.concatenate([part if len(part) >= MIN_STRETCH else part[:0] for part in stretches])
    if not len(rows):
        raise RecordingError(
            f"got no {MIN_STRETCH} samples of {1.0 / rate_hz:g} s without a gap of more than "
            f"{max_gap_s:g} s in one of {', '.join(c.name for c in channels.values())}"
        )
    t = start + rows / rate_hz
    return t, {key: channel.at(t, rate_hz) for key, channel in channels.items()}


def left_in_gaps(t: Array, channels: Mapping[str, Channel], longest_s: float) -> list[str]:
    """What of the time that all channels cover is not among the times t (n,), if anything."""
    whole = min(float(c.t[-1]) for c in channels.values())
    whole -= max(float(c.t[0]) for c in channels.values())
    period = float(np.median(np.diff(t)))
    lost, pieces = whole - len(t) * period, len(piece_edges(t, period)) - 1
    told = f"{lost:.3g} of {whole:.4g} s are in gaps of more than {longest_s:g} s: left out"
    return [f"{told}, {pieces} pieces remain"] if pieces > 1 or lost >= 2.0 * period else []
