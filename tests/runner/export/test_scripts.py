"""Linear models, the script for python-control and the MATLAB function, read by other programs."""

import json
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import scipy.io

from seatrial.models.vessel.basis import Array
from tests.runner.export.compiled import WIND, Ours, octave
from tests.runner.export.conftest import BELUGA, DIAGONAL, FERRY, LINEAR, SHIP, SUPPLY, Exporter
from tests.runner.programs import rows

pytestmark = pytest.mark.slow
EQUAL = 1e-12
MODELS = [(1, "identified"), (FERRY, "plant"), (SHIP, "identified"), (SUPPLY, "plant"),
          (BELUGA, "identified"), (DIAGONAL, "nominal")]  # fmt: skip


def ours_of(export: Exporter, run: int, model: str) -> Ours:
    """Our kernels for a model, with Euler angles in six degrees of freedom."""
    return Ours(replace(export.vessel(run, model), attitude="euler"), WIND, np.zeros(2))


def states(ours: Ours, count: int = 50) -> tuple[Array, Array, Array]:
    """Random poses, velocities and forces, shape (count, n_dof) each."""
    rng = np.random.default_rng(5)
    limits = np.array([ours.vessel.limits_by_dof[dof] for dof in ours.dofs])
    speed = 0.1 * np.array(ours.vessel.velocity_limits)
    pose, nu, tau = rng.uniform(-1.0, 1.0, size=(3, count, ours.n))
    return pose, nu * speed, tau * limits


def close(theirs: Array, ours: Array) -> None:
    np.testing.assert_allclose(theirs, ours, rtol=0.0, atol=EQUAL * np.max(np.abs(ours)))


