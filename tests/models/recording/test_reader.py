"""Columns of any frame, clock and sensor become poses and velocities of the vessel's origin."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.recording.column_map import ColumnMap, Frames
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian

PERIOD = 0.05
ANGLES = {"roll": "phi", "pitch": "theta", "yaw": "psi"}
WGS84 = (6378137.0, 0.0066943799901413165)  # [m] semi-major axis, squared eccentricity


@dataclass(frozen=True)
class Motion:
    """Time (N,), pose (N, 6) and body velocity (N, 6) of the origin of a vessel."""

    t: Array
    eta: Array
    nu: Array


@pytest.fixture(scope="module")
def motion() -> Motion:
    """A vessel that turns in a swell, from the integral of its velocities."""
    t = np.arange(0.0, 60.0, PERIOD)
    size = np.array([0.4, 0.3, 0.2, 0.1, 0.08, 0.15])
    rate = np.array([0.3, 0.25, 0.4, 0.5, 0.45, 0.2])

    def velocity(at: Array | float) -> Array:
        mean = [1.0, 0.0, 0.0, 0.0, 0.0, 0.1]
        return np.asarray(mean + size * np.sin(np.multiply.outer(at, rate) + np.arange(6)))

    def rates(at: float, eta: Array) -> Array:
        return np.asarray(pose_jacobian(eta[None, 3:])[0] @ velocity(at))

    start = [3.0, -2.0, 1.0, 0.05, -0.04, 0.6]
    solution = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-10)
    return Motion(t, solution.y.T, velocity(t))


def _columns(**changes: object) -> ColumnMap:
    """A map with our own names, changed."""
    names = dict(zip(DOFS, ("x", "y", "z", *ANGLES.values()), strict=True))
    rates = dict(zip(DOFS, "uvwpqr", strict=True))
    known = {"time": "t", "position": names, "velocity": rates, "acceleration": {}, "force": {},
             "actual_force": {}, "orientation": None}  # fmt: skip
    return ColumnMap(**{**known, **changes})  # type: ignore[arg-type]


def _frame(motion: Motion) -> pd.DataFrame:
    table = np.column_stack([motion.t, motion.eta, motion.nu])
    return pd.DataFrame(table, columns=["t", "x", "y", "z", *ANGLES.values(), *"uvwpqr"])


def _read(folder: Path, frame: pd.DataFrame, columns: ColumnMap) -> tuple[Array, Array, Array]:
    """Time, pose and velocity, as the reader makes them of a file with these columns."""
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    (signals,) = RecordedFile(path=str(path), columns=columns).account(DOFS)
    table = signals.values
    return (
        signals.t,
        np.column_stack([table[f"position.{dof}"] for dof in DOFS]),
        np.column_stack([table[f"velocity.{dof}"] for dof in DOFS]),
    )


def test_latitude_and_longitude_by_the_radii_of_the_ellipsoid(
    tmp_path: Path, motion: Motion
) -> None:
    """Over a hundred metres north is M dphi and east N cos(phi) dlambda."""
    axis, squared = WGS84
    latitude = np.radians(63.4)
    narrow = 1.0 - squared * np.sin(latitude) ** 2
    meridian, transverse = axis * (1.0 - squared) / narrow**1.5, axis / np.sqrt(narrow)
    moved = motion.eta[:, :3] - motion.eta[0, :3]
    frame = _frame(motion).drop(columns=["x", "y", "z"])
    frame["lat"] = np.degrees(latitude + moved[:, 0] / meridian)
    frame["lon"] = 10.4 + np.degrees(moved[:, 1] / (transverse * np.cos(latitude)))
    frame["alt"] = 40.0 - moved[:, 2]
    geodetic = {"latitude": "lat", "longitude": "lon", "altitude": "alt"}
    columns = _columns(position=ANGLES, geodetic=geodetic)
    _, pose, _ = _read(tmp_path, frame, columns)
    assert np.ptp(moved, axis=0).max() > 10.0
    # Flat to second order: s^2 / 2 R down, s^2 tan(phi) / R across.
    bound = 2.0 * np.max(np.hypot(moved[:, 0], moved[:, 1])) ** 2 / meridian + 1e-6
    np.testing.assert_allclose(pose[:, :3], moved, atol=bound)


def test_metres_as_degrees_are_refused(tmp_path: Path, motion: Motion) -> None:
    frame = _frame(motion).assign(x=6.7e6)
    columns = _columns(position=ANGLES, geodetic={"latitude": "x", "longitude": "y"})
    with pytest.raises(RecordingError, match=r"columns.geodetic: got 6.7e\+06, .*expected degrees"):
        _read(tmp_path, frame, columns)


def test_a_sensor_at_a_lever_arm(tmp_path: Path, motion: Motion) -> None:
    """What it measures is the pose and velocity of its own point of the rigid body."""
    arm = np.array([1.5, -0.4, -0.8])
    attitude = Rotation.from_euler("ZYX", motion.eta[:, [5, 4, 3]])
    frame = _frame(motion)
    frame[["x", "y", "z"]] = motion.eta[:, :3] + attitude.apply(arm)
    frame[["u", "v", "w"]] = motion.nu[:, :3] + np.cross(motion.nu[:, 3:], arm)
    _, pose, velocity = _read(tmp_path, frame, _columns(lever_arm_m=tuple(arm)))
    np.testing.assert_allclose(pose, motion.eta, atol=1e-9)
    np.testing.assert_allclose(velocity, motion.nu, atol=1e-9)


def test_east_north_up_and_forward_left_up(tmp_path: Path, motion: Motion) -> None:
    """Our axes are R_x(pi) of forward, left, up, and the earth's exchange north and east."""
    down = Rotation.from_euler("ZYX", motion.eta[:, [5, 4, 3]])
    swapped = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    up = swapped * down * Rotation.from_euler("x", np.pi)
    frame = _frame(motion)
    frame[["x", "y", "z"]] = swapped.apply(motion.eta[:, :3])
    frame[["qx", "qy", "qz", "qw"]] = up.as_quat()
    frame[["v", "w", "q", "r"]] *= -1.0
    columns = _columns(
        orientation={"w": "qw", "x": "qx", "y": "qy", "z": "qz"},
        frames=Frames(position="ENU", attitude="ENU", body="FLU"),
    )
    _, pose, velocity = _read(tmp_path, frame, columns)
    np.testing.assert_allclose(pose[:, :5], motion.eta[:, :5], atol=1e-9)
    turns = (pose[:, 5] - motion.eta[:, 5]) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-9)
    np.testing.assert_allclose(velocity, motion.nu, atol=1e-12)


