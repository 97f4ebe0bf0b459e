"""A recorded column with its unit and sense, and the frames of a recording.

Units of recorded columns, and the factor that gives SI units and radians.

Times of a recording in seconds: numbers in any unit, seconds with nanoseconds, date-times.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import ACCELERATION_UNIT, DOFS, FORCE_UNIT, POSE_UNIT, VELOCITY_UNIT
from seatrial.models.recording.source import Source
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:  # slow to import
    import pandas as pd
    import pint
else:
    import lazy_loader

    pd, pint = lazy_loader.load("pandas"), lazy_loader.load("pint")

SI = {
    "position": POSE_UNIT,
    "velocity": VELOCITY_UNIT,
    "acceleration": ACCELERATION_UNIT,
    "force": FORCE_UNIT,
    "actual_force": FORCE_UNIT,
    "wind": {"speed": "m/s", "direction": "rad"},
}
# As instruments write them, where pint means something else or nothing.
SPELLINGS = {
    "kn": "knot", "kt": "knot", "kts": "knot", "knots": "knot", "°": "deg", "°/s": "deg/s",
    "rps": "revolution/s", "1/s": "revolution/s", "Hz": "revolution/s", "degrees": "deg",
    "deg/sec": "deg/s", "m/sec": "m/s", "sec": "s", "Nm": "N*m", "kNm": "kN*m", "rad/s2": "rad/s^2",
    "m/s2": "m/s^2", "-": "",
}  # fmt: skip
TURNS = "revolution/s"  # in which the shaft speed of a vessel is given


@lru_cache(maxsize=256)
def factor(unit: str, target: str) -> float:
    """The factor on a number in `unit` that gives it in `target`; raises ConfigurationError."""
    target = SPELLINGS.get(target, target)
    try:
        amount = _registry().parse_expression(SPELLINGS.get(unit, unit))
        quantity = amount if hasattr(amount, "to") else amount * _registry().dimensionless
        return float(quantity.to(target).magnitude)
    except Exception as error:  # of many kinds: pint evaluates an expression
        raise ConfigurationError(
            f"unit: got {unit!r}, expected a unit of the kind of {target or 'a number'}"
        ) from error


def input_factor(unit: str) -> float:
    """The factor of an input of a vessel: angles in rad, speeds of shafts in 1/s, others in SI."""
    name = SPELLINGS.get(unit, unit)
    for target in ("rad", TURNS, "N", "N*m", "m/s", ""):
        try:
            return factor(name, target)
        except ConfigurationError:
            continue
    raise ConfigurationError(
        f"unit: got {unit!r}, expected that of an angle, a shaft speed or a force, or a number"
    )


def froude_factor(unit: str, scale: float) -> float:
    """The factor of a quantity in `unit` of a ship that gives that of a model, by Froude's law.

    Lengths of the ship are `scale` times those of the model, times the root of it, and masses its
    cube: the same water is taken for both.
    """
    if scale == 1.0:
        return 1.0
    amount = _registry().parse_units(SPELLINGS.get(unit, unit)).dimensionality
    length, time, mass = (
        float(str(amount.get(f"[{name}]", 0))) for name in ("length", "time", "mass")
    )
    return float(scale ** -(length + 0.5 * time + 3.0 * mass))


def is_known(unit: str, target: str) -> bool:
    """Whether a unit, as written in a header, is one of the kind of `target`."""
    try:
        factor(unit, target)
    except ConfigurationError:
        return False
    return True


@lru_cache(maxsize=1)
def _registry() -> "pint.UnitRegistry[float]":
    return pint.UnitRegistry()


@dataclass(frozen=True)
class Column:
    """A column, and what its numbers mean; a leading minus of the name changes the sign.

    `unit` null is that of the header, else SI units and radians. A heading counts from `zero` in
    the `positive` direction. Of a time, `nanoseconds` is the column of the rest, and `uniform`
    replaces times that are written with too few digits. An input with `neutral` and `full`, such
    as the width of a pulse, is 0 at the one and 1 at the other.
    """

    column: str
    unit: str | None = None
    zero: Literal["north", "east"] = "north"
    positive: Literal["clockwise", "anticlockwise"] = "clockwise"
    nanoseconds: str | None = None
    uniform: bool = False
    neutral: float = 0.0
    full: float | None = None

    def __post_init__(self) -> None:
        if not self.name:
            raise ConfigurationError(f"column: got {self.column!r}, expected the name of a column")
        if self.full is not None and self.full == self.neutral:
            raise ConfigurationError(
                f"column {self.name}: neutral and full are {self.full:g}, expected two numbers"
            )

    @property
    def name(self) -> str:
        """The name in the file, or `source:name`."""
        return self.column.removeprefix("-")

    @property
    def sign(self) -> float:
        """-1 if the name has a leading minus."""
        return -1.0 if self.column.startswith("-") else 1.0

    @property
    def is_plain(self) -> bool:
        """Whether the numbers are taken as they are."""
        return self == Column(self.column)


@dataclass(frozen=True)
class Frames:
    """Axes of a recording; the defaults are those of this project.

    `attitude` ENU is the attitude of forward, left, up axes in east, north, up. `velocity` tells
    along which axes the velocities are, those of the body or of the earth.
    """

    position: Literal["NED", "ENU"] = "NED"
    attitude: Literal["NED", "ENU"] = "NED"
    velocity: Literal["body", "earth"] = "body"
    body: Literal["FRD", "FLU"] = "FRD"


@dataclass(frozen=True)
class Geodetic:
    """Columns of latitude, longitude [deg] and altitude [m] on WGS 84, instead of a position.

    `origin` (latitude, longitude, altitude) null is the first sample.
    """

    latitude: str
    longitude: str
    altitude: str | None = None
    origin: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class WindColumns:
    """Columns of a measured wind: its speed, and the direction from which it comes, clockwise.

    A `true` wind is over ground and counts from north. An `apparent` one is as seen on board and
    counts from the bow.
    """

    speed: str | Column
    direction: str | Column
    kind: Literal["true", "apparent"] = "true"


def as_column(column: str | Column) -> Column:
    """The column of a name."""
    return column if isinstance(column, Column) else Column(column)


def check_dofs(kind: str, columns: dict[str, str | Column]) -> None:
    """Raise ConfigurationError for a key that is no degree of freedom, and for an empty name."""
    for dof, column in columns.items():
        if dof not in DOFS:
            raise ConfigurationError(
                f"columns.{kind}: got {dof!r}, expected some of {', '.join(DOFS)}"
            )
        if not (column.removeprefix("-") if isinstance(column, str) else column.name):
            raise ConfigurationError(
                f"columns.{kind}.{dof}: got {column!r}, expected the name of a column"
            )


__all__ = ["Column", "Frames", "Geodetic", "WindColumns", "as_column", "check_dofs", "factor"]


def seconds(source: Source, column: Column) -> Array:
    """Times [s] of the rows of a source, shape (N,); date-times since 1970, UTC.

    A date-time without a zone is UTC. Raises RecordingError if a cell is neither a number nor a
    date-time.
    """
    name = source.find(column.name) or column.name
    values = source.columns.get(name)
    first = str(values[0]) if values is not None and values.dtype == np.object_ else ""
    if ":" in first or first.count("-") + first.count("/") > 1:
        times = _of_dates(source, name)
    else:
        unit = column.unit or source.units.get(name)
        times = source.numbers(name, gaps=True) * (factor(unit, "s") if unit else 1.0)
    if column.nanoseconds is not None:
        times = times + 1e-9 * source.numbers(column.nanoseconds)
    if column.uniform and len(times) > 1:
        times = np.linspace(times[0], times[-1], len(times))
    return column.sign * times


def _of_dates(source: Source, name: str) -> Array:
    cells = [str(cell).strip().replace("/", "-") for cell in source.columns[name]]
    times = pd.to_datetime(cells, format="ISO8601", utc=True, errors="coerce")
    wrong = np.asarray(times.isna())
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise RecordingError(
            f"{source.path}, column {name}, {source.cell(row, name).place}: got {cells[row]!r}, "
            "expected a date and time such as 2025-04-11T11:51:09.416Z"
        )
    return np.asarray(times.as_unit("ns").asi8, dtype=np.float64) * 1e-9
