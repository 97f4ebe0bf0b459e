"""Wall-clock time a step of every controller on one core, loop, filter and vessel included.

    python tests/benchmarks/controllers.py

The supply vessel on the set-points of Bargouth (2022), appendix K, at 1 Hz. The machine's load is
printed too; the least of several voyages is what the step takes when nothing else runs. Nothing
is asserted. A step that compiles is timed over blocks of instants, one that solves a program by
itself: median and 99 % are over those, "at limits" over the steps with a command at its limit.
"""

import os
from typing import Any

import numpy as np

from models.control.pid import PidFeedforward
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
        limited = np.any(np.abs(sailed.log.tau) >= (1.0 - 1e-6) * np.array(LIMITS), axis=1)
        single = len(times) == N and bool(np.any(limited))
        at_limit = np.median(times[limited]) if single else np.nan
        found.append([np.median(times), at_limit, np.percentile(times, 99)])
    median, at_limit, most = np.min(found, axis=0).tolist()
    return median, at_limit, most


def main() -> None:
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; microseconds a step")
    print(f"{'controller, horizon':32} {'median':>8} {'at limits':>9} {'99 %':>8}")
    for name, controller in CONTROLLERS.items():
        median, at_limit, most = microseconds(controller)
        limited = "-" if np.isnan(at_limit) else f"{at_limit:.1f}"
        print(f"{name:32} {median:8.1f} {limited:>9} {most:8.1f}")


if __name__ == "__main__":
    main()
