"""Which columns of a recording are what, and in which units: the map, as it is written in YAML."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from textwrap import shorten
from typing import TYPE_CHECKING, Literal, NamedTuple

from seatrial.models import notation
from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.source import Source, column
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:  # slow to import
    import pint
else:
    import lazy_loader

    pint = lazy_loader.load("pint")

FAULTS = (ConfigurationError, RecordingError)
KINDS = ("position", "velocity", "acceleration", "force", "actual_force")  # by degree of freedom
QUATERNION = ("w", "x", "y", "z")
TURNS = "revolution/s"  # in which the shaft speed of a vessel is given
INPUTS = ("rad", TURNS, "N", "N*m", "m/s", "")  # of the inputs of a vessel
FLIPPED = ("sway", "heave", "pitch", "yaw")  # of forward, left, up axes
MOTION, IN_THE_PLANE = ("position", "velocity"), ("wind", "air", "ground", "water")
SI_ASSUMED = "no unit is stated: SI"
OWN = {"inputs": INPUTS, "commands": INPUTS, "loads": ("N",)}  # kinds with names of the user
SI = {
    "position": notation.POSE_UNIT, "velocity": notation.VELOCITY_UNIT,
    "acceleration": notation.ACCELERATION_UNIT, "force": notation.FORCE_UNIT,
    "actual_force": notation.FORCE_UNIT, "wind": {"speed": "m/s", "direction": "rad"},
    "ground": {"speed": "m/s", "course": "rad"}, "water": {"speed": "m/s"},
    "current": {"north": "m/s", "east": "m/s"}, "air": {"surge": "m/s", "sway": "m/s"},
    "geodetic": {"latitude": "deg", "longitude": "deg", "altitude": "m"},
}  # fmt: skip
NAMES = {kind: tuple(names) for kind, names in SI.items()} | {"orientation": QUATERNION}
NEEDED = {"orientation": 4, "geodetic": 2, "wind": 2, "air": 2, "ground": 2}  # of these names
BEARINGS = tuple(f"{kind}.{name}" for kind in ("position", "ground", "wind")
                 for name, unit in SI[kind].items() if unit == "rad")  # fmt: skip
# As instruments write them, where pint means something else or nothing.
SPELLINGS = {
    "1/s": TURNS, "Hz": TURNS, "Nm": "N*m", "kNm": "kN*m", "rad/s2": "rad/s^2", "m/s2": "m/s^2",
    "-": "", "RPM": "rpm", "Deg": "deg", "Degrees": "deg", "Radians": "rad", "epoch": "s",
    "timestamp": "s", "decimal degrees": "deg", "1/min": "rpm", "U/min": "rpm", "tr/min": "rpm",
    "min-1": "rpm",
}  # fmt: skip
# The last words of a title, in lower case; of several units the first of the quantity counts.
TITLES = defaultdict[str, list[str]](list)
for _unit, _words in {
    "deg": "deg degs degree degrees", "deg/min": "deg_min deg_per_min deg_p_min",
    "deg/s": "deg_s dps deg_per_s deg_sec deg_p_s degps degs", "deg/s^2": "degs2",
    "rad": "rad radians", "rad/s": "rad_s rad_per_s rad_sec rad_p_s radps",
    "m": "m meter meters metre metres", "cm": "cm", "mm": "mm", "km": "km", "ft": "ft feet",
    "knot": "kt kts knot knots kn", "km/h": "km_h kmh kph km_per_h",
    "m/s": "m_s mps m_per_s m_sec m_p_s ms", "m/s^2": "m_s2 mps2 m_per_s2 ms2",
    "s": "s sec secs second seconds", "ms": "msec msecs millis milliseconds ms",
    "us": "us usec micros microseconds", "min": "min", "h": "hours", "day": "days",
    "ns": "ns nsec nsecs nano nanos nanosec nanosecs nanoseconds",
    "percent": "pct percent", "N": "n newton newtons",
    "N*m": "nm n_m", "kN": "kn k_n", "kN*m": "knm k_nm", "rpm": "rpm", TURNS: "rps hz",
}.items():  # fmt: skip
    for _word in _words.split():
        TITLES[_word].append(_unit)
SHAFTS = {"rpm": "rpm", "rps": TURNS}  # that may stand anywhere in the title of an input
WORDS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|[^A-Za-z0-9]+")  # between the words of a title


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

    `attitude` ENU is the attitude of forward, left, up axes in east, north, up.
    """

    position: Literal["NED", "ENU"] = "NED"
    attitude: Literal["NED", "ENU"] = "NED"
    velocity: Literal["body", "earth"] = "body"  # along whose axes
    body: Literal["FRD", "FLU"] = "FRD"


