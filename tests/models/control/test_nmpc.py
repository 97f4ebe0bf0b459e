"""Nonlinear predictive control: its optimum against others, its limits, and free space."""

import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.control import nmpc
from seatrial.models.control.controller import PythonTable
from seatrial.models.control.nmpc import Nmpc, NmpcMemory, Program, coefficients
from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.voyage import NO_OUTLOOK, Outlook
from seatrial.models.vessel.basis import Array
from seatrial.runner.trials.closed_loop import Streams, commanded, drawn
from tests.trials import composed, sailed

pytest.importorskip("casadi", reason="casadi is not installed: pip install '.[nmpc]'")
HULL = np.array([[2.5, 0.0], [1.0, 1.4], [-2.5, 1.4], [-2.5, -1.4], [1.0, -1.4]])
QUAY = np.array([[-20.0, 6.0], [20.0, 6.0], [20.0, 12.0], [-20.0, 12.0]])
PERIOD_S, MARGIN_M = 0.1, 0.05
COMPILE = nmpc.compile_to


@pytest.fixture(autouse=True)
def _interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small programs are solved faster than compiled."""
    monkeypatch.setattr(nmpc, "compile_to", lambda *_: False)


def test_a_vessel_on_one_axis_has_a_program() -> None:
    plant = parameters_of("surge_linear").nominal().plant_table()
    program = Program(
        plant, ("surge",), False, 5, 0, (1, 1, 1, 1, 1, 0, 0, 0, 0, len(coefficients(plant)))
    )
    assert program.problem()["x"].numel() == program.length


def controller(*options: str) -> Nmpc:
    words = "vessel=milliampere", "controller=nmpc", "controller.horizon=8", *options
    found = composed(*words).controller
    assert isinstance(found, Nmpc)
    return found


def ready(one: Nmpc, outlook: Outlook = NO_OUTLOOK) -> tuple[PythonTable, NmpcMemory]:
    table, memory = one.build(parameters_of("milliampere").nominal(), PERIOD_S)
    return one.foresee(table, outlook), memory


def commands(
    table: PythonTable, memory: NmpcMemory, target: Array, pose: Array, count: int
) -> tuple[Array, Array]:
    """Commands, and plans of the poses (count, steps, 3), on the model itself."""
    taus, plans = [], []
    for _ in range(count):
        tau = np.zeros(3)
        for _ in range(table.controller.command_rows(PERIOD_S)):
            CONTROLLERS[PythonTable](
                table, memory, pose, np.zeros(3), target, pose, pose, tau, np.zeros(3)
            )
        assert memory.plan is not None
        taus.append(tau)
        plans.append(table.design.program.stages(memory.plan)[:, :3])
        pose = memory.estimated.x[:3].copy()
    return np.array(taus), np.array(plans)


def test_a_plan_obeys_the_equation_of_motion_and_the_limits() -> None:
    one, rate_limits = controller("controller.effort=1e-4"), (300.0, 300.0, 900.0)
    assert one.vessel.thruster is not None
    limited = replace(one.vessel, thruster=replace(one.vessel.thruster, rate_limit=rate_limits))
    table, memory = ready(replace(one, vessel=limited))
    taus, _ = commands(table, memory, np.array([8.0, -6.0, 1.0]), np.zeros(3), 12)
    limits, rates = np.array([1000.0, 1000.0, 1500.0]), np.array(rate_limits) * 0.5
    assert memory.estimated.failures[0] == 0
    changes = np.abs(np.diff(np.vstack([np.zeros(3), taus]), axis=0))
    assert np.all(changes < rates * (1.0 + 1e-4))
    assert np.any(changes > rates * (1.0 - 1e-3))
    assert np.all(np.abs(taus) <= limits)
    program = table.design.program
    assert memory.plan is not None
    stages = [*program.stages(memory.plan), memory.plan[-program.states :]]
    for now, then in pairwise(stages):
        stage = np.zeros(sum(program.stage))
        ahead = program.functions[0](
            now[: program.states], now[program.states :], stage, table.design.shared
        )
        np.testing.assert_allclose(np.asarray(ahead).ravel(), then[: program.states], atol=1e-6)


def test_ipopt_finds_the_same_optimum_where_fatrop_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    found, limited = [], {**nmpc.SOLVERS, "fatrop": nmpc.SOLVERS["fatrop"] | {"max_iter": 0}}
    for solvers in (nmpc.SOLVERS, limited):
        monkeypatch.setattr(nmpc, "SOLVERS", solvers)
        monkeypatch.setattr(nmpc, "_KNOWN", {})
        table, memory = ready(controller())
        commands(table, memory, np.array([2.0, -1.0, 0.4]), np.zeros(3), 1)
        assert memory.estimated.failures[0] == 0
        found.append(memory.command)
        assert len(nmpc._KNOWN) == (1 if solvers is not limited else 2)
    np.testing.assert_allclose(found[0], found[1], atol=1e-5)


def test_a_build_that_lacks_fatrop_has_ipopt(monkeypatch: pytest.MonkeyPatch) -> None:
    class Lacking:
        def has_nlpsol(self, name: str) -> bool:
            return name == "ipopt"

    monkeypatch.setattr(nmpc, "ca", Lacking())
    nmpc.solvers.cache_clear()
    try:
        assert nmpc.solvers() == ["ipopt"]
    finally:
        nmpc.solvers.cache_clear()


def test_without_a_c_compiler_casadi_interprets_which_is_said(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    x = nmpc.ca.MX.sym("x", 2)
    solver = nmpc.ca.nlpsol("nmpc", "ipopt", {"x": x, "f": x.T @ x})
    assert not COMPILE(solver, tmp_path / "one.so")
    assert "no-such-compiler" in caplog.text


def test_the_hull_stays_beyond_the_margin_from_a_quay_that_the_target_is_in() -> None:
    table, memory = ready(controller(), NO_OUTLOOK._replace(obstacles=(QUAY,), hull=HULL))
    _, plans = commands(table, memory, np.array([0.0, 5.5, 0.0]), np.zeros(3), 40)
    poses = plans[:, 0]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    east = poses[:, 1, None] + s[:, None] * HULL[:, 0] + c[:, None] * HULL[:, 1]
    nearest = QUAY[0, 1] - np.max(east)
    assert nearest == pytest.approx(MARGIN_M, abs=5e-3)
    assert memory.slack < 5e-3
    assert memory.estimated.failures[0] == 0


def test_a_start_within_an_obstacle_is_feasible_and_its_slack_is_the_depth() -> None:
    table, memory = ready(controller(), NO_OUTLOOK._replace(obstacles=(QUAY,), hull=HULL))
    commands(table, memory, np.zeros(3), np.array([0.0, 5.0, 0.0]), 1)
    assert memory.estimated.failures[0] == 0
    assert memory.slack == pytest.approx(0.4 + MARGIN_M, abs=2e-2)


def test_an_unsolved_problem_is_counted_and_the_last_plan_is_followed() -> None:
    table, memory = ready(controller())
    target = np.array([2.0, -1.0, 0.4])
    commands(table, memory, target, np.zeros(3), 2)
    assert memory.plan is not None
    planned = table.design.program.stages(memory.plan)[1, table.design.program.states :][:3]
    away = np.full(table.design.program.length, -np.inf)
    away[0] = 5.0  # north of the start, at which the plan begins
    table.design.program.bounds["lbx"] = away
    commands(table, memory, target, memory.estimated.x[:3].copy(), 1)
    assert memory.estimated.failures[0] == 1
    np.testing.assert_allclose(memory.command, planned)


def test_without_the_package_or_with_a_limit_of_zero_the_refusal_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = controller()
    with pytest.raises(ConfigurationError, match="3 numbers, positive"):
        replace(one, limits=(0.0, 1.0, 1.0))

    monkeypatch.setattr(nmpc, "ca", None)
    nmpc.solvers.cache_clear()
    with pytest.raises(ConfigurationError, match=r"pip install 'seatrial\[nmpc\]'"):
        replace(one)


def first_command(scale: float) -> Array:
    """By a table that is `scale` times the ferry's."""
    one = controller("controller.horizon=3")
    table, memory = one.build(scale * parameters_of("milliampere").nominal(), PERIOD_S)
    commands(one.foresee(table, NO_OUTLOOK), memory, np.array([2.0, -1.0, 0.4]), np.zeros(3), 1)
    return memory.command


