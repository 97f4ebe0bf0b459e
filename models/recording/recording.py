"""Recordings: sampled motion and force of a vessel, simulated or measured, and their splits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from seatrial.models import notation
from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.signals import GAP, NoiseFloor, lowpass, noise_floor
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.thruster import SecondOrderLag, acting_force

UNIFORMITY = 0.01  # largest deviation of a step from the sample time, relative to it
BETWEEN = 10  # sample times between two recordings that are joined
DROP_S = 2.0  # [s] at each end, where a zero-phase filter lacks data on one side
MIN_PIECE = 30  # samples of a piece that is low-passed, beside those that are dropped
SMOOTHED = {"nu", "nu_dot", "tau", "tau_filtered", "tau_actual", "wind", "inputs", "loads"}
Mask = NDArray[np.bool_]
R = TypeVar("R", bound="Recording")


@dataclass(frozen=True, eq=False)
class Recording:
    """Uniformly sampled data of one vessel; SI units, radians; arrays have one row per sample.

    `tau` is the commanded force, `tau_filtered` the command filtered by a known thruster lag, and
    `tau_actual` the acting force if it was measured or simulated. The acting force in a row acts
    at the time of that row; the command in a row is applied from that time on. `wind` is the
    measured velocity of the air. `file` numbers the files of a recording of several.
    """

    dofs: tuple[str, ...]
    t: Array  # (N,) [s]
    eta: Array  # (N, n_dof) pose: NED [m] and [rad], headings unrolled
    nu: Array  # (N, n_dof) body velocity [m/s, rad/s]
    nu_dot: Array  # (N, n_dof) body acceleration [m/s^2, rad/s^2]
    tau: Array  # (N, n_dof) commanded force [N, Nm]
    attitude: Array  # (N, 3) (phi, theta, psi) [rad]
    tau_filtered: Array | None = None
    tau_actual: Array | None = None
    wind: Array | None = None  # (N, 2) velocity of the air in body axes [m/s]
    immediate: tuple[str, ...] = ()  # axes, or inputs, known to follow their command at once
    inputs: Array | None = None  # (N, n_inputs) of a steered vessel, as they act; `tau` is zero
    commands: Array | None = None  # (N, n_inputs) of these inputs
    input_names: tuple[str, ...] = ()
    loads: Array | None = None  # (N, n_loads) [N] measured on devices; NaN in files without them
    load_names: tuple[str, ...] = ()  # such as propeller.thrust
    file: NDArray[np.int64] | None = None  # (N,) in increasing order
    file_names: tuple[str, ...] = ()  # by number

    def __post_init__(self) -> None:
        if len(self.t) < 2:
            raise RecordingError(f"got {len(self.t)} samples, expected at least 2")
        shape = (len(self.t), len(self.dofs))
        for name in ("eta", "nu", "nu_dot", "tau", "tau_filtered", "tau_actual"):
            values = getattr(self, name)
            if values is not None and values.shape != shape:
                raise RecordingError(f"{name}: got shape {values.shape}, expected {shape}")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def place(self) -> str:
        """What messages call it: its file, if it is one of several."""
        return "recordings" if self.file is None else self.file_names[int(self.file[0])]

    @cached_property
    def period_s(self) -> float:
        """Sample time [s], also if parts of the recording are missing."""
        return sample_time(self.t)

    @cached_property
    def edges(self) -> list[int]:
        """Where the pieces without a gap in time begin, and N."""
        return piece_edges(self.t, self.period_s)

    @cached_property
    def piece_starts(self) -> Mask:
        """True (N,) at the first sample and at each that follows a gap in time."""
        return piece_starts(self.t, self.period_s)

    @cached_property
    def noise(self) -> NoiseFloor:
        """Noise of the velocities."""
        return noise_floor(self.nu, self.piece_starts, self.period_s)

    def part(self, mask: Mask | slice) -> Self:
        """The recording restricted to the samples of a mask (N,) or slice."""
        return replace(self, **{name: values[mask] for name, values in self.sampled.items()})

    @property
    def sampled(self) -> dict[str, Any]:
        """The arrays (N, ...) of the recording by their names, without those that it lacks."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: x for name, x in values if isinstance(x, np.ndarray)}

    def with_thruster(self, thruster: SecondOrderLag | None) -> "Recording":
        """The recording with `tau_filtered`, the command filtered by a known thruster lag."""
        if thruster is None:
            return self
        return replace(self, tau_filtered=acting_force(thruster, self.tau, self.period_s))

    def force(self, kind: str | None) -> Array:
        """The force [N, Nm] used to compute a residual, (N, n_dof); `commanded` in the thesis.

        If `kind` is None, it is `filtered` if the lag is known, else `actual` if it is recorded,
        else `commanded`. Raises ConfigurationError if the force of the kind is not available.
        """
        forces = {"filtered": self.tau_filtered, "actual": self.tau_actual, "commanded": self.tau}
        kind = kind or next(name for name, force in forces.items() if force is not None)
        if (force := forces[kind]) is None:
            why = "the thruster lag is not known" if kind == "filtered" else "it is not recorded"
            raise ConfigurationError(f"identifier.force: got {kind}, but {why}")
        return force

    def held_force(self, kind: str | None) -> Array:
        """Force [N, Nm] at the start, middle and end of each sample, shape (N, 3, n_dof).

        A command is constant over its sample, an acting force linear between the samples.
        """
        start = self.force(kind)
        return held(start, start if start is self.tau else following(start))

    def variables(self) -> Array:
        """Variables of the basis functions, shape (N, N_VARIABLES)."""
        columns = () if self.inputs is None else self.inputs.T
        inputs = dict(zip(self.input_names, columns, strict=True))
        return basis.variables(self.nu_dot, self.nu, self.attitude, self.dofs, self.wind, inputs)

    def lowpass(self, cutoff_hz: float | None, drop_s: float = DROP_S) -> "Recording":
        """Zero-phase low-pass (4th-order Butterworth, forward and backward) of nu, nu_dot, force.

        `drop_s` [s] are dropped at each end, where the filter lacks data on one side, and pieces
        that are too short for it as a whole. Raises RecordingError if all of them are.
        """
        if cutoff_hz is None:
            return self
        check_cutoff(cutoff_hz, self.period_s)
        drop, pieces = round(drop_s / self.period_s), self.pieces()
        if (longest := max(map(len, pieces))) < (least := 2 * drop + MIN_PIECE):
            raise RecordingError(f"got {longest} samples, too few for a low-pass filter")
        inner = []
        for piece in (piece for piece in pieces if len(piece) >= least):
            smooth = piece.sampled
            for name in SMOOTHED & smooth.keys():
                smooth[name] = lowpass(smooth[name], cutoff_hz, piece.period_s)
            inner.append(replace(piece, **smooth).part(slice(drop, len(piece) - drop)))
        return joined(inner)

    def interior(self, drop_s: float) -> Mask:
        """Samples (N,) at least `drop_s` [s] from the ends of their pieces."""
        drop, inside = round(drop_s / self.period_s), np.zeros(len(self), dtype=np.bool_)
        for a, b in pairwise(self.edges):
            inside[a + drop : max(b - drop, a + drop)] = True
        return inside

    def lowpassed(self, values: Array, cutoff_hz: float) -> Array:
        """Zero-phase low-pass of columns (N, k) that belong to the samples, piece by piece."""
        return piecewise(lambda x: lowpass(x, cutoff_hz, self.period_s), self.edges, values)

    def pieces(self) -> list["Recording"]:
        """The segments without a gap in time, such as the trips of the training part."""
        return [self.part(slice(a, b)) for a, b in pairwise(self.edges)]

    def by_file(self) -> dict[str, "Recording"]:
        """The part of each file by its name; empty unless there are several files."""
        if self.file is None or len(numbers := np.unique(self.file)) < 2:
            return {}
        return {self.file_names[k]: self.part(self.file == k) for k in numbers}

    def folds(self, count: int) -> tuple["Split", ...]:
        """Splits for blocked cross-validation; several files are left out file by file."""
        return blocked_k_fold(len(self), count, file=self.file)


