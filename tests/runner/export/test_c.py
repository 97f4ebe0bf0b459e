"""The exported C compiles without a warning and gives the numbers of our kernels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.pose import Quaternion
from seatrial.models.vessel.thruster import FirstOrderLag, SecondOrderLag
from seatrial.runner.export.equations import Equations
from tests.runner.export.compiled import CURRENT, WIND, Ours, Theirs, compiled, relative
from tests.runner.export.conftest import BELUGA, DIAGONAL, FERRY, SHIP, SUPPLY, Exporter
from tests.trials import composed

SURGE = 1
EQUAL = 1e-12  # relative


def agree(theirs: Theirs, largest: float = 1.0, step_s: float = 0.025) -> None:
    """Rates at 200 random states, and 1,000 steps under random commands held for 20 steps."""
    ours, rng = theirs.ours, np.random.default_rng(7)
    speed = 0.1 * largest * np.array(ours.vessel.velocity_limits)
    limits = [ours.vessel.limits_by_dof[dof] for dof in ours.dofs]
    ones, found = [], []
    for _ in range(200):
        eta = rng.normal(size=ours.n_pose)
        if isinstance(ours.kinematics, Quaternion):
            eta[3:] /= np.linalg.norm(eta[3:])
        nu, tau = rng.normal(size=ours.n) * speed, rng.normal(size=ours.n) * limits
        state = np.concatenate([eta, nu, tau, np.zeros(theirs.size)])[: theirs.size]
        found.append(theirs.rates(state, tau)[: ours.n_pose + ours.n])
        ones.append(ours.rates(eta, nu, tau))
    assert relative(np.array(found), np.array(ones)) < EQUAL
    commands = np.repeat(rng.uniform(-0.3, 0.3, size=(50, ours.n)) * largest * limits, 20, axis=0)
    track = ours.sail(commands, step_s)
    assert np.all(np.isfinite(track))
    assert np.all(np.ptp(track[:, -ours.n :], axis=0) > 0.0)
    assert relative(theirs.sail(commands, step_s), track) < EQUAL


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "model"),
    [(SURGE, "identified"), (FERRY, "identified"), (FERRY, "plant"), (SHIP, "identified"),
     (SUPPLY, "plant"), (SUPPLY, "nominal"), (BELUGA, "identified"), (DIAGONAL, "identified")],
)  # fmt: skip
def test_it_agrees_with_our_kernels(export: Exporter, run: int, model: str) -> None:
    file = export(run, "c", "vessel.c", "--model", model)
    agree(Theirs(compiled(file), file.stem, Ours(export.vessel(run, model), WIND, CURRENT)))


def written(vessel: VesselParameters, folder: Path) -> Theirs:
    equations = Equations(vessel.nominal(), vessel.thruster, 'a "strange" */ source\\')
    for ending in ("c", "h"):
        (folder / f"other.{ending}").write_text(equations.render(f"model.{ending}", name="other"))
    return Theirs(compiled(folder / "other.c"), "other", Ours(vessel, WIND, CURRENT))


@pytest.mark.parametrize(
    "lag",
    [
        None,
        FirstOrderLag(time_constant_s=0.8),
        FirstOrderLag(time_constant_s=0.8, amplitude_limit=(200.0, 200.0, 200.0)),
        SecondOrderLag(2.0, 1.0),
        SecondOrderLag(2.0, 1.7),
        SecondOrderLag(2.0, 0.4, amplitude_limit=(200.0, 200.0, 200.0)),
        SecondOrderLag(2.0, 0.4, rate_limit=(50.0, 60.0, 30.0)),
        SecondOrderLag(2.0, 0.8, (200.0, 150.0, 100.0), (50.0, 60.0, 30.0)),
    ],
    ids=str,
)
def test_every_thruster_lag_agrees(tmp_path: Path, lag: SecondOrderLag | None) -> None:
    ferry = composed("vessel=milliampere").vessel
    agree(written(replace(ferry, thruster=lag), tmp_path))


@pytest.mark.parametrize("attitude", ["quaternion", "euler"])
def test_both_attitudes_agree(tmp_path: Path, attitude: str) -> None:
    vessel = composed("vessel=beluga_full", "excitation=multisine", "controller=none").vessel
    theirs = written(replace(vessel, attitude=attitude), tmp_path)
    agree(theirs, 0.1)


def test_the_pose_of_a_state_is_where_it_was_put(tmp_path: Path) -> None:
    vessel = composed("vessel=beluga_full", "excitation=multisine", "controller=none").vessel
    theirs = written(vessel, tmp_path)
    pose, nu = np.array([1.0, -2.0, 3.0, 0.3, -0.4, 2.0]), np.arange(6.0)
    state = np.full(theirs.size, np.nan)
    theirs._call("start", state, pose, nu)
    np.testing.assert_allclose(theirs.pose(state), pose, atol=1e-15)
    np.testing.assert_array_equal(state[7:13], nu)
