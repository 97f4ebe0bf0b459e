"""Models as objects: the motion of the simulations, and the way back into a trial."""

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import seatrial as st
from tests.runner.programs import completed

GUIDE = Path(__file__).parents[3] / "docs" / "howto" / "python.md"
TUG = """\
_target_: seatrial.models.vessel.parameters.VesselParameters
name: tug
dofs: [surge]
inertia: [[3000.0]]
derivatives: {X_u: -40.0}
force_limits: [1200.0]
velocity_limits: [20.0]
sources: {inertia: a test, derivatives: a test, force_limits: a test, velocity_limits: a test}
"""


@pytest.fixture
def tug(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> st.Vessel:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tug.yaml").write_text(TUG)
    return st.Vessel("tug.yaml")


def test_a_linear_surge_model_follows_the_exact_solution(tug: st.Vessel) -> None:
    """m du/dt + d u = tau: u - tau/d = (u_0 - tau/d) e^(-t d/m), and x is its integral."""
    steady, rate = 100.0 / 40.0, 40.0 / 3000.0
    force = np.full(600, 100.0)
    for motion, x, u in (
        (tug.simulate({"surge": force}, 0.1), 0.0, 0.0),
        (tug.simulate(force[:, None], 0.1, pose=[7.0], velocity=[3.0]), 7.0, 3.0),
    ):
        t, left = motion.index.to_numpy(), np.exp(-rate * motion.index.to_numpy())
        np.testing.assert_allclose(motion["u"], steady + (u - steady) * left, atol=1e-9)
        travelled = steady * t + (u - steady) / rate * (1.0 - left)
        np.testing.assert_allclose(motion["x"], x + travelled, atol=1e-8)
        assert list(motion.columns) == ["x", "u", "tau_surge"]


def test_a_vessel_from_numbers_is_sailed_fitted_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    boat = st.Vessel(
        name="boat", dofs=["surge"], inertia=[[3e3]], derivatives={"X_u": -40.0},
        force_limits=[1e3], plant_scale=0.8,
    )  # fmt: skip
    run = st.run(vessel=boat, excitation="prbs", identifier="none", evaluation="none")
    model = boat.fit(st.Recording.from_frame(run.series("recording")), "ls", basis="physical")
    assert model.table.coefficient("surge", "u") == pytest.approx(0.8 * 40.0, rel=1e-3)
    with pytest.raises(st.ConfigurationError, match="vessel: got None or a model"):
        st.run(vessel=model)
    curve = boat.plot().axes[0].lines[0].get_xydata()
    np.testing.assert_allclose(curve[:, 1], 40.0 * curve[:, 0])
    assert np.max(np.abs(curve[:, 1])) <= 1e3


@pytest.mark.nightly
def test_the_study_of_the_guide(tmp_path: Path) -> None:
    """A vessel, an identifier, two controllers, ten seeds, a frame and a figure in 40 lines."""
    blocks = re.findall(r'```python title="(.+?)"\n(.*?)```', GUIDE.read_text(), re.DOTALL)
    assert sum(code.count("\n") for _, code in blocks) <= 40
    for name, code in blocks:
        (tmp_path / name).write_text(code)
    done = completed(sys.executable, "study.py", folder=tmp_path)
    cells = [line.split()[:2] for line in done.stdout.splitlines() if " 10.0 " in line]
    assert cells == [["lqi", "Scaling"], ["none", "10.0"], ["pid_ff", "Scaling"], ["none", "10.0"]]
    assert (tmp_path / "study.pdf").is_file()


def test_wrong_forces_are_refused(tug: st.Vessel) -> None:
    with pytest.raises(st.ConfigurationError, match=r"force: got shape \(5,\), expected \(N, 1\)"):
        tug.simulate(np.zeros(5))
    with pytest.raises(
        st.ConfigurationError, match=r"force: got \[.sway.\], expected some of .'su"
    ):
        tug.simulate({"sway": [1.0]})
    for wrong, said in (
        ({"force": "abc"}, "force: got 'abc', expected finite numbers"),
        ({"force": [[np.nan]]}, r"force: got \[\[nan\]\]"),
        ({"force": [[1.0]], "pose": ["a"]}, r"pose: got \['a'\]"),
        ({"force": [[1.0]], "period_s": -1.0}, "period_s, step_s: got -1.0"),
    ):
        with pytest.raises(st.ConfigurationError, match=said):
            tug.simulate(**wrong)  # type: ignore[arg-type]
    with pytest.raises(st.ConfigurationError, match="identifier: got 3, expected a name or an"):
        tug.fit([], 3)  # type: ignore[arg-type]
    with pytest.raises(st.Diverged, match=r"tug: \|u\| exceeds 20 at t"):
        tug.simulate(np.full((5000, 1), 1e4))
    with pytest.raises(st.ConfigurationError, match=r"there is no file nowhere\.yaml"):
        st.Vessel("nowhere.yaml")


def test_options_replace_those_of_a_vessel(tug: st.Vessel) -> None:
    other = st.Vessel("tug.yaml", derivatives={"X_u": -80.0})
    assert other.table.coefficient("surge", "u") == 2.0 * tug.table.coefficient("surge", "u")
    assert other.inertia.equals(tug.inertia)
    for name, said in {
        "X_q": "X_q: got q, expected the motion in",
        "X_delta": " got delta",
    }.items():
        with pytest.raises(st.ConfigurationError, match=rf"vessel: derivatives[.:]{said}"):
            st.Vessel("tug.yaml", derivatives={name: -80.0})


def test_a_model_repeats_the_motion_of_the_trial(run: st.Run) -> None:
    """The command of the deployment gives the motion of the deployment, to the last digit."""
    sailed = run.series("deployment_identified")
    forces = sailed[["tau_surge", "tau_sway", "tau_yaw"]]
    motion = run.logbook.model(run.number, "plant").simulate(forces, 0.1)
    for name in ("x", "y", "psi", "u", "v", "r"):
        np.testing.assert_array_equal(motion[name], sailed[name])
    other = run.model.simulate(forces, 0.1)
    assert np.max(np.abs(other["x"] - sailed["x"])) > 0.0


@pytest.mark.parametrize("name", ["mariner", "container"])
def test_a_steered_vessel_repeats_the_motion_of_its_inputs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = st.run(vessel=name, identifier="none", evaluation="none")
    sailed, plant = run.series(), run.logbook.model(run.number, "plant")
    inputs = sailed.filter(like="_command").rename(columns=lambda c: c.removesuffix("_command"))
    letters = {"surge": "u", "sway": "v", "roll": "p", "yaw": "r"}
    start = sailed[[letters[dof] for dof in plant.dofs]].iloc[0].tolist()
    motion = plant.simulate(inputs, sailed.index[1], velocity=start)
    for column in ("x", "y", "psi", "u", "v", "r"):
        np.testing.assert_array_equal(motion[column], sailed[column])
    assert list(motion)[-len(inputs.columns) :] == list(inputs)


def test_a_prediction_begins_at_the_measured_state(run: st.Run) -> None:
    recording = st.Recording.from_frame(run.series())
    predicted = run.model.predict(recording, restart_s=20.0)
    measured = run.series()
    begins = np.arange(0, len(measured), 200)
    np.testing.assert_allclose(predicted["u"].iloc[begins], measured["u"].iloc[begins])
    assert np.max(np.abs(predicted["u"] - measured["u"])) > 0.0


def test_an_identified_model_is_sailed_again(
    run: st.Run, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shutil.copytree(folder, tmp_path / "python"))  # other tests count its runs
    model = st.open("results/results.db").model(run.number)
    again = st.run(vessel=model, identifier="none", evaluation="none")
    assert again.logbook.model(again.number, "nominal").coefficients.equals(model.coefficients)
    with pytest.raises(st.ConfigurationError, match="expected one of the same logbook"):
        st.run(vessel=model, identifier="none", database="other.db")


def test_a_model_is_written_for_others(run: st.Run, tmp_path: Path) -> None:
    (path,) = run.model.save("yaml", tmp_path / "ferry.yaml")
    vessel = st.Vessel(path)
    own, written = run.model.coefficients, vessel.coefficients
    np.testing.assert_allclose(written.loc[own.index, own.columns], own, rtol=1e-12)
    with pytest.raises(st.ConfigurationError, match="expected that of a run"):
        vessel.save("yaml")
