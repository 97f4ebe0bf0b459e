"""The quadratic programs of a voyage, recorded to be solved again by anyone."""

from collections.abc import Callable
from itertools import cycle
from typing import Any

import numpy as np
import pytest

from seatrial.models.control.horizon import Horizon, Solver
from seatrial.models.vessel.basis import Array
from tests.models.control.sailing import LIMITS, appendix_k, mpc, ship, steady, voyage, weather

LAP = 1000  # samples at 1 Hz
WIND = (12.0, 1.0)  # [m/s], [rad]
AT_LIMIT = 1.0 - 1e-6


def problem_of(kind: str, steps: int) -> Horizon:
    """The optimal control problem of a formulation that looks `steps` samples ahead."""
    controller = mpc(kind, horizon=steps)
    found: Horizon = controller.problem(controller.design(ship(), 1.0))
    return found


def recorded(kind: str, steps: int, n: int) -> tuple[Array, float]:
    """What `n` programs of a closed loop ask, (n, width), and the share of them at a limit.

    The supply vessel in a steady wind goes to the set-points of Bargouth (2022), appendix K, again
    and again.
    """
    asked: list[Array] = []
    solve = Solver.solve

    def keeping(self: Solver, theta: Array) -> Array | None:
        asked.append(theta.copy())
        return solve(self, theta)

    laps = np.tile(appendix_k(LAP), (-(-n // LAP), 1))[:n]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Solver, "solve", keeping)
        sailed, _ = voyage(
            mpc(kind, horizon=steps), laps, met=weather(n, wind_ned=steady(n, *WIND))
        )
    limited = np.any(np.abs(sailed.log.tau) >= AT_LIMIT * np.array(LIMITS), axis=1)
    return np.array(asked), float(np.mean(limited))


def one_by_one(solve: Callable[[Array], Any], thetas: Array) -> Callable[[], Any]:
    """A call solves the next program, in the order of the voyage, round and round."""
    following = cycle(list(thetas)).__next__
    return lambda: solve(following())


def commands(solve: Callable[[Array], Array | None], thetas: Array, r: int) -> Array:
    """The first command of each program, (n, r), in shares; NaN where there was no solution."""
    found = [solve(theta) for theta in thetas]
    return np.array([np.full(r, np.nan) if z is None else z[:r] for z in found])
