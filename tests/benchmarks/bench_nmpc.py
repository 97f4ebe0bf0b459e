"""CPU time of a command of `nmpc`: the ferry, 40 steps, on one core."""

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.control.nmpc import Nmpc, _step
from seatrial.models.simulation.voyage import NO_OUTLOOK
from seatrial.models.vessel.basis import Array
from tests.trials import composed

pytest.importorskip("casadi", reason="casadi is not installed: pip install '.[nmpc]'")
HULL = np.array([[2.5, 0.0], [1.0, 1.4], [-2.5, 1.4], [-2.5, -1.4], [1.0, -1.4]])
QUAYS = tuple(
    np.array([[-30.0, east], [30.0, east], [30.0, east + 5.0], [-30.0, east + 5.0]])
    for east in (-15.0, 6.0)
)


@pytest.mark.parametrize("obstacles", [(), QUAYS], ids=["open water", "two quays"])
def test_a_command(benchmark: object, obstacles: tuple[Array, ...]) -> None:
    one = composed("vessel=milliampere", "controller=nmpc").controller
    assert isinstance(one, Nmpc)
    table, memory = one.build(parameters_of("milliampere").nominal(), 0.1)
    outlook = NO_OUTLOOK._replace(obstacles=obstacles or None, hull=HULL)
    table = one.foresee(table, outlook)
    rng, pose, target, tau = np.random.default_rng(0), np.zeros(3), np.zeros(3), np.zeros(3)
    pose[:] = -6.0, 0.0, 0.7

    def command() -> None:
        for _ in range(table.every):
            measured = pose + 0.01 * rng.normal(size=3)
            _step(table, memory, measured, pose, target, pose, pose, tau, tau.copy())
        pose[:] = memory.estimated.x[:3]

    benchmark.pedantic(command, rounds=120, warmup_rounds=2)  # type: ignore[attr-defined]
    assert memory.estimated.failures[0] == 0
