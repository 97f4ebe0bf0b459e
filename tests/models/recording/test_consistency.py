"""Quality checks against motions known in closed form, statistics against printed tables."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seatrial.models.recording.consistency import (
    describe,
    quality_checks,
    quality_series,
)
from seatrial.models.recording.csv_table import read_table
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian

PLANAR = ("surge", "sway", "yaw")
ALL = ("surge", "sway", "heave", "roll", "pitch", "yaw")


def recording_of(dofs: tuple[str, ...], period_s: float, eta: Array, nu: Array) -> Recording:
    zero = np.zeros_like(nu)
    t = period_s * np.arange(len(nu))
    return Recording(dofs, t, eta, nu, zero, zero, attitude_of(dofs, eta))


def circle(n: int = 601, period_s: float = 0.1) -> Recording:
    """A steady turn: u = 0.5 m/s, r = 0.1 rad/s, hence a circle of 5 m."""
    t = period_s * np.arange(n)
    psi = 0.3 + 0.1 * t
    eta = np.column_stack([5.0 * np.sin(psi), -5.0 * np.cos(psi), psi])
    return recording_of(PLANAR, period_s, eta, np.tile([0.5, 0.0, 0.1], (n, 1)))


def six(period_s: float, n: int) -> Recording:
    """Smooth angles and positions; the velocities follow from exact derivatives."""
    t = period_s * np.arange(n)
    frequencies, sizes = np.array([0.3, 0.4, 0.5]), np.array([0.4, 0.5, 2.5])
    angles = sizes * np.sin(np.outer(t, frequencies))
    angle_rates = sizes * frequencies * np.cos(np.outer(t, frequencies))
    positions, rates = 2.0 * np.sin(angles), 2.0 * np.cos(angles) * angle_rates
    eta, eta_dot = np.hstack([positions, angles]), np.hstack([rates, angle_rates])
    nu = np.linalg.solve(pose_jacobian(angles), eta_dot[..., None])[..., 0]
    return recording_of(ALL, period_s, eta, nu)


def test_jacobian_is_the_derivative_of_the_rotation() -> None:
    """R_dot = R S(omega), with angle rates T omega; R against scipy's."""
    rng = np.random.default_rng(1)
    angles = rng.uniform([-3.0, -1.4, -3.0], [3.0, 1.4, 3.0], (20, 3))
    omega = rng.standard_normal((20, 3))
    jacobian = pose_jacobian(angles)
    rotation = Rotation.from_euler("ZYX", angles[:, ::-1])
    np.testing.assert_allclose(jacobian[:, :3, :3], rotation.as_matrix(), atol=1e-12)
    h = 1e-6
    moved = rotation * Rotation.from_rotvec(h * omega)
    change = np.angle(np.exp(1j * (moved.as_euler("ZYX")[:, ::-1] - angles))) / h
    expected = np.einsum("nij,nj->ni", jacobian[:, 3:, 3:], omega)
    np.testing.assert_allclose(change, expected, atol=1e-4)


def test_exact_motion_passes_both_checks() -> None:
    """What is left is the trapezoid's and the central difference's own error, of second order."""
    largest = []
    for period_s, n in ((0.1, 601), (0.05, 1201)):
        largest.append([check.maximum for check in quality_checks(six(period_s, n))])
    assert np.max(largest[1]) < 0.01
    np.testing.assert_allclose(np.log2(np.divide(*largest)), 2.0, atol=0.2)
    assert max(check.maximum for check in quality_checks(circle())) < 1e-3


def test_wrong_sign_and_drift_are_seen() -> None:
    good = circle()
    backward = recording_of(PLANAR, 0.1, good.eta * [-1.0, 1.0, 1.0], good.nu)
    worst = {(c.check, c.dof): c.maximum for c in quality_checks(backward)}
    assert worst["differentiated_position", "surge"] > 0.9  # 2 u, when it sails north
    bias = np.array([0.0, 0.0, 0.01])
    biased = recording_of(PLANAR, 0.1, good.eta, good.nu + bias)
    yaw = next(
        c for c in quality_checks(biased) if (c.check, c.dof) == ("integrated_velocity", "yaw")
    )
    assert yaw.unit == "rad"
    assert yaw.maximum == pytest.approx(0.6)
    np.testing.assert_allclose(yaw.error, -0.01 * biased.t, atol=1e-12)  # measured - calculated


def test_one_axis_needs_no_attitude() -> None:
    t = 0.1 * np.arange(50)
    recording = recording_of(("surge",), 0.1, (t**2)[:, None], 2.0 * t[:, None])
    assert max(check.maximum for check in quality_checks(recording)) < 1e-9


def test_series_are_named_by_pose_and_velocity() -> None:
    columns, units = quality_series(quality_checks(circle()))
    assert list(columns) == ["x_error", "u_error", "y_error", "v_error", "psi_error", "r_error"]
    assert units == {
        "x_error": "m", "u_error": "m/s", "y_error": "m", "v_error": "m/s",
        "psi_error": "rad", "r_error": "rad/s",
    }  # fmt: skip
    assert all(values.shape == (601,) for values in columns.values())


def test_description() -> None:
    (one, empty) = describe({"x": np.array([1.0, np.nan, 2.0, 6.0]), "y": np.full(4, np.nan)})
    assert (one.name, one.count, one.mean, one.median) == ("x", 3, 3.0, 2.0)
    assert (one.minimum, one.maximum) == (1.0, 6.0)
    assert one.std == pytest.approx(np.sqrt(7.0))
    assert empty.count == 0
    assert np.isnan(empty.mean)


def printed(path: Path) -> dict[str, list[str]]:
    """Rows of a table of Hoyer's thesis: name -> N, mean, std, median, min, max as printed."""
    rows = {}
    for line in path.read_text().splitlines():
        if re.match(r"\w[\w\\]* *&", line):
            name, *cells = line.removesuffix("\\\\").replace("\\_", "_").split("&")
            rows[name.strip()] = [cell.strip() for cell in cells]
    return rows


@pytest.mark.parametrize("name", ["surge-1", "sway-1", "heave-1", "random-1"])
def test_statistics_equal_the_thesis_to_two_decimals(name: str) -> None:
    folder = os.environ.get("SEATRIAL_DATA")
    if not folder:
        pytest.skip("SEATRIAL_DATA is not set: no outside data")
    beluga = Path(folder) / "beluga"
    table = printed(beluga / "thesis_stats_tex" / f"{name}.tex")
    assert len(table) == 18
    found = describe(read_table(beluga / f"{name}.csv", list(table)).columns)
    for one in found:
        values = (one.count, one.mean, one.std, one.median, one.minimum, one.maximum)
        assert [f"{value:.2f}" for value in values] == table[one.name], one.name
