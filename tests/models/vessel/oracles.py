"""Tables that other programs computed, in `oracles` of the outside data."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.models.vessel.basis import Array
from tests.data import DATA

VELOCITIES = tuple("uvwpqr")


def oracle_file(name: str) -> Path:
    """A file of another program."""
    return DATA / "oracles" / name


def oracle(name: str) -> dict[str, Array]:
    """Columns of a table, by name without the unit."""
    lines = [line for line in oracle_file(name).read_text().splitlines() if line[0] != "#"]
    names = [column.partition("[")[0] for column in lines[0].split(",")]
    rows = np.array([[float(value) for value in line.split(",")] for line in lines[1:]])
    return dict(zip(names, rows.T, strict=True))


def constants(name: str) -> dict[str, Any]:
    """The constants that a program used, by name."""
    record: dict[str, Any] = json.loads(oracle_file(name).read_text())
    groups = ("values_constant_over_state", "attributes_of_the_constructed_object")
    return next(record[group] for group in groups if group in record)


def columns(table: dict[str, Array], *names: str) -> Array:
    """Some columns as an array (N, n)."""
    return np.column_stack([table[name] for name in names])


def accelerations(rows: dict[str, Array]) -> Array:
    """Accelerations over ground, (N, 6)."""
    return columns(rows, *(f"{name}dot" for name in VELOCITIES))


def stream(rows: dict[str, Array]) -> Array:
    """Velocity of the water along the axes of the vessel, (N, 3), by the heading alone."""
    angle = rows["beta_c"] - rows["psi"]
    down = rows.get("w_c", np.zeros_like(angle))
    return np.column_stack([rows["V_c"] * np.cos(angle), rows["V_c"] * np.sin(angle), down])


def through_water(rows: dict[str, Array]) -> tuple[Array, Array]:
    """Velocity and acceleration through the water, (N, 6) each, in a uniform current."""
    nu, nu_dot, water = columns(rows, *VELOCITIES), accelerations(rows), stream(rows)
    nu_dot[:, :3] += np.cross(nu[:, 3:], water)
    nu[:, :3] -= water
    return nu, nu_dot


def close(actual: Array, expected: Array, tolerance: float) -> None:
    """Compare columns, relative to the root mean square of each."""
    size = np.sqrt(np.mean(np.square(expected), axis=0))
    assert np.max(np.abs(actual - expected) / size) < tolerance
