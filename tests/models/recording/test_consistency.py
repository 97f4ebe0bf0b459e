"""Pose and velocity of measured recordings: what does not agree is named with its cure."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from scipy.interpolate import CubicSpline

from seatrial.models.recording.consistency import consistency
from seatrial.models.recording.diagnosis import RecordingDefect
from seatrial.models.recording.preprocessing import without_sign_flips
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.kinematics import euler_zyx, pose_jacobian
from seatrial.runner.config import build_as
from tests.data import DATA

CONF = Path(__file__).parents[3] / "conf" / "excitation" / "recording.yaml"
ALL = ("surge", "sway", "heave", "roll", "pitch", "yaw")
VELOCITY = {dof: f"{dof}_vel" for dof in ALL}
RECORDINGS = ("surge-1", "sway-1", "heave-1", "random-1")
Mutilation = Callable[[pd.DataFrame], pd.DataFrame]


BELUGA = DATA / "beluga"


def recorded(path: Path) -> RecordedFile:
    node = OmegaConf.merge(OmegaConf.load(CONF), {"path": str(path)})
    file = build_as(object, OmegaConf.to_container(node), "excitation")
    assert isinstance(file, RecordedFile)
    return file


def scaled(columns: tuple[str, ...], factor: float) -> Mutilation:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        return table.assign(**{name: table[name] * factor for name in columns})

    return change


def exchanged(first: str, second: str) -> Mutilation:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        return table.assign(**{first: table[second], second: table[first]})

    return change


def in_enu(table: pd.DataFrame) -> pd.DataFrame:
    """The positions of the basin as east, north, up: the map negates x and y, not Z."""
    return table.assign(
        position_x=table["position_y"], position_y=table["position_x"],
        position_Z=-table["position_Z"],
    )  # fmt: skip


def delayed(seconds: float) -> Mutilation:
    """Velocities by a clock that is behind."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        t = table["Time"]
        late = {name: np.interp(t - seconds, t, table[name]) for name in VELOCITY.values()}
        return table.assign(**late)

    return change


def along_earth(table: pd.DataFrame) -> pd.DataFrame:
    """Velocities along the axes of the basin that the pose is in."""
    names = [f"orientation_{part}" for part in "wxyz"]
    attitude = euler_zyx(table[names].to_numpy()) - [0.0, 0.0, np.pi]
    jacobian = pose_jacobian(attitude)[:, :3, :3]
    names = [VELOCITY[dof] for dof in ALL[:3]]
    velocity = np.einsum("nij,nj->ni", jacobian, table[names].to_numpy())
    return table.assign(**dict(zip(names, velocity.T, strict=True)))


