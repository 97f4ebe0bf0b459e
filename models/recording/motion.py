"""Velocities that the pose of a recording implies, beside those that were recorded.

The velocity is R(attitude)' p_dot, and the angular velocity that of the rotation, so that angles
may jump. All signals are low-passed forward and backward, so that their phases stay, and the ends
of each piece, where the filter lacks data, are left out.
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.preprocessing import central_difference
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import frame_of_angles, turned

MIN_PIECE = 30  # samples of a piece that is filtered
EXCITED_VARIANCE = 10.0  # variance of an excited signal, in that of its noise below the cut-off
CONSTANT_VARIANCE = 1e-12  # variance of a signal that does not move
BLOCK, REGULAR = 100, 80  # samples among which jumps are looked for, and those that are none
JUMP = 10.0  # times the largest second difference of these
STRAIGHT_LINE = 1e-6  # of the typical step: smaller second differences are those of a straight line


class Motion:
    """Pose, attitude and velocity of a recording, with the rates that the pose implies.

    `recorded` are the axes whose velocity was recorded (None: all); others were differentiated from
    the pose, agree by construction and are not compared. Neither are `linear` ones if the path
    cannot be turned into body axes.
    """

    def __init__(self, recording: Recording, recorded: Sequence[str] | None = None) -> None:
        self.recording, self.dofs = recording, recording.dofs
        self.edges = [*np.flatnonzero(recording.piece_starts).tolist(), len(recording)]
        self.period_s = recording.period_s
        known = self.dofs if recorded is None else [dof for dof in self.dofs if dof in recorded]
        self.turns = set(PLANAR) <= set(self.dofs)
        level = self.turns or not np.any(recording.attitude)
        self.linear = tuple(dof for dof in known if dof in DOFS[:3] and level)
        self.angular = tuple(dof for dof in known if dof in DOFS[3:])

    @cached_property
    def path(self) -> Array:
        """Position and rotation about the body axes (N, 6), without jumps."""
        path = np.zeros((len(self.recording), 6))
        for i, dof in enumerate(self.dofs):
            if dof in DOFS[:3]:
                path[:, DOFS.index(dof)] = self.recording.eta[:, i]
        for a, b in pairwise(self.edges):
            path[a:b, 3:] = turned(self.recording.attitude[a:b])
            path[a:b] = without_jumps(path[a:b])
        return path

    @cached_property
    def rate(self) -> Array:
        """Velocities (N, 6) in body axes that the pose implies."""
        rate = self.derivative(self.path)
        if self.turns:
            frame = np.empty((3, 3, len(rate)))
            frame_of_angles(self.recording.attitude.T, frame)
            rate[:, :3] = np.einsum("jin,nj->ni", frame, rate[:, :3])
        return rate

    @cached_property
    def pose_noise(self) -> Array:
        """Standard deviations (6,) of the noise of the path."""
        noise = noise_floor(self.path, self.recording.piece_starts, self.period_s).deviation
        noise[:3] = np.max(noise[:3])  # the axes are turned into each other
        return np.asarray(noise)

    def samples(self, cutoff_hz: float) -> float:
        """Independent samples of a signal below a cut-off."""
        return 2.0 * cutoff_hz * self.period_s * len(self.recording)

    def velocity(self, dofs: Sequence[str], cutoff_hz: float) -> Array:
        """Low-passed recorded velocities (n, k), away from the ends of pieces."""
        return self.inside(self.recording.nu[:, [self.dofs.index(dof) for dof in dofs]], cutoff_hz)

    def rates(self, dofs: Sequence[str], cutoff_hz: float) -> Array:
        """Low-passed velocities (n, k) that the pose implies."""
        return self.inside(self.rate[:, [DOFS.index(dof) for dof in dofs]], cutoff_hz)

    def derivative(self, values: Array) -> Array:
        """Central differences of values (N, k), piece by piece; zero in a piece of one sample."""
        rate = np.zeros_like(values)
        for a, b in pairwise(self.edges):
            if b - a > 1:
                rate[a:b] = central_difference(values[a:b], self.period_s)
        return rate

    def inside(self, values: Array, cutoff_hz: float) -> Array:
        """Low-passed values (n, k) half a period of the cut-off away from the ends of pieces."""
        drop = round(0.5 / cutoff_hz / self.period_s)
        pieces = [
            lowpass(values[a:b], cutoff_hz, self.period_s)[drop : b - a - drop]
            for a, b in pairwise(self.edges)
            if b - a > 2 * drop + MIN_PIECE
        ]
        return np.concatenate(pieces) if pieces else values

    def exceeds(self, values: Array, deviation: float, cutoff_hz: float, order: int = 0) -> bool:
        """Whether values (n,) vary more than white noise below the cut-off, or its derivative."""
        noise = deviation**2 * 2.0 * self.period_s * cutoff_hz
        if order:
            noise *= (2.0 * np.pi * cutoff_hz) ** 2 / 3.0
        return bool(np.var(values) > max(EXCITED_VARIANCE * noise, CONSTANT_VARIANCE))


def without_jumps(path: Array) -> Array:
    """Signals (N, k) in which a jump, of an instrument that lost the pose, is a step as usual.

    A jump is between two second differences that are `JUMP` times as large as the largest of the
    `REGULAR` smallest ones of their `BLOCK`. Where these are zero, as of values that are held or
    interpolated, nothing is known of jumps.
    """
    count = (len(path) - 2) // BLOCK
    if count < 1:
        return path
    steps = np.diff(path, axis=0)
    bends = np.abs(np.diff(steps, axis=0))
    blocks = bends[: count * BLOCK].reshape(count, BLOCK, -1)
    usual = np.partition(blocks, REGULAR - 1, axis=1)[:, REGULAR - 1]
    usual = usual[np.minimum(np.arange(len(bends)) // BLOCK, count - 1)]
    large = (bends > JUMP * usual) & (usual > STRAIGHT_LINE * np.std(steps, axis=0))
    rows, result = np.arange(1, len(steps) - 1), path.copy()
    for j in range(path.shape[1]):
        jumps = rows[large[1:, j] & large[:-1, j]]
        if len(jumps):
            rest = np.delete(np.arange(len(steps)), jumps)
            steps[jumps, j] = np.interp(jumps, rest, steps[rest, j])
            result[1:, j] = path[0, j] + np.cumsum(steps[:, j])
    return result
