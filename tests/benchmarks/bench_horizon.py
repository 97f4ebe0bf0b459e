"""Model predictive control over the horizon: a step and the set-up of each formulation.

At every horizon the programs of one closed loop are solved again, in its order, by the three
formulations of one problem; the integral one has a loop of its own. The first commands of the
three agree. About 3 minutes, most of it daqp's set-up of the 2,400 variables of the standard form.
"""

from functools import cache
from time import perf_counter
from typing import Any

import numpy as np
import pytest

from seatrial.models.control import horizon
from seatrial.models.control.horizon import Solver
from seatrial.models.vessel.basis import Array
from tests.benchmarks.conftest import growth
from tests.benchmarks.programs import commands, problem_of, recorded

HORIZONS = [10, 20, 40, 80, 160]
PROGRAMS = {"standard": 40, "reduced": 100, "condensed": 200, "integral": 200}  # solved of them
WRITE = {
    "standard": horizon.standard, "reduced": horizon.reduced, "condensed": horizon.condensed,
    "integral": horizon.increments,
}  # fmt: skip
AGREED = 1e-8  # of the limits
FIRST = 240  # of the programs: the first set-point is moved at 250


@cache
def asked(kind: str, steps: int) -> Array:
    """The programs of a loop while it goes to its first set-point, (n, width)."""
    most = max(PROGRAMS.values())
    return recorded(kind, steps, FIRST + most)[0][FIRST:]


@cache
def measured(kind: str, steps: int) -> tuple[float, float]:
    """Median step and set-up [s]; the commands are those of the condensed form."""
    loop = "integral" if kind == "integral" else "condensed"
    thetas, problem = asked(loop, steps)[: PROGRAMS[kind]], problem_of(loop, steps)
    begun = perf_counter()
    solve = Solver(WRITE[kind](problem)).solve
    ready = perf_counter() - begun
    times, found = [], []
    for theta in thetas:
        begun = perf_counter()
        z = solve(theta)
        times.append(perf_counter() - begun)
        assert z is not None
        found.append(z[: problem.sizes[1]])
    expected = commands(Solver(WRITE[loop](problem)).solve, thetas, problem.sizes[1])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=AGREED)
    return float(np.median(times)), ready


@pytest.mark.parametrize("what", ["MPC step", "MPC set-up"])
def test_over_the_horizon(stated: Any, what: str) -> None:
    column = ["MPC step", "MPC set-up"].index(what)

    def curves() -> dict[str, dict[str, Any]]:
        found = {kind: [measured(kind, steps)[column] for steps in HORIZONS] for kind in PROGRAMS}
        return {kind: growth(HORIZONS, times, of="samples ahead") for kind, times in found.items()}

    stated(
        curves, item="7d", what=what,
        note=f"commands of the first three agree to {AGREED:.0e} of the limits",
    )  # fmt: skip