def resampled(rate_hz: float, smoothly: bool) -> Mutilation:
    """The file of 10 Hz at another rate, by linear interpolation or by cubic splines."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        t = table["Time"].to_numpy()
        grid = np.arange(t[0], t[-1], 1.0 / rate_hz)
        names = [f"orientation_{part}" for part in "wxyz"]
        turns = without_sign_flips(table[names].to_numpy())
        table = table.assign(**dict(zip(names, turns.T, strict=True))).astype(float)
        columns = {
            name: CubicSpline(t, table[name])(grid) if smoothly else np.interp(grid, t, table[name])
            for name in table if name != "Time"
        }  # fmt: skip
        result = pd.DataFrame({"Time": np.round(grid, 6), **columns})
        return result.assign(**{name: result[name] / np.linalg.norm(result[names], axis=1)
                                for name in names})  # fmt: skip

    return change


LINEAR, ANGULAR = tuple(VELOCITY.values())[:3], tuple(VELOCITY.values())[3:]
KNOT = 1852.0 / 3600.0
# What is done to a file, the kind of problem, its axes, and what the cure says.
MUTILATIONS: dict[str, tuple[Mutilation, str, tuple[str, ...], str]] = {
    "knots": (scaled(LINEAR, 1.0 / KNOT), "scale", ALL[:3], "unit: knot"),
    "degrees": (scaled(ANGULAR, 180.0 / np.pi), "scale", ALL[3:], "unit: deg/s"),
    "surge reversed": (scaled(("surge_vel",), -1.0), "sign", ("surge",), "surge=-surge_vel"),
    "sway reversed": (scaled(("sway_vel",), -1.0), "sign", ("sway",), "sway=-sway_vel"),
    "heave reversed": (scaled(("heave_vel",), -1.0), "sign", ("heave",), "heave=-heave_vel"),
    "yaw reversed": (scaled(("yaw_vel",), -1.0), "sign", ("yaw",), "yaw=-yaw_vel"),
    "p and r": (exchanged("roll_vel", "yaw_vel"), "swap", ("roll", "yaw"), "roll=yaw_vel"),
    "u and v": (exchanged("surge_vel", "sway_vel"), "swap", ("surge", "sway"), "surge=sway_vel"),
    "NED for ENU": (in_enu, "frame", ALL[:3], "frames.position=ENU"),
    "shifted clock": (delayed(0.4), "clock", (), "delay_s.velocity"),
    "resampled": (resampled(25.0, False), "resampled", (), "resample_hz=10"),
    "resampled smoothly": (resampled(17.0, True), "resampled", (), "resample_hz=10"),
    "along earth": (along_earth, "earth", ALL[:3], "frames.velocity=earth"),
}  # fmt: skip


def found(path: Path) -> tuple[RecordingDefect, ...]:
    examination = recorded(path).examine(ALL)
    assert examination is not None
    return examination.problems


@pytest.mark.data
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.nightly if number else pytest.mark.slow)
        for number, name in enumerate(RECORDINGS)
    ],
)
def test_mutilated_recordings_are_named_with_their_cures(tmp_path: Path, name: str) -> None:
    """Each of the 13 mutilations is named once, with its axes and its cure, and nothing else."""
    table, wrong = pd.read_csv(BELUGA / f"{name}.csv"), []
    for mutilation, (change, kind, axes, cure) in MUTILATIONS.items():
        path = tmp_path / "mutilated.csv"
        change(table).to_csv(path, index=False)
        problems = found(path)
        right = len(problems) == 1 and problems[0].kind == kind and cure in problems[0].cure
        if not (right and set(problems[0].axes) == set(axes)):
            wrong.append((mutilation, [str(problem) for problem in problems]))
    assert wrong == []


@pytest.mark.data
def test_recordings_as_they_are_have_no_problem() -> None:
    for name in RECORDINGS:
        assert found(BELUGA / f"{name}.csv") == (), name


def motion(n: int = 4000, period: float = 0.1) -> Recording:
    """A planar motion of which pose and velocity belong together to second order."""
    t = period * np.arange(n)
    u = 1.0 + 0.4 * np.sin(0.31 * t) + 0.3 * np.sin(0.83 * t)
    v, r = 0.2 * np.sin(0.53 * t + 1.0), 0.1 * np.sin(0.21 * t) + 0.08 * np.cos(0.67 * t)
    psi = np.concatenate([[0.0], np.cumsum(0.5 * (r[1:] + r[:-1]) * period)])
    speed = np.column_stack([u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)])
    path = np.vstack([np.zeros(2), np.cumsum(0.5 * (speed[1:] + speed[:-1]) * period, axis=0)])
    nu = np.column_stack([u, v, r])
    eta = np.column_stack([path, psi])
    attitude = np.column_stack([np.zeros((n, 2)), psi])
    return Recording(ALL[:2] + ALL[5:], t, eta, nu, np.gradient(nu, period, axis=0),
                     np.zeros_like(nu), attitude)  # fmt: skip


def test_exact_motion_agrees_to_one() -> None:
    result = consistency(motion())
    for axis in result.velocities:
        assert axis.excited
        assert axis.correlation > 0.9999
        assert axis.scale == pytest.approx(1.0, abs=2e-3)
    assert abs(result.lag_s) < 1e-3
    assert not result.untrusted


@pytest.mark.parametrize("seconds", np.linspace(0.0, 0.5, 20))
def test_delay_is_recovered_within_a_sample(seconds: float) -> None:
    recording = motion()
    t, nu = recording.t, recording.nu
    late = np.column_stack([np.interp(t - seconds, t, column) for column in nu.T])
    shifted = Recording(recording.dofs, t, recording.eta, late, recording.nu_dot,
                        recording.tau, recording.attitude)  # fmt: skip
    assert consistency(shifted).lag_s == pytest.approx(seconds, abs=0.2 * recording.period_s)


def test_velocity_of_something_else_is_not_trusted() -> None:
    recording = motion()
    rng = np.random.default_rng(1)
    nu = recording.nu.copy()
    walk = np.cumsum(rng.normal(size=len(nu)))
    nu[:, 1] = 0.1 * np.sin(walk / 10.0)
    other = Recording(recording.dofs, recording.t, recording.eta, nu, recording.nu_dot,
                      recording.tau, recording.attitude)  # fmt: skip
    result = consistency(other)
    assert [axis.dof for axis in result.untrusted] == ["sway"]