def test_a_program_is_found_again_by_a_new_process(tmp_path: Path) -> None:
    """For another table of the same terms; no compiler is asked then."""
    words = """
import sys, pathlib
from tests.models.control import test_nmpc
test_nmpc.nmpc.cache_folder = lambda: pathlib.Path(sys.argv[1])
print(*test_nmpc.first_command(float(sys.argv[2])))
"""
    for scale, compiler in ((1.0, "cc"), (0.7, "no-such-compiler")):
        done = subprocess.run(
            [sys.executable, "-c", words, str(tmp_path), str(scale)],
            env={**os.environ, "CC": compiler}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert "CasADi interprets" not in done.stderr
        assert len([*tmp_path.glob("nmpc-fatrop-*.so")]) == 1
        found = np.array(done.stdout.split(), dtype=float)
        np.testing.assert_allclose(found, first_command(scale), atol=1e-5)


def test_the_forces_are_those_that_azimuths_give_together_and_turn_to() -> None:
    """On a diagonal course each axis alone could give more; the allocation then scales nothing."""
    words = "vessel=milliampere_azimuths", "controller=nmpc", "controller.horizon=8"
    one = composed(*words, "controller.effort=1e-4", "controller.step=0.28").controller
    assert isinstance(one, Nmpc)
    assert one.vessel.positioning is not None
    table, memory = one.build(commanded(one.vessel.nominal(), one), PERIOD_S)
    table = one.foresee(table, NO_OUTLOOK)
    taus, _ = commands(table, memory, np.array([60.0, 60.0, 3.0]), np.zeros(3), 20)
    assert memory.estimated.failures[0] == 0
    limits = np.array(one.limits)
    shares = np.diff(np.vstack([np.zeros(3), taus / limits]), axis=0)
    assert np.max(np.abs(shares)) == pytest.approx(1.4 * 0.2, rel=1e-3)  # rad/s in 0.2 s
    forces = one.vessel.positioning.forces()
    given = forces.allocate(taus, one.vessel.dofs)
    share = np.linalg.norm(given.applied / limits, axis=1) / np.linalg.norm(taus / limits, axis=1)
    alone = forces.allocate(limits * np.sign(taus[-1:]), one.vessel.dofs).applied / limits
    assert np.max(np.abs(alone)) < 0.75
    assert np.min(share) > 0.9


@pytest.mark.parametrize(
    ("evaluation", "options", "most_m"),
    [
        ("station_keeping", ["evaluation.duration_s=60.0"], 2e-3),
        pytest.param(
            "square",
            ["evaluation.duration_s=180.0", "evaluation.scale=3.0"],
            0.1,
            marks=pytest.mark.slow,
        ),
        pytest.param("docking", ["evaluation.rests=[2.0,25.0]"], 5e-3, marks=pytest.mark.slow),
    ],
)
def test_an_unknown_force_leaves_no_error_in_positioning_on_a_path_and_in_a_berth(
    evaluation: str, options: list[str], most_m: float
) -> None:
    """Nor do coefficients that are wrong by 30 %. Without the estimate it is 0.5 m or more."""
    words = (
        "vessel=milliampere", "identifier=none", "plant.scale=0.7", "disturbance=constant",
        "disturbance.force.north_n=40.0", "disturbance.force.east_n=60.0", "controller=nmpc",
        "controller.horizon=20", f"evaluation={evaluation}", "seed=1", *options,
    )  # fmt: skip
    trial = drawn(composed(*words), Streams(1))
    result = sailed(trial, trial.evaluation)
    assert result.failures == 0
    error = np.abs(result.voyage.log.eta - result.voyage.log.eta_d)[-1]
    assert np.max(error) < most_m
