"""Nonlinear predictive control: its optimum against others, its limits, and free space."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.control import nmpc
from seatrial.models.control.controller import PythonTable
from seatrial.models.control.nmpc import Nmpc, NmpcMemory, Program
from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.voyage import NO_OUTLOOK, Outlook
from seatrial.models.vessel.basis import Array
from tests.trials import composed

pytest.importorskip("casadi", reason="casadi is not installed: pip install '.[nmpc]'")
HULL = np.array([[2.5, 0.0], [1.0, 1.4], [-2.5, 1.4], [-2.5, -1.4], [1.0, -1.4]])
QUAY = np.array([[-20.0, 6.0], [20.0, 6.0], [20.0, 12.0], [-20.0, 12.0]])
PERIOD_S = 0.1


@pytest.fixture(autouse=True)
def _interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small programs are solved faster than compiled."""
    monkeypatch.setattr(Program, "_compiled", lambda *_: False)


def test_a_vessel_on_one_axis_has_a_program() -> None:
    plant = parameters_of("surge_linear").nominal().plant_table()
    program = Program(plant, ("surge",), False, 5, 0, 0, False, "fatrop")
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
        for _ in range(table.design.every):
            CONTROLLERS[PythonTable](
                table, memory, pose, np.zeros(3), target, pose, pose, tau, np.zeros(3)
            )
        assert memory.plan is not None
        taus.append(tau)
        plans.append(table.design.program.stages(memory.plan)[:, :3])
        pose = memory.estimated.x[:3].copy()
    return np.array(taus), np.array(plans)


def test_a_plan_obeys_the_equation_of_motion_and_the_limits() -> None:
    table, memory = ready(
        controller("controller.effort=1e-4", "controller.rate_limits=[300,300,900]")
    )
    taus, _ = commands(table, memory, np.array([8.0, -6.0, 1.0]), np.zeros(3), 12)
    limits, rates = np.array([1000.0, 1000.0, 1500.0]), np.array([300.0, 300.0, 900.0]) * 0.5
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
        ahead = program.step(
            now[: program.states], now[program.states :], stage, table.design.shared
        )
        np.testing.assert_allclose(np.asarray(ahead).ravel(), then[: program.states], atol=1e-6)


def test_both_solvers_find_the_same_optimum() -> None:
    found = []
    for solver in ("fatrop", "ipopt"):
        table, memory = ready(controller(f"controller.solver={solver}"))
        commands(table, memory, np.array([2.0, -1.0, 0.4]), np.zeros(3), 1)
        found.append(memory.command)
    np.testing.assert_allclose(found[0], found[1], atol=1e-5)


def test_ipopt_solves_where_the_build_lacks_the_solver_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Lacking:
        def has_nlpsol(self, name: str) -> bool:
            return name == "ipopt"

    monkeypatch.setattr(nmpc, "ca", Lacking())
    nmpc.solver_of.cache_clear()
    try:
        assert [nmpc.solver_of("fatrop") for _ in range(2)] == ["ipopt", "ipopt"]
        assert nmpc.solver_of("ipopt") == "ipopt"
    finally:
        nmpc.solver_of.cache_clear()
    assert [record.message for record in caplog.records] == [
        "this build of CasADi lacks fatrop: ipopt solves the problems of nmpc"
    ]


def test_the_hull_stays_beyond_the_margin_from_a_quay_that_the_target_is_in() -> None:
    table, memory = ready(controller(), NO_OUTLOOK._replace(obstacles=(QUAY,), hull=HULL))
    _, plans = commands(table, memory, np.array([0.0, 5.5, 0.0]), np.zeros(3), 40)
    poses = plans[:, 0]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    east = poses[:, 1, None] + s[:, None] * HULL[:, 0] + c[:, None] * HULL[:, 1]
    nearest = QUAY[0, 1] - np.max(east)
    assert nearest == pytest.approx(table.controller.margin_m, abs=5e-3)
    assert memory.slack < 5e-3
    assert memory.estimated.failures[0] == 0


def test_a_start_within_an_obstacle_is_feasible_and_its_slack_is_the_depth() -> None:
    table, memory = ready(controller(), NO_OUTLOOK._replace(obstacles=(QUAY,), hull=HULL))
    commands(table, memory, np.zeros(3), np.array([0.0, 5.0, 0.0]), 1)
    assert memory.estimated.failures[0] == 0
    assert memory.slack == pytest.approx(0.4 + table.controller.margin_m, abs=2e-2)


def test_an_unsolved_problem_is_counted_and_the_last_plan_is_followed() -> None:
    table, memory = ready(controller())
    target = np.array([2.0, -1.0, 0.4])
    commands(table, memory, target, np.zeros(3), 2)
    assert memory.plan is not None
    planned = table.design.program.stages(memory.plan)[1, table.design.program.states :][:3]
    away = np.full(table.design.program.length, -np.inf)
    away[0] = 5.0  # north of the start, at which the plan begins
    bounds: dict[str, Any] = table.design.bounds | {"lbx": away}
    table = table._replace(design=table.design._replace(bounds=bounds))
    commands(table, memory, target, memory.estimated.x[:3].copy(), 1)
    assert memory.estimated.failures[0] == 1
    np.testing.assert_allclose(memory.command, planned)


def test_without_the_package_or_with_a_limit_of_zero_the_refusal_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = controller()
    with pytest.raises(ConfigurationError, match="3 numbers, positive"):
        replace(one, limits=(0.0, 1.0, 1.0))

    class Absent:
        def __getattr__(self, name: str) -> Any:
            raise ModuleNotFoundError(name)

    monkeypatch.setattr(nmpc, "ca", Absent())
    nmpc.solver_of.cache_clear()
    with pytest.raises(ConfigurationError, match=r"pip install 'seatrial\[nmpc\]'"):
        replace(one)
