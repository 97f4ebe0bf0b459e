"""Wall-clock time a step of every controller on one core, loop, filter and vessel included.

The supply vessel on the set-points of Bargouth (2022), appendix K, at 1 Hz. The least of several
voyages is what the step takes when nothing else runs. A step that compiles is timed over blocks of
instants, one that solves a program by itself: median and 99 % are over those, "at limits" over
the steps with a command at its limit. About 20 seconds.
"""

from typing import Any

import numpy as np

from seatrial.models.control.pid import PidFeedforward
from tests.benchmarks.programs import AT_LIMIT
from tests.models.control.sailing import LIMITS, appendix_k, lqi, mpc, ship, voyage

N = 1200
VOYAGES = 5
PID = PidFeedforward((6e4, 1e5, 1.1e8), (300.0, 500.0, 5.6e5), (1.9e6, 3.2e6, 3.6e9))
CONTROLLERS: dict[str, Any] = {
    "pid_ff": PID,
    "lqi": lqi(),
    "mpc_condensed, 10, no limits": mpc("condensed", limited=False),
    "mpc_integral, 40, no limits": mpc("integral", limited=False),
    "mpc_condensed, 10": mpc("condensed"),
    "mpc_integral, 10": mpc("integral", horizon=10, error_weight=(1.0, 1.0, 1e3)),
    "mpc_condensed, 40": mpc("condensed", horizon=40),
    "mpc_integral, 40": mpc("integral"),
    "mpc_reduced, 10": mpc("reduced"),
    "mpc_standard, 10": mpc("standard"),
}


def microseconds(controller: Any) -> tuple[float, float, float]:
    """Median, median of the steps at a limit, and 99 % [us]: the least over the voyages."""
    found = []
    voyage(controller, appendix_k(50), model=ship())  # what is compiled once
    for _ in range(VOYAGES):
        sailed, _ = voyage(controller, appendix_k(N), model=ship())
        times = 1e6 * sailed.step_times
        limited = np.any(np.abs(sailed.log.tau) >= AT_LIMIT * np.array(LIMITS), axis=1)
        single = len(times) == N and bool(np.any(limited))
        at_limit = np.median(times[limited]) if single else np.nan
        found.append([np.median(times), at_limit, np.percentile(times, 99)])
    median, at_limit, most = np.min(found, axis=0).tolist()
    return median, at_limit, most


def shown(controller: Any) -> dict[str, Any]:
    median, at_limit, most = microseconds(controller)
    limited = "" if np.isnan(at_limit) else f", {at_limit:.3g} us at limits"
    return {"shown": f"{median:.3g} us{limited}, 99 % below {most:.3g} us", "median_us": median}


def test_a_step_of_every_controller(stated: Any) -> None:
    stated(
        lambda: {name: shown(one) for name, one in CONTROLLERS.items()},
        item="4", what="closed-loop step",
    )  # fmt: skip
