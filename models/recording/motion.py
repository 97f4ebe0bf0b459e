"""Velocities that the pose of a recording implies, under every way in which people record one.

The velocity is R(attitude)' p_dot, and the angular velocity that of the rotation, so that angles
may jump. All signals are low-passed forward and backward, so that their phases stay, and the ends
of each piece, where the filter lacks data, are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.preprocessing import central_difference
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import body_rates, frame_of_angles, turned

MIN_PIECE = 30  # samples of a piece that is filtered
EXCITED_VARIANCE = 10.0  # variance of an excited signal, in that of its noise below the cut-off
LIKELY = 2.0  # times the angular velocity that one of a hundred samples exceeds
CONSTANT_VARIANCE = 1e-12  # variance of a signal that does not move


@dataclass(frozen=True)
class Reading:
    """A way to read pose and velocity; the default is that of this project."""

    heading: str = "as recorded"  # opposite | east | offset
    heading_offset: float = 0.0  # [rad], added to the heading
    position: str = "NED"  # or ENU
    velocity: str = "body"  # or earth

    @property
    def changes(self) -> int:
        """How many of the conventions differ from those of this project."""
        return sum(getattr(self, field.name) != field.default for field in fields(self))

    def attitude(self, attitude: Array) -> Array:
        """(phi, theta, psi) [rad], shape (N, 3), that are meant by the recorded ones."""
        phi, theta, psi = attitude.T
        if self.heading == "opposite":
            psi = -psi
        if self.heading == "east":  # of an attitude from FLU to ENU
            theta, psi = -theta, 0.5 * np.pi - psi
        return np.column_stack([phi, theta, psi + self.heading_offset])

    def path(self, position: Array) -> Array:
        """North, east and down (N, 3) that are meant by the recorded positions."""
        if self.position == "NED":
            return position
        return np.column_stack([position[:, 1], position[:, 0], -position[:, 2]])


PLAIN = Reading()
READINGS = (
    PLAIN,
    Reading(velocity="earth"),
    Reading(position="ENU"),
    Reading(heading="opposite"),
    Reading(heading="east"),
    *(Reading(heading_offset=k * 0.5 * np.pi) for k in (1, 2, 3)),
    Reading(heading="east", position="ENU"),
    Reading(heading="opposite", position="ENU"),
    Reading(velocity="earth", position="ENU"),
)


class Motion:
    """Pose, attitude and velocity of a recording, with the rates that the pose implies.

    `recorded` are the axes whose velocity was recorded (None: all); others were differentiated from
    the pose, agree by construction and are not compared. Neither are `linear` ones if the path
    cannot be turned into body axes.
    """

    def __init__(self, recording: Recording, recorded: Sequence[str] | None = None) -> None:
        self.recording, self.dofs = recording, recording.dofs
        self.starts, self.period_s = recording.piece_starts, recording.period_s
        known = self.dofs if recorded is None else [dof for dof in self.dofs if dof in recorded]
        self.turns = set(PLANAR) <= set(self.dofs)
        level = self.turns or not np.any(recording.attitude)
        self.linear = tuple(dof for dof in known if dof in DOFS[:3] and level)
        self.angular = tuple(dof for dof in known if dof in DOFS[3:])
        self.position = np.zeros((len(recording), 3))
        for i, dof in enumerate(self.dofs):
            if dof in DOFS[:3]:
                self.position[:, DOFS.index(dof)] = recording.eta[:, i]
        pose = np.column_stack([self.position, turned(recording.attitude)])
        self.pose_noise = noise_floor(pose, self.starts, self.period_s).deviation
        self.pose_noise[:3] = np.max(self.pose_noise[:3])  # the axes are turned into each other
        self.noise = noise_floor(recording.nu, self.starts, self.period_s).deviation

    def samples(self, cutoff_hz: float) -> float:
        """Independent samples of a signal below a cut-off."""
        return 2.0 * cutoff_hz * self.period_s * len(self.recording)

    def velocity(self, dofs: Sequence[str], cutoff_hz: float) -> Array:
        """Low-passed recorded velocities (n, k), away from the ends of pieces."""
        index = [self.dofs.index(dof) for dof in dofs]
        return self.inside(self.recording.nu[:, index], cutoff_hz)

    def rates(self, dofs: Sequence[str], cutoff_hz: float, reading: Reading = PLAIN) -> Array:
        """Low-passed velocities (n, k) that the pose implies if it is read in this way."""
        attitude = reading.attitude(self.recording.attitude)
        rate = np.empty((len(attitude), 6))
        rate[:, :3] = self.derivative(reading.path(self.position))
        if reading.velocity == "body" and self.turns:
            frame = np.empty((3, 3, len(attitude)))
            frame_of_angles(attitude.T, frame)
            rate[:, :3] = np.einsum("jin,nj->ni", frame, rate[:, :3])
        rate[:, 3:] = turning = body_rates(attitude, self.period_s, self.starts)
        size = np.linalg.norm(turning, axis=1)
        most = LIKELY * np.percentile(size, 99.0)  # faster is an instrument that lost its attitude
        rate[size > most, 3:] *= (most / size[size > most])[:, None]
        return self.inside(rate[:, [DOFS.index(dof) for dof in dofs]], cutoff_hz)

    def excited(self, dof: str, observed: Array, expected: Array, cutoff_hz: float) -> bool:
        """Whether both signals (n,) of an axis vary more than their noise below the cut-off."""
        return self._exceeds(observed, self.noise[self.dofs.index(dof)], cutoff_hz) and (
            self._exceeds(expected, self.pose_noise[DOFS.index(dof)], cutoff_hz, order=1)
        )

    def accelerates(self, dof: str, observed: Array, expected: Array, cutoff_hz: float) -> bool:
        """Whether a recorded acceleration and the derivative of the velocity (n,) exceed noise."""
        noise = self.noise[self.dofs.index(dof)]
        return self._exceeds(observed, 0.0, cutoff_hz) and (
            self._exceeds(expected, noise, cutoff_hz, order=1)
        )

    def moves(self, dof: str, cutoff_hz: float) -> bool:
        """Whether a recorded velocity varies more than its noise below the cut-off."""
        noise = self.noise[self.dofs.index(dof)]
        return self._exceeds(self.velocity([dof], cutoff_hz), noise, cutoff_hz)

    def _exceeds(self, values: Array, deviation: float, cutoff_hz: float, order: int = 0) -> bool:
        """Whether values vary more than white noise below the cut-off, or its derivative."""
        noise = deviation**2 * 2.0 * self.period_s * cutoff_hz
        if order:
            noise *= (2.0 * np.pi * cutoff_hz) ** 2 / 3.0
        return bool(np.var(values) > max(EXCITED_VARIANCE * noise, CONSTANT_VARIANCE))

    def derivative(self, values: Array) -> Array:
        """Central differences of values (N, k), piece by piece."""
        return np.concatenate(
            [
                central_difference(piece, self.period_s) if len(piece) > 1 else 0.0 * piece
                for piece in np.split(values, np.flatnonzero(self.starts)[1:])
            ]
        )

    def inside(self, values: Array, cutoff_hz: float) -> Array:
        """Low-passed values (n, k) half a period of the cut-off away from the ends of pieces."""
        drop = round(0.5 / cutoff_hz / self.period_s)
        pieces = [
            lowpass(piece, cutoff_hz, self.period_s)[drop : len(piece) - drop]
            for piece in np.split(values, np.flatnonzero(self.starts)[1:])
            if len(piece) > 2 * drop + MIN_PIECE
        ]
        return np.concatenate(pieces) if pieces else values