@pytest.mark.parametrize(("run", "model"), MODELS)
def test_the_script_for_python_control_has_our_equations(
    export: Exporter, run: int, model: str
) -> None:
    ours = ours_of(export, run, model)
    file = export(run, "python-control", "vessel.py", "--model", model, "--at", "u=0.3")
    script = runpy.run_path(str(file))
    theirs, own = [], []
    for eta, nu, tau in zip(*states(ours), strict=True):
        x = np.concatenate([eta, nu])
        theirs.append(script["nonlinear"].dynamics(0.0, x, tau, {"wind": WIND}))
        own.append(ours.rates(eta, nu, tau))
    close(np.array(theirs), np.array(own))
    # The linear system is the nonlinear one, as python-control linearises it.
    point = np.zeros(2 * ours.n)
    point[ours.n + ours.dofs.index("surge")] = 0.3
    nonlinear = control.linearize(script["nonlinear"], point, np.zeros(ours.n), eps=1e-7)
    scale = np.max(np.abs(nonlinear.A))
    np.testing.assert_allclose(script["linear"].A, nonlinear.A, rtol=1e-4, atol=1e-6 * scale)
    np.testing.assert_allclose(script["linear"].B, nonlinear.B, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize(("run", "model"), MODELS)
def test_octave_computes_our_accelerations(export: Exporter, run: int, model: str) -> None:
    ours = ours_of(export, run, model)
    export(run, "mss", "vessel.m", "--model", model)
    pose, nu, tau = states(ours)
    program = (
        "load given.mat; a = zeros(size(nu));"
        "for k = 1:columns(nu) a(:, k) = vessel(eta(:, k), nu(:, k), tau(:, k), wind); end;"
        "calm = vessel(eta(:, 1), nu(:, 1), tau(:, 1)); save -v7 answer.mat a calm"
    )
    given = {"eta": pose.T, "nu": nu.T, "tau": tau.T, "wind": WIND}
    answer = octave(program, export.folder, given)
    own = np.array([ours.rates(*state)[ours.n :] for state in zip(pose, nu, tau, strict=True)])
    close(np.reshape(answer["a"], nu.T.shape).T, own)
    ours.weather = ours.weather._replace(wind_ned=np.zeros((1, 2)))
    close(np.atleast_1d(answer["calm"]), ours.rates(pose[0], nu[0], tau[0])[ours.n :])


def test_a_linear_model_is_the_derivative_at_its_operating_point(export: Exporter) -> None:
    ours = ours_of(export, FERRY, "plant")
    at = ("--model", "plant", "--at", "u=0.4, r=0.1,psi=0.7,wind_north=4,wind_east=-7")
    data = json.loads(export(FERRY, "statespace", "a.json", *at).read_text())
    eta, nu = np.array([0.0, 0.0, 0.7]), np.array([0.4, 0.0, 0.1])
    tau = np.array(data["operating_point"]["tau"])
    steady = ours.rates(eta, nu, tau)
    np.testing.assert_allclose(steady[3:], 0.0, atol=1e-15)
    h, point = 1e-6, np.concatenate([eta, nu])
    for j in range(6):
        up, down = (ours.rates(*np.split(point + s * h * np.eye(6)[j], 2), tau) for s in (1, -1))
        np.testing.assert_allclose(np.array(data["A"])[:, j], (up - down) / (2 * h), atol=1e-7)
    assert data["states"] == ["x", "y", "psi", "u", "v", "r"]
    assert data["period_s"] == 0.0


@pytest.mark.parametrize("run", [FERRY, LINEAR])
def test_the_two_files_of_a_linear_model_are_alike(export: Exporter, run: int) -> None:
    data: dict[str, Any] = json.loads(export(run, "statespace", "a.json").read_text())
    file = scipy.io.loadmat(export(run, "statespace", "a.mat"), simplify_cells=True)
    for name in "ABCD":
        np.testing.assert_array_equal(np.atleast_2d(file[name]).ravel(), np.ravel(data[name]))
    assert file["period_s"] == data["period_s"]
    assert list(np.atleast_1d(file["states"])) == data["states"]
    assert list(np.atleast_1d(file["inputs"])) == data["inputs"]


def test_an_identified_linear_model_leaves_as_it_was_stored(export: Exporter, sailed: Path) -> None:
    data = json.loads(export(LINEAR, "statespace", "a.json").read_text())
    query = f"SELECT value FROM diagnostic WHERE run_id = {LINEAR} AND name = '%s' ORDER BY i, j"
    poles = np.linalg.eigvals(np.array(data["A"]))
    ((radius,),) = rows(sailed, query % "spectral_radius")
    assert np.max(np.abs(poles)) == pytest.approx(radius, rel=1e-12)
    markov = [value for (value,) in rows(sailed, query % "markov")]
    A, B, C = (np.array(data[name]) for name in "ABC")
    powers = [C @ np.linalg.matrix_power(A, k) @ B for k in range(len(markov) - 1)]
    np.testing.assert_allclose(np.ravel(powers), markov[1:], rtol=1e-9, atol=1e-18)
    assert (data["inputs"], data["outputs"]) == (["tau_surge"], ["x"])
    assert data["period_s"] == pytest.approx(0.5, rel=1e-12)
    # Mass 60 kg and damping 20 kg/s have the pole -1/3 1/s, and the position is its integral.
    np.testing.assert_allclose(np.sort(poles.real), [np.exp(-0.5 / 3.0), 1.0], rtol=1e-3)
    script = runpy.run_path(str(export(LINEAR, "python-control", "vessel.py")))
    assert script["linear"].dt == data["period_s"]
    np.testing.assert_array_equal(script["linear"].A, A)


def test_a_wrong_operating_point_is_one_line(
    export: Exporter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(export.folder)
    for words, expected in (
        (("--to", "statespace", "--at", "speed=1"), "--at: got 'speed=1', expected NAME=NUMBER"),
        (("--to", "statespace", "--at", "u=fast"), "--at: got 'u=fast', expected NAME=NUMBER"),
        (("--to", "mss", "--at", "u=1"), "--at: got --to mss, expected --to statespace or"),
        (("--to", "mss", "-o", "1st.m"), "expected a name of letters, digits and _"),
    ):
        code, out, err = export.program("model", "1", "--database", export.database, *words)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert expected in err
    assert list(export.folder.iterdir()) == []