@dataclass(frozen=True)
class ColumnMap:
    """Names of a file's columns, by degree of freedom; a leading minus changes the sign.

    Positions [m] (and angles [rad] if there is no `orientation`), body velocities [m/s, rad/s] and
    accelerations [m/s^2, rad/s^2], commanded and acting forces [N, Nm], time [s], orientation as
    the quaternion (w, x, y, z) of the body. Velocities that are not mapped are differentiated from
    the pose, those in surge and sway may come from the speed and course over `ground`; the speed
    through the `water` beside them gives the current. `geodetic` are latitude, longitude [deg] and
    altitude [m] on WGS 84 instead of a position. The `wind` has a speed and the direction from
    which it comes, clockwise from north; of the `kind` apparent, as seen on board, from the bow;
    `air` is its velocity in surge and sway. `inputs` and `commands` of a vessel are by their names,
    `loads` [N] of devices by names such as `propeller.thrust`. `lever_arm_m` is where the sensor of
    position and velocity is in body axes, `delay_s` by how much a source or a kind is behind.
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
        for option, spec in {"time": self.clock, **self.specs}.items():
            if not spec.name or spec.full == spec.neutral:
                expected = "expected a name, and two numbers for neutral and full"
                raise ConfigurationError(f"columns.{option}: got {spec.written!r}, {expected}")

    @property
    def clock(self) -> Column:
        """The column of time."""
        return self.time if isinstance(self.time, Column) else Column(self.time)

    @property
    def posed(self) -> set[str]:
        """Degrees of freedom whose position or angle is mapped."""
        angles = DOFS[3:] if self.orientation else ()
        return {*self.position, *DOFS[: len(self.geodetic or ())], *angles}

    @property
    def moving(self) -> set[str]:
        """Degrees of freedom whose velocity is recorded, in body axes or over ground."""
        return {*self.velocity, *(DOFS[:2] if self.ground else ())}

    @cached_property
    def specs(self) -> Mapping[str, Column]:
        """Every column by option, such as `velocity.surge` or `orientation.w`, but the time."""
        result = {}
        for kind in (*KINDS, *OWN, "air", "orientation", "geodetic", "wind", "ground", "water"):
            own = getattr(self, kind) or {}
            group = dict(zip(QUATERNION, own, strict=True) if isinstance(own, tuple) else own)
            if kind == "wind" and (sort := group.pop("kind", "true")) not in ("true", "apparent"):
                raise ConfigurationError(f"columns.wind.kind: got {sort}, expected true, apparent")
            names = NAMES.get(kind, tuple(group))
            needed = names[: NEEDED.get(kind, 0)] if group else ()
            if not set(needed) <= set(group) <= set(names):
                got = ", ".join(name for name in group if name not in names) or ", ".join(group)
                some = f"{', '.join(needed)} of " if 0 < len(needed) < len(names) else ""
                expected = f"expected {some}{', '.join(names)}"
                raise ConfigurationError(f"columns.{kind}: got {got}, {expected}")
            for name, spec in group.items():
                result[f"{kind}.{name}"] = spec if isinstance(spec, Column) else Column(spec)
        return result

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a degree of freedom lacks a column that it needs.

        A velocity may be differentiated from the pose, a position that is not needed (in surge
        alone, or in surge and yaw) integrated from it; a vessel with inputs has no force.
        """
        for dof in dofs:
            free = dof == "surge" and "sway" not in dofs and dof in self.moving
            kind = "force" if free or dof in self.posed else "position"
            if kind == "position" or not (self.inputs or dof in self.force):
                text = f"no column for {dof}, expected one for each of {', '.join(dofs)}"
                raise ConfigurationError(f"excitation.columns.{kind}: {text}")


@lru_cache(maxsize=512)
def factor(unit: str, target: str) -> float:
    """The factor on a number in `unit` that gives it in `target`; raises ConfigurationError."""
    amount, target = SPELLINGS.get(unit, unit) or "1", SPELLINGS.get(target, target)
    try:
        return float(pint.Quantity(amount).to(target).magnitude)
    except Exception as error:  # of many kinds: pint evaluates an expression
        expected = f"expected a unit of the kind of {target or 'a number'}"
        raise ConfigurationError(f"unit: got {unit!r}, {expected}") from error


def target_of(unit: str, targets: Sequence[str]) -> str | None:
    """The first of some units of which `unit` is a kind; None: of none."""
    for target in targets:
        with suppress(ConfigurationError):
            factor(unit, target)
            return target
    return None


def si_factor(option: str, unit: str) -> float:
    """The factor on an option such as `velocity.surge` in some unit that gives it in SI units.

    Angles are in rad, speeds of shafts in 1/s. Raises ConfigurationError.
    """
    targets = targets_of(option) if unit else ()
    return factor(unit, target_of(unit, targets) or targets[0]) if targets else 1.0


def words_of(title: str) -> list[str]:
    """The words of a title in lower case: `TimeUS` is time, us; `yaw_rate (deg/s)` four of them."""
    letters = unicodedata.normalize("NFKD", title.translate({216: "O", 248: "o"}))
    plain = "".join(letter for letter in letters if not unicodedata.combining(letter))
    return [word.lower() for word in WORDS.split(plain) if word]