def test_velocities_along_the_earth(tmp_path: Path, motion: Motion) -> None:
    frame = _frame(motion)
    attitude = Rotation.from_euler("ZYX", motion.eta[:, [5, 4, 3]])
    frame[["u", "v", "w"]] = attitude.apply(motion.nu[:, :3])
    _, _, velocity = _read(tmp_path, frame, _columns(frames=Frames(velocity="earth")))
    np.testing.assert_allclose(velocity, motion.nu, atol=1e-9)
    with pytest.raises(RecordingError, match=r"one of surge and sway along the axes of the earth"):
        _read(tmp_path, frame, _columns(frames=Frames(velocity="earth"), velocity={"sway": "v"}))


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
def test_velocities_differentiated_from_the_pose(
    tmp_path: Path, motion: Motion, noise_m: float
) -> None:
    """Without a phase, and with less noise than differences of the noisy pose have."""
    rng = np.random.default_rng(7)
    frame = _frame(motion).drop(columns=list("uvwpqr"))
    scale = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # [m] and rad
    noise = noise_m * scale * rng.standard_normal(motion.eta.shape)
    frame[["x", "y", "z", *ANGLES.values()]] += noise
    _, _, velocity = _read(tmp_path, frame, _columns(velocity={}))
    inner = slice(100, -100)
    error = np.sqrt(np.mean((velocity - motion.nu)[inner] ** 2, axis=0))
    crude = noise_m * scale / (np.sqrt(2.0) * PERIOD)  # of central differences
    np.testing.assert_array_less(error, 0.2 * crude + 0.002 * np.ptp(motion.nu, axis=0))
    rate = np.gradient(motion.nu, PERIOD, axis=0)[inner]
    ahead = np.sum((velocity - motion.nu)[inner] * rate, axis=0) / np.sum(rate**2, axis=0)
    np.testing.assert_array_less(np.abs(ahead), (0.02 if noise_m == 0.0 else 0.5) * PERIOD)
