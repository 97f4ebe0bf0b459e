"""How good a recording is: velocity against position, and descriptive statistics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from seatrial.models.notation import DOFS
from seatrial.models.recording.preprocessing import central_difference
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian
from seatrial.models.vessel.table import POSE_NAMES

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
        unit = "m" if dof in DOFS[:3] else "rad"
        checks += [
            QualityCheck("integrated_velocity", dof, unit, recording.eta[:, i], pose[:, i]),
            QualityCheck("differentiated_position", dof, f"{unit}/s", recording.nu[:, i], nu[:, i]),
        ]
    return tuple(checks)


def quality_series(checks: Sequence[QualityCheck]) -> tuple[dict[str, Array], dict[str, str]]:
    """Columns and units of the error series: `x_error`, `u_error` and so on."""
    columns, units = {}, {}
    for one in checks:
        pose = one.check == "integrated_velocity"
        name = POSE_NAMES[one.dof] if pose else "uvwpqr"[DOFS.index(one.dof)]
        columns[f"{name}_error"], units[f"{name}_error"] = one.error, one.unit
    return columns, units


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
