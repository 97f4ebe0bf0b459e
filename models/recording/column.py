"""A recorded column with its unit and sense, and the frames of a recording."""

from dataclasses import dataclass
from typing import Literal

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.recording.units import factor


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
class Wind:
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


__all__ = ["Column", "Frames", "Geodetic", "Wind", "as_column", "check_dofs", "factor"]
