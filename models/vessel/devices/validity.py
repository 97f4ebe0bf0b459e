"""Where devices are asked for what their data do not cover, and shaft speeds in a wrong unit."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.device import Device

SLACK = 0.01  # of a range, that noise may exceed
PER_MINUTE = 60.0
SMALL, PLAUSIBLE = 0.05, 1.5  # parts of the largest J of a propeller


class Excess(NamedTuple):
    """A quantity of a device outside of the range of its data."""

    name: str  # such as propeller.J
    seconds: float
    text: str  # how long and how far, one line


def excesses(devices: Mapping[str, Device], x: Array, period_s: float) -> list[Excess]:
    """What lies outside at samples x (N, N_VARIABLES), a period [s] apart, quantity by quantity."""
    found = []
    for name, device in devices.items():
        for one in device.ranges(x):
            slack = SLACK * (one.high - one.low if np.isfinite(one.high - one.low) else 1.0)
            below, above = one.values < one.low - slack, one.values > one.high + slack
            seconds = period_s * float(np.sum(below | above))
            if seconds == 0.0:
                continue
            least, most = float(np.nanmin(one.values)), float(np.nanmax(one.values))
            reached = [f"down to {least:.3g}"] * bool(np.any(below))
            reached += [f"up to {most:.3g}"] * bool(np.any(above))
            whole = period_s * len(x)
            limits = f"{one.low:.3g} to {one.high:.3g}" if np.isfinite(one.high) else "0 or more"
            text = (
                f"{name}: {one.name} {' and '.join(reached)} {one.unit}".rstrip()
                + f", outside of its data ({limits}) for {seconds:.3g} s of {whole:.4g} s"
            )
            found.append(Excess(f"{name}.{one.name}", seconds, text))
    return found


def doubts(devices: Mapping[str, Device], x: Array) -> list[str]:
    """Shaft speeds of samples x that are likely to be in revolutions a minute, one line each.

    Where a propeller runs ahead in the median at a J that is small, and 60 times that is common.
    """
    found = []
    for name, device in devices.items():
        for one in device.ranges(x):
            values = one.values[one.values > 0.0]
            if one.name != "J" or not len(values):
                continue
            median = float(np.median(values))
            common = PER_MINUTE * median
            if median < SMALL * one.high and common < PLAUSIBLE * one.high:
                found.append(
                    f"{name}: J = {median:.2g} in the median, expected up to {one.high:.2g}; with "
                    f"n divided by 60 it is {common:.2g}: is n in 1/min instead of 1/s?"
                )
    return found
