"""What a crew or a controller commands in a run: forces by degree of freedom, or inputs by name.

Vessels by force have columns `tau_surge`, ..., steered vessels the inputs of their configuration,
such as `delta` and `n`, with `delta_command` where the command is recorded too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.runner.compare.plots.force_units import largest_of, limits_of, prefixed
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.vocabulary import Config

# Units of inputs by the beginning of their names, and the size of the unit.
INPUT_UNITS = {
    **dict.fromkeys(("delta", "alpha"), ("deg", float(np.radians(1.0)))),
    **dict.fromkeys(("n",), ("1/s", 1.0)),
}


@dataclass(frozen=True, eq=False)
class Signal:
    """A commanded signal over time, shape (n,), in the unit of its axis.

    `dof` is its degree of freedom, empty for an input; `size` is the size of the unit in SI units.
    """

    name: str
    commanded: Sample
    acting: Sample | None
    unit: str
    size: float
    limits: tuple[float, float] | None
    dof: str = ""


def commanded_signals(series: Series, config: Config, dofs: Sequence[str]) -> list[Signal]:
    """Return the forces of a series in these degrees of freedom, or else its inputs."""
    forces = [dof for dof in dofs if f"tau_{dof}" in series.columns]
    if forces:
        limits = limits_of(config)
        return [_force(series, dof, limits.get(dof)) for dof in forces]
    inputs = (config.get("vessel") or {}).get("inputs") or {}
    return [_input(series, name, inputs[name]) for name in inputs if name in series.columns]


def _force(series: Series, dof: str, limit: float | None) -> Signal:
    force, acting = series.columns[f"tau_{dof}"], series.columns.get(f"tau_actual_{dof}")
    unit, size = prefixed(series.units[f"tau_{dof}"], largest_of([force]))
    if acting is not None and np.allclose(acting[1:], force[:-1]):
        acting = None
    return Signal(
        dof.capitalize(), force / size, None if acting is None else acting / size, unit, size,
        None if limit is None else (-limit / size, limit / size), dof,
    )  # fmt: skip


def _input(series: Series, name: str, options: Config) -> Signal:
    command, measured = series.columns.get(f"{name}_command"), series.columns[name]
    unit, size = INPUT_UNITS.get(name.split("_")[0], ("-", 1.0))
    low, high = options.get("low"), options.get("high")
    return Signal(
        name, (measured if command is None else command) / size,
        None if command is None or np.allclose(command, measured) else measured / size, unit, size,
        None if low is None or high is None else (low / size, high / size),
    )  # fmt: skip
