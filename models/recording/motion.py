"""Velocities that the pose of a recording implies, under every way in which people record one.

    nu = J(eta)^-1 eta_dot

All signals are low-passed forward and backward, so that their phases stay, and the ends of each
piece, where the filter lacks data, are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.agreement import Agreement, best_order, correlations, scale_of
from seatrial.models.recording.preprocessing import central_difference
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian

BANDS = (0.25, 0.1, 0.04)  # of the Nyquist frequency: cut-offs of the low-pass, widest first
MIN_PIECE = 30  # samples of a piece that is filtered
MIN_INDEPENDENT = 30  # independent samples that a correlation needs
EXCITED_VARIANCE = 10.0  # variance of an excited signal, in that of its noise below the cut-off
CONSTANT_VARIANCE = 1e-12  # variance of a signal that does not move
AS_GOOD = 0.03  # mean squared correlation by which a simpler reading may be worse
DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class Reading:
    """A way to read pose and velocity; the default is that of this project."""

    heading: str = "as recorded"  # opposite | east | offset
    heading_offset: float = 0.0  # [rad], added to the heading
    position: str = "NED"  # or ENU
    velocity: str = "body"  # or earth
    degrees: tuple[str, ...] = ()  # the angles that are in degrees

    @property
    def changes(self) -> int:
        """How many of the conventions differ from those of this project."""
        return sum(getattr(self, name) != getattr(PLAIN, name) for name in CONVENTIONS)

    def attitude(self, attitude: Array) -> Array:
        """(phi, theta, psi) [rad], shape (N, 3), that are meant by the recorded ones."""
        units = [DEGREE if dof in self.degrees else 1.0 for dof in DOFS[3:]]
        phi, theta, psi = (attitude * units).T
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


CONVENTIONS = ("heading", "heading_offset", "position", "velocity")
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
    """Pose, attitude and velocity of a recording, with the rates that the pose implies."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.dofs = recording.dofs
        self.linear = tuple(dof for dof in recording.dofs if dof in DOFS[:3])
        self.angular = tuple(dof for dof in recording.dofs if dof in DOFS[3:])
        # Without heading or sway the path cannot be turned into body axes.
        self.turns = set(PLANAR) <= set(recording.dofs)
        self.position = np.zeros((len(recording), 3))
        self.position_noise = np.zeros(3)
        floor = noise_floor(recording.eta, recording.piece_starts, recording.period_s).deviation
        for i, dof in enumerate(recording.dofs):
            if dof in self.linear:
                self.position[:, DOFS.index(dof)] = recording.eta[:, i]
                self.position_noise[DOFS.index(dof)] = floor[i]
        self.noise = noise_floor(recording.nu, recording.piece_starts, recording.period_s).deviation
        self.pose_noise = dict(zip(recording.dofs, floor, strict=True))

    def best_band(self) -> float:
        """Cut-off [Hz] of the widest band in which velocities and rates agree best, in any order.

        Bands with fewer than `MIN_INDEPENDENT` independent samples are left out.
        """
        nyquist = 0.5 / self.recording.period_s
        best, result = -1.0, BANDS[0] * nyquist
        for band in BANDS:
            cutoff = band * nyquist
            if band != BANDS[0] and self.samples(cutoff) < MIN_INDEPENDENT:
                break
            score = 0.0
            for dofs in (self.angular, self.linear):
                if dofs:
                    observed, expected = self.velocity(dofs, cutoff), self.rates(dofs, cutoff)
                    rho = np.abs(correlations(observed, expected))
                    score += float(np.mean(np.max(rho, axis=1)))
            if score > best + AS_GOOD:
                best, result = score, cutoff
        return result

    def samples(self, cutoff_hz: float) -> float:
        """Independent samples of a signal below a cut-off."""
        return 2.0 * cutoff_hz * self.recording.period_s * len(self.recording)

    def velocity(self, dofs: Sequence[str], cutoff_hz: float) -> Array:
        """Low-passed recorded velocities (n, k), away from the ends of pieces."""
        index = [self.dofs.index(dof) for dof in dofs]
        return self.inside(self.recording.nu[:, index], cutoff_hz)

    def rates(self, dofs: Sequence[str], cutoff_hz: float, reading: Reading = PLAIN) -> Array:
        """Low-passed velocities (n, k) that the pose implies if it is read in this way."""
        attitude = reading.attitude(self.recording.attitude)
        along = reading.velocity == "earth"
        jacobian = pose_jacobian(np.zeros_like(attitude) if along else attitude)
        rate = np.zeros((len(attitude), 6))
        rate[:, :3] = self.derivative(reading.path(self.position))
        rate[:, 3:] = self.derivative(attitude)
        if not self.turns:  # every axis by itself
            return self.inside(rate[:, [DOFS.index(dof) for dof in dofs]], cutoff_hz)
        body = np.empty_like(rate)
        body[:, :3] = np.einsum("nji,nj->ni", jacobian[:, :3, :3], rate[:, :3])
        turning = pose_jacobian(attitude)[:, 3:, 3:]
        body[:, 3:] = np.linalg.solve(turning, rate[:, 3:, None])[:, :, 0]
        return self.inside(body[:, [DOFS.index(dof) for dof in dofs]], cutoff_hz)

    def excited(
        self, dof: str, observed: Array, expected: Array, cutoff_hz: float, reading: Reading
    ) -> bool:
        """Whether both signals (n,) of an axis vary more than their noise below the cut-off."""
        period = self.recording.period_s
        pose = max(self.position_noise) if dof in self.linear else self.pose_noise[dof]
        pose *= DEGREE if dof in reading.degrees else 1.0
        rate_noise = pose**2 * 2.0 * period * (2.0 * np.pi) ** 2 * cutoff_hz**3 / 3.0
        return bool(
            np.var(observed) > self._least(dof, cutoff_hz)
            and np.var(expected) > max(EXCITED_VARIANCE * rate_noise, CONSTANT_VARIANCE)
        )

    def accelerates(self, dof: str, observed: Array, expected: Array, cutoff_hz: float) -> bool:
        """Whether a recorded acceleration and the derivative of the velocity (n,) exceed noise."""
        noise = self.noise[self.dofs.index(dof)] ** 2 * 2.0 * self.recording.period_s
        least = EXCITED_VARIANCE * noise * (2.0 * np.pi) ** 2 * cutoff_hz**3 / 3.0
        return bool(
            np.var(observed) > CONSTANT_VARIANCE
            and np.var(expected) > max(least, CONSTANT_VARIANCE)
        )

    def moves(self, dof: str, cutoff_hz: float) -> bool:
        """Whether a recorded velocity varies more than its noise below the cut-off."""
        return bool(np.var(self.velocity([dof], cutoff_hz)) > self._least(dof, cutoff_hz))

    def _least(self, dof: str, cutoff_hz: float) -> float:
        """Variance of the velocity of an axis that is excited, from its white noise."""
        band = 2.0 * self.recording.period_s * cutoff_hz  # share of the noise below the cut-off
        return float(
            max(EXCITED_VARIANCE * self.noise[self.dofs.index(dof)] ** 2 * band, CONSTANT_VARIANCE)
        )

    def compared(
        self, dofs: Sequence[str], cutoff_hz: float, reading: Reading = PLAIN,
        exchanged: bool = True,
    ) -> tuple[Agreement, ...]:  # fmt: skip
        """Agreement of each axis, with the axes exchanged if that is significantly better."""
        if not dofs:
            return ()
        observed, expected = self.velocity(dofs, cutoff_hz), self.rates(dofs, cutoff_hz, reading)
        rho = correlations(observed, expected)
        excited = [
            self.excited(dof, observed[:, i], expected[:, i], cutoff_hz, reading)
            for i, dof in enumerate(dofs)
        ]
        order = tuple(range(len(dofs)))
        if exchanged and len(dofs) > 1:
            moving = [self.moves(dof, cutoff_hz) for dof in dofs]
            order = best_order(rho, moving, self.samples(cutoff_hz))
        return tuple(
            Agreement(
                dof, dofs[j], float(rho[i, j]),
                scale_of(observed[:, i], expected[:, j], float(rho[i, j])), excited[i] or i != j,
            )
            for i, (dof, j) in enumerate(zip(dofs, order, strict=True))
        )  # fmt: skip

    def plain(self, cutoff_hz: float) -> tuple[Agreement, ...]:
        """Agreement of every axis as recorded, in the order of the degrees of freedom."""
        both = [
            *self.compared(self.linear, cutoff_hz, exchanged=False),
            *self.compared(self.angular, cutoff_hz, exchanged=False),
        ]
        return tuple(sorted(both, key=lambda axis: self.dofs.index(axis.dof)))

    def derivative(self, values: Array) -> Array:
        """Central differences of values (N, k), piece by piece."""
        starts = np.flatnonzero(self.recording.piece_starts)
        return np.concatenate(
            [
                central_difference(piece, self.recording.period_s)
                if len(piece) > 1
                else np.zeros_like(piece)
                for piece in np.split(values, starts[1:])
            ]
        )

    def inside(self, values: Array, cutoff_hz: float) -> Array:
        """Low-passed values (n, k) half a period of the cut-off away from the ends of pieces."""
        pieces, period = [], self.recording.period_s
        drop = round(0.5 / cutoff_hz / period)
        for piece in np.split(values, np.flatnonzero(self.recording.piece_starts)[1:]):
            if len(piece) > 2 * drop + MIN_PIECE:
                pieces.append(lowpass(piece, cutoff_hz, period)[drop : len(piece) - drop])
        return np.concatenate(pieces) if pieces else values
