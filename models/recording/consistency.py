"""How good a recording is: velocity against position, and descriptive statistics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from seatrial.models.notation import DOFS, POSE_UNIT, VELOCITY_UNIT, poses_of, velocities_of
from seatrial.models.recording.preprocessing import central_difference
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel.basis import Array

Check = Literal["integrated_velocity", "differentiated_position"]


@dataclass(frozen=True, eq=False)
class QualityCheck:
    """error = measured - calculated, Hoyer (2021), section 5.4.4.

    `integrated_velocity`: the pose against the integral of the velocity from the first pose, in m
    or rad: drift. `differentiated_position`: the velocity against the derivative of the pose, in
    m/s or rad/s: wrong signs, frames and time stamps.
    """

    check: Check
    dof: str
    unit: str
    measured: Array  # (N,)
    calculated: Array  # (N,)

    @property
    def error(self) -> Array:
        """measured - calculated, shape (N,)."""
        return self.measured - self.calculated

    @property
    def maximum(self) -> float:
        """Largest magnitude of the error."""
        return float(np.max(np.abs(self.error)))


@dataclass(frozen=True)
class Description:
    """Descriptive statistics of one column; std with n - 1."""

    name: str
    count: int
    mean: float
    std: float
    median: float
    minimum: float
    maximum: float


def quality_checks(recording: Recording) -> tuple[QualityCheck, ...]:
    """Both checks of every degree of freedom.

    Exact for surge-sway-yaw, for all six, and for axes without angles; what another set does not
    hold (a heave velocity that pitch would turn forward) is taken as zero.
    """
    from scipy.integrate import cumulative_trapezoid  # slow to import

    turning = pose_jacobian(attitude_of(recording.dofs, recording.eta))
    index = [DOFS.index(dof) for dof in recording.dofs]
    turning = turning[:, index][:, :, index]
    rate = np.einsum("nij,nj->ni", turning, recording.nu)
    start = recording.eta[0]
    pose = start + cumulative_trapezoid(rate, dx=recording.period_s, axis=0, initial=0.0)
    measured_rate = central_difference(recording.eta, recording.period_s)
    nu = np.einsum("nij,nj->ni", np.linalg.pinv(turning), measured_rate)
    checks = []
    for i, dof in enumerate(recording.dofs):
        eta, unit, speed = recording.eta[:, i], POSE_UNIT[dof], VELOCITY_UNIT[dof]
        checks += [
            QualityCheck("integrated_velocity", dof, unit, eta, pose[:, i]),
            QualityCheck("differentiated_position", dof, speed, recording.nu[:, i], nu[:, i]),
        ]
    return tuple(checks)


def quality_series(checks: Sequence[QualityCheck]) -> tuple[dict[str, Array], dict[str, str]]:
    """Columns and units of the error series: `x_error`, `u_error` and so on."""
    columns, units = {}, {}
    for one in checks:
        pose = one.check == "integrated_velocity"
        (name,) = poses_of([one.dof]) if pose else velocities_of([one.dof])
        columns[f"{name}_error"], units[f"{name}_error"] = one.error, one.unit
    return columns, units


def pose_jacobian(angles: Array) -> Array:
    """J of eta_dot = J(eta) nu, shape (N, 6, 6), from (phi, theta, psi) [rad], shape (N, 3).

    J = diag(R, T), Fossen (2011), eqs. (2.18) and (2.28); T is singular at theta = +-90 deg.
    """
    (cf, ct, cp), (sf, st, sp) = np.cos(angles).T, np.sin(angles).T
    ct_away = np.where(np.abs(ct) < 1e-6, 1e-6, ct)
    zero, one = np.zeros_like(cf), np.ones_like(cf)
    rotation = [
        [cp * ct, cp * st * sf - sp * cf, cp * st * cf + sp * sf],
        [sp * ct, sp * st * sf + cp * cf, sp * st * cf - cp * sf],
        [-st, ct * sf, ct * cf],
    ]
    rates = [
        [one, sf * st / ct_away, cf * st / ct_away],
        [zero, cf, -sf],
        [zero, sf / ct_away, cf / ct_away],
    ]
    jacobian = np.zeros((len(angles), 6, 6))
    jacobian[:, :3, :3] = np.moveaxis(np.array(rotation), -1, 0)
    jacobian[:, 3:, 3:] = np.moveaxis(np.array(rates), -1, 0)
    return jacobian


def describe(columns: Mapping[str, Array]) -> tuple[Description, ...]:
    """Descriptive statistics of columns, in their order; empty cells (NaN) do not count."""
    described = []
    for name, values in columns.items():
        x = values[~np.isnan(values)]
        if not len(x):
            described.append(Description(name, 0, *(float("nan"),) * 5))
            continue
        std = float(np.std(x, ddof=1)) if len(x) > 1 else float("nan")
        described.append(
            Description(
                name, len(x), float(np.mean(x)), std, float(np.median(x)), float(np.min(x)),
                float(np.max(x)),
            )
        )  # fmt: skip
    return tuple(described)
