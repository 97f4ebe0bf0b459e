"""The ferry with 40 steps: the optimum of do-mpc on the same discretised problem, and its time."""

from time import process_time
from typing import Any

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.control.nmpc import Nmpc, NmpcDesign, NmpcMemory
from seatrial.models.simulation.voyage import NO_OUTLOOK
from seatrial.models.vessel.basis import Array
from tests.trials import composed

do_mpc = pytest.importorskip("do_mpc", reason="do-mpc is not installed: pip install '.[bench]'")
START = np.array([-6.0, 4.0, 0.7])
SOLUTIONS = 8


def ferry() -> tuple[Nmpc, NmpcDesign, NmpcMemory]:
    one = composed("vessel=milliampere", "controller=nmpc").controller
    assert isinstance(one, Nmpc)
    table, memory = one.build(parameters_of("milliampere").nominal(), 0.1)
    return one, one.foresee(table, NO_OUTLOOK).design, memory


def other(design: NmpcDesign) -> Any:
    """The same steps, cost and limits in do-mpc, with its own discretisation and solver."""
    program = design.program
    step, cost, _ = program.functions
    stage = np.zeros(sum(program.stage))
    model = do_mpc.model.Model("discrete", "MX")
    x = model.set_variable("_x", "x", (program.states, 1))
    u = model.set_variable("_u", "u", (program.n, 1))
    model.set_rhs("x", step(x, u, stage, design.shared))
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0}
    mpc.set_param(n_horizon=program.steps, t_step=design.shared[0], nlpsol_opts=quiet)
    last = cost(x, x[program.states - program.n :], stage, design.shared)
    mpc.set_objective(mterm=last, lterm=cost(x, u, stage, design.shared))
    mpc.set_rterm(u=0.0)
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = -1.0, 1.0
    mpc.setup()
    return mpc


def value(design: NmpcDesign, states: Array, commands: Array) -> float:
    """The cost of a plan of states (steps + 1, nx) and commands (steps, n)."""
    _, cost, _ = design.program.functions
    last = np.vstack([commands, states[-1, -design.program.n :]])
    stage = np.zeros(sum(design.program.stage))
    pairs = zip(states, last, strict=True)
    return sum(float(cost(x, u, stage, design.shared)) for x, u in pairs)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore")
def test_the_optimum_is_that_of_do_mpc_in_half_its_time_or_less() -> None:
    one, design, memory = ferry()
    program, mpc = design.program, other(design)
    state = np.concatenate([START, np.zeros(program.states - 3)])
    mpc.x0 = state
    mpc.set_initial_guess()
    ours, theirs = [], []
    for k in range(SOLUTIONS):
        start = process_time()
        one._solve(design, memory, state, np.zeros(3))
        ours.append(process_time() - start)
        start = process_time()
        mpc.make_step(state[:, None])
        theirs.append(process_time() - start)
        assert memory.plan is not None
        stages = program.stages(memory.plan)
        states = np.vstack([stages[:, : program.states], memory.plan[-program.states :]])
        found = value(design, states, stages[:, program.states :])
        x = [np.asarray(one[0][-1]).ravel() for one in mpc.opt_x_num["_x", :, :, :, "x"]]
        u = [np.asarray(one[0]).ravel() for one in mpc.opt_x_num["_u", :, :, "u"]]
        assert found == pytest.approx(value(design, np.array(x), np.array(u)), rel=1e-4), k
        state = states[1]
    assert np.median(ours) < 0.5 * np.median(theirs)
