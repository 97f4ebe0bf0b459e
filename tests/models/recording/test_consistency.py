"""Pose and velocity of measured recordings: what does not agree is named with what mends it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import CubicSpline

from seatrial.models.recording.consistency import consistency
from seatrial.models.recording.diagnosis import Examination, changed, examine
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.signals import original_rate, without_sign_flips
from seatrial.models.vessel.kinematics import euler_zyx, pose_jacobian
from seatrial.runner.configuration.named_files import options_of, reader_of
from tests.data import DATA
from tests.models.recording.test_file_set import reader

ALL = ("surge", "sway", "heave", "roll", "pitch", "yaw")
VELOCITY = {dof: f"{dof}_vel" for dof in ALL}
RECORDINGS = ("surge-1", "sway-1", "heave-1", "random-1")
Mutilation = Callable[[pd.DataFrame], pd.DataFrame]
BELUGA = DATA / "beluga"


def scaled(columns: tuple[str, ...], factor: float) -> Mutilation:
    return lambda table: table.assign(**{name: table[name] * factor for name in columns})


def exchanged(first: str, second: str) -> Mutilation:
    return lambda table: table.assign(**{first: table[second], second: table[first]})


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
        problems = examine(reader(path=str(path)), ALL).problems
        right = len(problems) == 1 and problems[0].kind == kind and cure in problems[0].fix
        if not (right and set(problems[0].axes) == set(axes)):
            wrong.append((mutilation, [str(problem) for problem in problems]))
    assert wrong == []


@pytest.mark.data
def test_recordings_as_they_are_have_no_problem() -> None:
    for name in RECORDINGS:
        known = examine(reader(path=f"{BELUGA}/{name}.csv"), ALL)
        assert (known.problems, known.questions) == ((), ()), name


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
    for axis in result.axes:
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
    shifted = replace(recording, nu=late)
    assert consistency(shifted).lag_s == pytest.approx(seconds, abs=0.2 * recording.period_s)


@pytest.mark.parametrize("seconds", [0.0, 0.3])
def test_a_delay_is_found_where_pieces_are_missing(tmp_path: Path, seconds: float) -> None:
    """Two gaps, of 20 s and of 61.7 s: nothing is shifted, filtered or compared across them."""
    known = motion()
    t = known.t
    table = dict(zip(("north", "east", "psi"), known.eta.T, strict=True))
    late = [np.interp(t - seconds, t, column) for column in known.nu.T]
    table |= dict(zip("uvr", late, strict=True))
    there = ((t < 100.0) | (t >= 120.0)) & ((t < 250.0) | (t >= 311.7))
    path = tmp_path / "log.csv"
    pd.DataFrame({"t": t, "n": 1.0, **table})[there].to_csv(path, index=False)
    found = examined(path, at_gap="split")
    assert len(found.recording.pieces()) == 3
    assert found.result.lag_s == pytest.approx(seconds, abs=0.5 * known.period_s)
    assert [problem.kind for problem in found.problems] == (["clock"] if seconds else [])


def test_velocity_of_something_else_is_not_trusted() -> None:
    recording = motion()
    rng = np.random.default_rng(1)
    nu = recording.nu.copy()
    walk = np.cumsum(rng.normal(size=len(nu)))
    nu[:, 1] = 0.1 * np.sin(walk / 10.0)
    result = consistency(replace(recording, nu=nu))
    assert [axis.dof for axis in result.untrusted] == ["sway"]


def log(path: Path, **new: np.ndarray | float) -> Path:
    """The planar motion as a file of its own, with columns replaced."""
    known = motion()
    names = ("north", "east", "psi", "u", "v", "r")
    columns = dict(zip(names, np.hstack([known.eta, known.nu]).T, strict=True))
    pd.DataFrame({"t": known.t, "n": 1.0, **columns, **new}).to_csv(path, index=False)
    return path


PLANAR_MAP: dict[str, object] = {
    "time": "t", "inputs": {"n": "n"}, "position": {"surge": "north", "sway": "east", "yaw": "psi"},
    "velocity": {"surge": "u", "sway": "v", "yaw": "r"},
}  # fmt: skip


def examined(path: Path, **new: object) -> Examination:
    return examine(reader_of(path, options_of({**PLANAR_MAP, **new})), ("surge", "sway", "yaw"))


def test_heading_is_the_same_wrapped_or_over_several_turns(tmp_path: Path) -> None:
    """In radians beyond what a range would call degrees; no guess overrides the map."""
    psi = 12.0 * motion().eta[:, 2]
    results = []
    for values in (psi, (psi + np.pi) % (2.0 * np.pi) - np.pi):
        path = log(tmp_path / "log.csv", psi=values, r=12.0 * motion().nu[:, 2])
        found = examined(path, position={"yaw": "psi"}, velocity={"yaw": "r"})
        assert found.problems == ()
        results.append(found.result.axes[0])
    assert results[0].correlation == pytest.approx(results[1].correlation, abs=1e-12)
    assert results[0].scale == pytest.approx(results[1].scale, abs=1e-12)
    assert results[0].scale == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize(
    ("new", "change"),
    [
        ({"u": motion().nu[:, 0] / KNOT}, {"velocity.surge": {"column": "u", "unit": "knot"}}),
        ({"psi": np.degrees(motion().eta[:, 2])},
         {"position.yaw": {"column": "psi", "unit": "deg"}}),
        ({"psi": -motion().eta[:, 2]},
         {"position.yaw": {"column": "psi", "positive": "anticlockwise"}}),
        ({"u": motion().nu[:, 1], "v": motion().nu[:, 0]},
         {"velocity.surge": "v", "velocity.sway": "u"}),
        ({"u": motion().nu[:, 1] / KNOT, "v": motion().nu[:, 0]},
         {"velocity.surge": "v", "velocity.sway": {"column": "u", "unit": "knot"}}),
        ({"t": 1e3 * motion().t}, {"time": {"column": "t", "unit": "ms"}}),
    ],
)  # fmt: skip
def test_the_change_of_a_problem_mends_it(
    tmp_path: Path, new: dict[str, np.ndarray], change: dict[str, object]
) -> None:
    path = log(tmp_path / "log.csv", **new)
    found = examined(path).problems
    together = {name: value for problem in found for name, value in problem.change.items()}
    assert together == {f"columns.{name}": value for name, value in change.items()}
    mended = changed(reader_of(path, options_of(dict(PLANAR_MAP))), together)
    assert examine(mended, ALL).problems == ()


def test_a_factor_of_no_unit_is_a_question(tmp_path: Path) -> None:
    known = examined(log(tmp_path / "log.csv", u=motion().nu[:, 0] * 0.4))
    assert known.problems == ()
    assert known.questions == ("u is 0.40 of d(position)/dt: which unit?",)


def test_a_small_drift_of_a_ship_on_her_way_is_not_of_another_unit(tmp_path: Path) -> None:
    """A path that is half a sample late changes a drift of 0.3 m r by 0.2 m r."""
    t = np.arange(0.0, 300.0, 0.2)
    r = 0.05 * np.sin(0.2 * t) + 0.02 * np.sin(0.07 * t)
    psi = 0.2 * np.cumsum(r)
    u, v = np.full(len(t), 2.0), -0.3 * r
    north = 0.2 * np.cumsum(u * np.cos(psi) - v * np.sin(psi))
    east = 0.2 * np.cumsum(u * np.sin(psi) + v * np.cos(psi))
    n = np.random.default_rng(1).normal(scale=0.02, size=(6, len(t)))
    pose = {"north": north + n[0], "east": east + n[1], "psi": psi + 0.1 * n[2]}
    rates = {"u": u + n[3], "v": v + n[4], "r": r + 0.1 * n[5]}
    (problem,) = examined(log(tmp_path / "log.csv", t=t, **pose, **rates)).problems
    assert problem.axes == ("sway",)
    assert problem.change == {}


def test_what_nothing_mends_has_no_change(tmp_path: Path) -> None:
    noise = np.convolve(np.random.default_rng(3).normal(size=4000), np.ones(40) / 40.0, "same")
    (problem,) = examined(log(tmp_path / "log.csv", v=noise)).problems
    assert problem.axes == ("sway",)
    assert problem.change == {}
    assert "no change of the map" in str(problem)


def test_only_recorded_velocities_are_compared(tmp_path: Path) -> None:
    """Without sway velocity there is no delay, and nothing is said of the heading."""
    known = examined(log(tmp_path / "log.csv"), velocity={"surge": "u", "yaw": "r"})
    assert [axis.dof for axis in known.result.axes] == ["surge", "yaw"]
    assert known.problems == ()
    (line,) = known.not_compared
    assert line.startswith("no velocity in sway is recorded")


def test_a_wide_angle_that_no_motion_tells_is_a_question(tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", psi=np.degrees(motion().eta[:, 2]) + 90.0)
    known = examined(path, velocity={})
    assert len(known.questions) == 1
    assert known.questions[0].startswith("psi ranges from")
    stated = {**PLANAR_MAP["position"], "yaw": {"column": "psi", "unit": "rad"}}  # type: ignore[dict-item]
    assert examined(path, velocity={}, position=stated).questions == ()
    path = log(tmp_path / "log.csv", psi=90.0 - np.degrees(motion().eta[:, 2]))
    (problem,) = examined(path, velocity={}).problems  # the way is ahead
    degrees = {"columns.position.yaw": {"column": "psi", "unit": "deg"}}
    assert problem.change == {**degrees, "columns.frames.attitude": "ENU"}


def test_an_attitude_that_is_lost_for_a_moment_is_left_out() -> None:
    """A second of a wrong attitude, with jumps: the rest agrees as before."""
    known = motion()
    wrong = known.attitude.copy()
    wrong[1000:1003], wrong[1003:1010] = [1.0, 0.4, 2.0], [-2.0, 0.9, -1.0]
    result = consistency(replace(known, attitude=wrong))
    assert all(axis.correlation > 0.97 for axis in result.axes)
    assert result.axes[2].scale == pytest.approx(1.0, abs=0.02)


def test_roll_rate_agrees_through_a_steep_dive() -> None:
    """Pitch to 86 degrees and back: the angles of roll and yaw jump, the rotation does not."""
    n, h = 6000, 0.05
    t = h * np.arange(n)
    theta = np.radians(86.0) * np.sin(0.21 * t) ** 2
    phi, psi = 0.3 * np.sin(0.9 * t), 0.5 * np.sin(0.13 * t)
    attitude = np.column_stack([phi, theta, psi])
    rates = np.column_stack([0.27 * np.cos(0.9 * t), np.radians(86.0) * 0.21 * np.sin(0.42 * t),
                             0.065 * np.cos(0.13 * t)])  # fmt: skip
    turning = np.linalg.solve(pose_jacobian(attitude)[:, 3:, 3:], rates[:, :, None])[:, :, 0]
    # As recorded: by a gyro, with an attitude of finite resolution.
    noisy = attitude + np.random.default_rng(2).normal(scale=2e-3, size=(n, 3)) * [1.0, 1.0, 0.0]
    zero = np.zeros((n, 3))
    known = consistency(Recording(ALL[3:], t, noisy, turning, zero, zero, noisy))
    assert all(axis.excited and axis.correlation > 0.98 for axis in known.axes)


def test_a_smooth_motion_of_few_frequencies_is_not_called_interpolated() -> None:
    assert original_rate(motion(200_000).eta[:, :2], 10.0) is None