def sample_time(t: Array) -> float:
    """Sample time [s] of times t (N,), of which parts may be missing."""
    span = t[-1] - t[0]  # gaps, as between trips, are multiples of the sample time
    return float(span / round(span / np.median(np.diff(t))))


def piece_starts(t: Array, period_s: float) -> Mask:
    """True (N,) at the first of times t (N,) [s] and at each that follows a gap."""
    return np.asarray(np.diff(t, prepend=-np.inf) > GAP * period_s)


def piece_edges(t: Array, period_s: float) -> list[int]:
    """Where the pieces without a gap begin in times t (N,) [s], and N."""
    return [*np.flatnonzero(piece_starts(t, period_s)).tolist(), len(t)]


def piecewise(function: Callable[..., Array], edges: Sequence[int], *values: Array) -> Array:
    """The results of a function of each piece of values (N, ...), end to end."""
    return np.concatenate([function(*(x[a:b] for x in values)) for a, b in pairwise(edges)])


def following(values: Array) -> Array:
    """The value at the next sample, shape (N, ...); the last value is repeated."""
    return np.concatenate([values[1:], values[-1:]])


def held(start: Array, end: Array) -> Array:
    """Values at the start, middle and end of each sample, shape (N, 3, n)."""
    return np.stack([start, 0.5 * (start + end), end], axis=1)


