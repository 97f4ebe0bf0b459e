"""Which columns of a recording are what: the map, as it is written in YAML."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Literal

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.ranges import Positive, check_ranges

KINDS = ("position", "velocity", "acceleration", "force", "actual_force")
QUATERNION = ("w", "x", "y", "z")
PARTS = ("latitude", "longitude", "altitude", "speed", "direction", "course")


@dataclass(frozen=True)
class Column:
    """A column, and what its numbers mean; a leading minus of the name changes the sign.

    `unit` null is that of the file or the title, else SI units and radians. A heading counts from
    `zero` in the `positive` direction. Of a time, `nanoseconds` is the column of the rest, `date`
    that of the day, `format` how a date is written (as `strptime` has it), and `uniform` replaces
    times that are written with too few digits. An input with `neutral` and `full`, such as the
    width of a pulse, is 0 at the one and 1 at the other.
    """

    column: str
    unit: str | None = None
    zero: Literal["north", "east"] = "north"
    positive: Literal["clockwise", "anticlockwise"] = "clockwise"
    nanoseconds: str | None = None
    date: str | None = None
    format: str | None = None
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
    def written(self) -> object:
        """The column as it is written in a map."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        own = {f.name: own[f.name] for f in fields(self) if own[f.name] != f.default}
        return own if len(own) > 1 else self.column


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

    latitude: str | Column
    longitude: str | Column
    altitude: str | Column | None = None
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


@dataclass(frozen=True)
class GroundColumns:
    """Columns of the speed and course over ground, instead of velocities in surge and sway."""

    speed: str | Column
    course: str | Column


@dataclass(frozen=True)
class WaterColumns:
    """Column of the speed through the water, which a log measures along the bow."""

    speed: str | Column


def as_column(column: str | Column) -> Column:
    """The column of a name."""
    return column if isinstance(column, Column) else Column(column)


@dataclass(frozen=True)
class ColumnMap:
    """Names of a file's columns, by degree of freedom; a leading minus changes the sign.

    Positions [m] (and angles [rad] if there is no `orientation`), body velocities [m/s, rad/s],
    body accelerations [m/s^2, rad/s^2] if recorded, commanded forces [N, Nm], acting forces
    if recorded, time [s], orientation as the quaternion (w, x, y, z) of the body, also by part.
    A `Column` states another unit or sense. Velocities that are not mapped are differentiated from
    the pose, those in surge and sway may come from the speed and course over `ground`; the speed
    through the `water` beside them gives the current. `air` is the velocity of the air in surge and
    sway, instead of the `wind`. `inputs` and `commands` of the inputs of a vessel are by their
    names. `lever_arm_m` is where the sensor of position and velocity is in body axes, `delay_s` by
    how much a source, or the columns of a kind, are behind. `loads` are measured on devices [N], by
    names such as `propeller.thrust`. `froude_scale` is the length of what was recorded over that of
    the vessel, to which all columns are scaled by Froude's law.
    """

    time: str | Column
    position: dict[str, str | Column] = field(default_factory=dict)
    velocity: dict[str, str | Column] = field(default_factory=dict)
    acceleration: dict[str, str | Column] = field(default_factory=dict)
    force: dict[str, str | Column] = field(default_factory=dict)
    actual_force: dict[str, str | Column] = field(default_factory=dict)
    orientation: tuple[str, str, str, str] | dict[str, str] | None = None
    inputs: dict[str, str | Column] = field(default_factory=dict)
    commands: dict[str, str | Column] = field(default_factory=dict)
    geodetic: Geodetic | None = None
    frames: Frames = field(default_factory=Frames)
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay_s: dict[str, float] = field(default_factory=dict)
    loads: dict[str, str | Column] = field(default_factory=dict)
    froude_scale: Positive = 1.0
    wind: WindColumns | None = None
    air: dict[str, str | Column] = field(default_factory=dict)
    ground: GroundColumns | None = None
    water: WaterColumns | None = None

    def __post_init__(self) -> None:
        check_ranges(self)
        for kind in KINDS:
            for dof, column in getattr(self, kind).items():
                if dof not in DOFS:
                    raise ConfigurationError(
                        f"columns.{kind}: got {dof!r}, expected some of {', '.join(DOFS)}"
                    )
                if not (column.removeprefix("-") if isinstance(column, str) else column.name):
                    raise ConfigurationError(
                        f"columns.{kind}.{dof}: got {column!r}, expected the name of a column"
                    )
        if isinstance(self.orientation, dict) and set(self.orientation) != set(QUATERNION):
            raise ConfigurationError(
                f"columns.orientation: got {', '.join(self.orientation)}, expected w, x, y, z"
            )

    @property
    def clock(self) -> Column:
        """The column of time."""
        return as_column(self.time)

    @property
    def quaternion(self) -> tuple[str, ...]:
        """Columns of the quaternion (w, x, y, z)."""
        names = self.orientation or ()
        return tuple(names[part] for part in QUATERNION) if isinstance(names, dict) else names

    @property
    def posed(self) -> tuple[str, ...]:
        """Degrees of freedom whose position or angle is mapped."""
        known = set(self.position) | (set(DOFS[3:]) if self.orientation else set())
        if self.geodetic is not None:
            known |= set(DOFS[: 3 if self.geodetic.altitude else 2])
        return tuple(dof for dof in DOFS if dof in known)

    @property
    def moving(self) -> tuple[str, ...]:
        """Degrees of freedom whose velocity is recorded, in body axes or over ground."""
        over_ground = ("surge", "sway") if self.ground else ()
        return tuple(dof for dof in DOFS if dof in self.velocity or dof in over_ground)

    def columns(self) -> dict[str, Column]:
        """Every column by option, such as `velocity.surge` or `quaternion.w`, but the time."""
        groups = {
            kind: getattr(self, kind) for kind in (*KINDS, "inputs", "commands", "loads", "air")
        }
        groups["quaternion"] = dict(zip(QUATERNION, self.quaternion, strict=False))
        for kind in ("geodetic", "wind", "ground", "water"):
            part = getattr(self, kind)
            groups[kind] = {n: c for n, c in vars(part).items() if n in PARTS and c} if part else {}
        return {
            f"{kind}.{name}": as_column(spec)
            for kind, members in groups.items()
            for name, spec in members.items()
        }

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a degree of freedom lacks a column that it needs.

        A velocity may be differentiated from the pose, a position that is not needed (in surge
        alone, or in surge and yaw) integrated from it; a vessel with inputs has no force.
        """
        for dof in dofs:
            free = dof == "surge" and "sway" not in dofs and dof in self.moving
            acting = bool(self.inputs) or dof in self.force
            for kind, there in (("position", free or dof in self.posed), ("force", acting)):
                if not there:
                    raise ConfigurationError(
                        f"excitation.columns.{kind}: no column for {dof}, "
                        f"expected one for each of {', '.join(dofs)}"
                    )