def unit_in_title(title: str, targets: Sequence[str]) -> str | None:
    """The unit that the last words of a title spell, if it is of the kind of one of `targets`."""
    words = words_of(re.sub(r"\W*_\d+$", "", title))  # without the number of a device
    last = ("_".join(words[-count:]) for count in (3, 2, 1) if len(words) > count)
    known = (unit for text in last for unit in TITLES.get(text, ())
             if target_of(unit, targets) is not None)  # fmt: skip
    bare = (word.rstrip("0123456789") for word in words if TURNS in targets)
    return next(known, None) or next((SHAFTS[word] for word in bare if word in SHAFTS), None)


def targets_of(option: str) -> tuple[str, ...]:
    """The units in which an option such as `velocity.surge` is kept, any of which may be meant."""
    kind, _, name = option.partition(".")
    return OWN.get(kind) or ((SI[kind][name],) if kind in SI else ())


class ColumnReading(NamedTuple):
    """With which unit and sign a column was read, where they are known from, and its source."""

    option: str
    column: str  # as the map has it
    unit: str
    known_from: str
    source: Source
    name: str  # in the source

    @property
    def values(self) -> Array:
        """The numbers of the column as recorded, shape (N,); NaN where missing."""
        return self.source.numbers(self.name, gaps=True)


def wanted(columns: ColumnMap, dofs: Sequence[str]) -> dict[str, bool]:
    """The options whose columns a vessel with some degrees of freedom uses, and if it needs them.

    The attitude is used where it is recorded, also by a vessel that does not turn.
    """
    arm, angles, used = any(columns.lever_arm_m), DOFS[3:], dict[str, bool]()
    turned = columns.frames != Frames() or arm or bool(columns.geodetic or columns.ground)
    turned = turned or not set(dofs) <= set(columns.moving)
    for option in columns.specs:
        kind, _, dof = option.partition(".")
        angle, posed = dof in angles, kind == "position"
        if kind in KINDS:
            needed = dof in dofs or (turned and not angle and kind in MOTION)
            needed |= arm and angle and kind == "velocity"
            replaced = posed and (columns.orientation if angle else columns.geodetic)
            if (needed or (angle and posed)) and not replaced:
                used[option] = needed
        elif kind not in IN_THE_PLANE or set(PLANAR) <= set(dofs):
            used[option] = kind != "orientation" or turned or bool(set(angles) & set(dofs))
    return used


def readings(
    sources: Mapping[str, Source], columns: ColumnMap, used: Mapping[str, bool] | None = None
) -> dict[str, ColumnReading]:
    """How each mapped column is read, by option; the first that tells its unit counts.

    `used` are the options that are read, and whether each is needed; None: those that are there.
    Raises RecordingError if a needed column does not exist.
    """
    result = {}
    used = dict.fromkeys(columns.specs, False) if used is None else used
    for option, needed in used.items():
        spec, targets = columns.specs[option], targets_of(option)
        kind = option.partition(".")[0]
        try:
            source, name = column(sources, spec.name)
        except RecordingError:
            if needed:
                raise
            continue
        unit, origin = spec.unit or "", "the map"
        if spec.unit is None and spec.full is None and targets:
            unit, origin = (targets[0] if len(targets) == 1 else ""), SI_ASSUMED
            beside = [  # columns of the same quantity, in the same source
                other.name for o, other in columns.specs.items()
                if targets_of(o) == targets and (
                    {o, option} <= {*BEARINGS} or (kind in KINDS and o.startswith(f"{kind}."))
                )
            ]  # fmt: skip
            for title in (None, *beside):
                plain = source.find(title.rpartition(":")[2]) if title else name
                if plain and (stated := stated_unit(source, plain, targets)):
                    unit, origin = stated[0], f"{title} beside it" if title else stated[1]
                    break
        result[option] = ColumnReading(option, spec.column, unit, origin, source, name)
    return result


def stated_unit(source: Source, name: str, targets: Sequence[str]) -> tuple[str, str] | None:
    """The unit of a column by the metadata of the file or by its title, and which it is."""
    stated = source.units.get(name)
    if stated and target_of(stated, targets) is not None:
        return stated, "the file"
    titled = unit_in_title(source.titles.get(name, name), targets)
    return (titled, "the title") if titled else None


def together(notes: Sequence[str]) -> Iterator[str]:
    """What was left out, lines that differ by the column only in one."""
    groups = defaultdict[str, list[str]](list)
    for note in dict.fromkeys(notes):
        name, _, text = note.partition(": ") if note.startswith("column ") else ("", "", note)
        groups[text] += [name.removeprefix("column ")] if name else []
    for text, names in groups.items():
        columns = shorten(", ".join(names), 300, placeholder=" ...")
        yield f"column{'s' * (len(names) > 1)} {columns}: {text}" if names else text