def check_cutoff(cutoff_hz: float | None, period_s: float) -> None:
    """Raise ConfigurationError unless the cut-off is below half the sample rate; period [s]."""
    if cutoff_hz is not None and not 0.0 < cutoff_hz < 0.5 / period_s:
        text = f"must lie between 0 and {0.5 / period_s:g}, got {cutoff_hz:g}"
        raise ConfigurationError(f"identifier.lowpass_hz {text}")


def joined(pieces: Sequence[R]) -> R:
    """Concatenate pieces, each of which keeps its time; raises RecordingError if they differ."""
    parts = [piece.sampled for piece in pieces]
    for piece, part in zip(pieces, parts, strict=True):
        if some := part.keys() ^ parts[0].keys():
            text = f"{min(some)} is in some, expected it in all or none"
            raise RecordingError(f"{piece.place}: {text}")
    every = ((name, np.concatenate([part[name] for part in parts])) for name in parts[0])
    return replace(pieces[0], **dict[str, Any](every))


def end_to_end(parts: Sequence[R]) -> R:
    """Recordings as one with gaps in time between them; consecutive blocks stay together.

    Loads that some of them lack are NaN there. Raises RecordingError if they differ in degrees of
    freedom, sample time or what was measured.
    """
    names = next((part.load_names for part in parts if part.load_names), ())
    parts = [part if part.load_names == names
             else replace(part, load_names=names, loads=np.full((len(part), len(names)), np.nan))
             for part in parts]  # fmt: skip
    first = parts[0]
    period, t, end = first.period_s, [first.t], float(first.t[-1])
    for part in parts[1:]:
        if part.dofs != first.dofs or abs(part.period_s - period) > UNIFORMITY * period:
            got = [f"{', '.join(one.dofs)} every {one.period_s:g} s" for one in (part, first)]
            text = f"got {got[0]}, expected {got[1]} as in the first; resample_hz sets one"
            raise RecordingError(f"{part.place}: {text}")
        steps = (float(part.t[0]) - end) / period
        follows = steps > 0.5 and abs(steps - round(steps)) < UNIFORMITY
        t.append(part.t if follows else part.t + (end + BETWEEN * period - float(part.t[0])))
        end = float(t[-1][-1])
    return replace(joined(parts), t=np.concatenate(t))


def attitude_of(dofs: Sequence[str], eta: Array) -> Array:
    """(phi, theta, psi) [rad], shape (N, 3), from a pose over `dofs`; missing angles are zero."""
    pose, zero = dict(zip(dofs, eta.T, strict=True)), np.zeros(len(eta))
    return np.column_stack([pose.get(dof, zero) for dof in notation.DOFS[3:]])


def blocks(n: int, count: int, file: NDArray[np.int64] | None = None) -> list[slice]:
    """`count` consecutive blocks that cover n samples, for blocked cross-validation.

    If the samples are of several files (N,), a block is a file, or consecutive files where there
    are more than `count`.
    """
    starts = np.arange(n)
    if file is not None and file[0] != file[-1]:
        starts = np.flatnonzero(np.diff(file, prepend=file[0] - 1))
    if len(starts) > count:  # as nearly even as they can be
        chosen = [0]
        for i, edge in enumerate(np.linspace(0, n, count + 1).round()[1:-1], 1):
            left = starts[: len(starts) - count + i + 1]  # so that each block after it has one
            left = left[left > chosen[-1]]
            chosen.append(int(left[np.argmin(np.abs(left - edge))]))
        starts = np.array(chosen)
    return [slice(int(a), int(b)) for a, b in pairwise([*starts, n])]


class Split(NamedTuple):
    """Disjoint masks of the training and test samples, shape (N,); they need not cover all samples.

    They are blocks in time: a random split would test on data close to the training data.
    """

    train: Mask
    test: Mask


def half(n: int, fraction: float = 0.5) -> Split:
    """The first `fraction` of n samples for training, the rest for testing."""
    if not 0.0 < fraction < 1.0:
        raise ConfigurationError(f"train_fraction must lie between 0 and 1, got {fraction:g}")
    train = np.arange(n) < fraction * n - 1e-9
    return Split(train, ~train)


def blocked_k_fold(n: int, count: int, file: NDArray[np.int64] | None = None) -> tuple[Split, ...]:
    """`count` splits that test on one of the `blocks` each and train on the others."""
    if count < 2 or n < count:
        got = f"cannot cut {n} samples into {count} blocks"
        raise ConfigurationError(f"{got}, expected at least 2 blocks, none empty")
    k = np.arange(n)
    inside = ((block.start <= k) & (k < block.stop) for block in blocks(n, count, file))
    return tuple(Split(~test, test) for test in inside)
