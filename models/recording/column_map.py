"""Which columns of a recording are what: the map, as it is written in YAML."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Literal

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.recording.units import OWN, SI

KINDS = ("position", "velocity", "acceleration", "force", "actual_force")
QUATERNION = ("w", "x", "y", "z")
NAMES = {kind: tuple(names) for kind, names in SI.items() if kind != "current"}
NAMES["orientation"] = QUATERNION
NEEDED = {kind: NAMES[kind] for kind in ("orientation", "wind", "air", "ground")}
NEEDED["geodetic"] = ("latitude", "longitude")


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
            raise ConfigurationError(f"got {self.column!r}, expected the name of a column")
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
        own = {f.name: value for f in fields(self) if (value := getattr(self, f.name)) != f.default}
        return own if len(own) > 1 else self.column


Columns = dict[str, str | Column]  # by name: a degree of freedom, an input, a part


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
class ColumnMap:
    """Names of a file's columns, by degree of freedom; a leading minus changes the sign.

    Positions [m] (and angles [rad] if there is no `orientation`), body velocities [m/s, rad/s],
    body accelerations [m/s^2, rad/s^2] if recorded, commanded forces [N, Nm], acting forces
    if recorded, time [s], orientation as the quaternion (w, x, y, z) of the body, also by part.
    A `Column` states another unit or sense. Velocities that are not mapped are differentiated from
    the pose, those in surge and sway may come from the speed and course over `ground`; the speed
    through the `water` beside them gives the current. `geodetic` are latitude, longitude [deg] and
    altitude [m] on WGS 84 instead of a position. The `wind` has a speed and the direction from
    which it comes, clockwise from north; of the `kind` apparent, as seen on board, from the bow.
    `air` is the velocity of the air in surge and sway, instead of the wind. `inputs` and
    `commands` of a vessel are by their names. `lever_arm_m` is where the sensor of position and
    velocity is in body axes, `delay_s` by how much a source, or the columns of a kind, are behind.
    `loads` are measured on devices [N], by names such as `propeller.thrust`.
    """

    time: str | Column
    position: Columns = field(default_factory=dict)
    velocity: Columns = field(default_factory=dict)
    acceleration: Columns = field(default_factory=dict)
    force: Columns = field(default_factory=dict)
    actual_force: Columns = field(default_factory=dict)
    orientation: tuple[str, str, str, str] | dict[str, str] | None = None
    inputs: Columns = field(default_factory=dict)
    commands: Columns = field(default_factory=dict)
    geodetic: Columns | None = None
    frames: Frames = field(default_factory=Frames)
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay_s: dict[str, float] = field(default_factory=dict)
    loads: Columns = field(default_factory=dict)
    wind: Columns | None = None
    air: Columns = field(default_factory=dict)
    ground: Columns = field(default_factory=dict)
    water: Columns = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (wind := self._group("wind").get("kind", "true")) not in ("true", "apparent"):
            raise ConfigurationError(f"columns.wind.kind: got {wind}, expected true or apparent")
        for kind, names in NAMES.items():
            given = self._group(kind).keys() - ({"kind"} if kind == "wind" else set())
            if wrong := sorted(given - set(names)):
                raise ConfigurationError(
                    f"columns.{kind}: got {wrong[0]!r}, expected some of {', '.join(names)}"
                )
            if given and not given >= set(needed := NEEDED.get(kind, ())):
                raise ConfigurationError(
                    f"columns.{kind}: got {', '.join(sorted(given))}, expected {', '.join(needed)}"
                )
        len(self.specs)  # names that are empty are refused

    def _group(self, kind: str) -> Mapping[str, str | Column]:
        group = getattr(self, kind) or {}
        return dict(zip(QUATERNION, group, strict=True)) if isinstance(group, tuple) else group

    @property
    def clock(self) -> Column:
        """The column of time."""
        return self.time if isinstance(self.time, Column) else Column(self.time)

    @property
    def posed(self) -> tuple[str, ...]:
        """Degrees of freedom whose position or angle is mapped."""
        known = set(self.position) | (set(DOFS[3:]) if self.orientation else set())
        if self.geodetic:
            known |= set(DOFS[: len(self.geodetic)])
        return tuple(dof for dof in DOFS if dof in known)

    @property
    def moving(self) -> tuple[str, ...]:
        """Degrees of freedom whose velocity is recorded, in body axes or over ground."""
        over_ground = ("surge", "sway") if self.ground else ()
        return tuple(dof for dof in DOFS if dof in self.velocity or dof in over_ground)

    @cached_property
    def specs(self) -> Mapping[str, Column]:
        """Every column by option, such as `velocity.surge` or `orientation.w`, but the time."""
        result = {}
        for kind in (*KINDS, *OWN, "air", "orientation", "geodetic", "wind", "ground", "water"):
            for name, spec in self._group(kind).items():
                if (option := f"{kind}.{name}") == "wind.kind":
                    continue
                try:
                    result[option] = spec if isinstance(spec, Column) else Column(spec)
                except ConfigurationError as error:
                    raise ConfigurationError(f"columns.{option}: {error}") from error
        return result

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
