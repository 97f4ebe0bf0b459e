"""A day of station keeping: bounded, and nothing grows."""

import gc
import tracemalloc

import numpy as np
import pytest

from seatrial.runner.trials.closed_loop import SimulatedMission
from tests.trials import composed, sailed

DAY_S = 86400.0
# A filter as wide as the waves: else half the day is spent at the limits, chasing them.
FILTER = (
    "controller.kalman.estimate_bias=true", "controller.kalman.measurement=[0.5, 0.5, 0.02]",
)  # fmt: skip
OPTIONS: dict[str, tuple[str, ...]] = {
    "pid_ff": (),
    "lqi": FILTER,
    "mpc_condensed": (*FILTER, "controller.horizon=20"),
    "mpc_integral": (*FILTER, "controller.horizon=20"),
}


def keep_station(controller: str, duration_s: float) -> SimulatedMission:
    one = composed(
        "vessel=supply_vessel", f"controller={controller}", "disturbance=rough",
        "evaluation=station_keeping", f"evaluation.duration_s={duration_s}", "sample_time_s=1.0",
        "integration_step_s=1.0", *OPTIONS[controller],
    )  # fmt: skip
    return sailed(one, one.evaluation)


@pytest.mark.parametrize(
    "controller",
    [
        pytest.param(name, marks=pytest.mark.slow if name == "lqi" else pytest.mark.nightly)
        for name in OPTIONS
    ],
)
def test_a_day_of_station_keeping_stays_bounded_without_growing(controller: str) -> None:
    keep_station(controller, 600.0)  # what is loaded and compiled once
    gc.collect()
    tracemalloc.start()
    mission = keep_station(controller, DAY_S)
    log = mission.voyage.log
    assert len(log.eta) == DAY_S
    hours = np.abs(log.eta).reshape(24, 3600, 3).max(axis=1)
    assert np.all(hours[:, :2] < 10.0)
    assert np.all(hours[:, 2] < np.radians(20.0))
    assert np.all(np.isfinite(log.tau))
    assert mission.failures == 0
    assert not np.any(log.held)
    del mission, log, hours
    gc.collect()
    left, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert left < 1e6
