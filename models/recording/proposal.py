"""Proposes which column is what, by titles, units and motion, and says what it is unsure of."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields
from itertools import product
from textwrap import shorten
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.recording.column_map import QUATERNION, Column
from seatrial.models.recording.proposal_by_motion import angle_unit, propose_by_motion, speed_unit
from seatrial.models.recording.quantities import (
    ESTIMATES,
    KINDS,
    RAW,
    REFERENCES,
    Quantity,
    quantity,
)
from seatrial.models.recording.source import Source
from seatrial.models.recording.times import clocks, find_time, seconds
from seatrial.models.recording.units import factor, is_known, targets_of, unit_in_title, words_of
from seatrial.models.vessel.basis import Array

SYMBOLS = {"eta": "x y z phi theta psi", "nu": "u v w p q r", "tau": "x y z k m n"}  # of matrices
NUMBERED = re.compile(r"(.*?)[\[(_.]?(\d)[\])]?")
PART = re.compile(r"(.*?)([wxyz]|\d)[\])]?")
SIDES = {"port": "1", "left": "1", "starboard": "2", "stbd": "2", "right": "2"}
BEARINGS = ("position.roll", "position.pitch", "position.yaw", "ground.course", "wind.direction")
PATHS = (("position.surge", "position.sway"), ("geodetic.latitude", "geodetic.longitude"))
UNIT_LENGTH = 0.05  # largest deviation of the length of a quaternion from one
DOUBTFUL = {"angle": 4.0 * np.pi, "delta": 0.5 * np.pi, "n": 30.0}  # larger: not rad, or not 1/s
PULSE_US = (800.0, 2300.0)  # widths that are sent to servos and speed controllers
METRES = 111_195.0  # of a degree of latitude
UNKNOWN = Quantity("", strange=99)


@dataclass(frozen=True)
class Proposal:
    """A map as written in YAML, what is sure of it, what must be asked, and what was left out."""

    map: dict[str, object]
    sure: tuple[str, ...] = ()
    questions: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


class _Candidate(NamedTuple):
    """A column, its name in a map, what its title names, and the rank of its source."""

    source: Source
    name: str
    full: str
    option: str
    frame: str
    strange: int
    commanded: bool
    rank: int
    values: Array


Chosen = dict[str, _Candidate]  # by option of a map
Path = tuple[Array, Array, Array]


def propose(sources: Mapping[str, Source], wanted: Sequence[str] = ()) -> Proposal:
    """A map of the columns of a recording.

    Args:
        sources: tables and topics of the recording, by name
        wanted: names of the inputs of the vessel, if one is named

    Raises RecordingError if no source has a column of time.
    """
    times = {name: time for name, source in sources.items() if (time := find_time(source))}
    if not times and len(sources) == 1:
        found = propose_by_motion(*sources.values())
        return Proposal(found, ("the columns are told by how they move together",))
    if not times:
        names = ", ".join(name for source in sources.values() for name in source.columns)
        raise RecordingError(
            f"{next(iter(sources.values())).path}: no column of time among {names[:300]}, expected "
            "one such as t or time"
        )
    left = {"no column of time": [name for name in sources if name not in times]}
    candidates, still = _candidates([sources[name] for name in times], left)
    chosen = _motion(candidates)
    asked = _actions(candidates, still, wanted, chosen)
    units, known = _units(chosen, times)
    named = {c.full for c in chosen.values()}
    rest = [c for c in candidates if c.full not in named]
    left["do not move"] = [c.full for c in still if c.full not in named]
    left["look like inputs, not mapped"] = [c.full for c in rest if c.option.startswith("inputs")]
    left["not used"] = [c.full for c in rest if not c.option.startswith("inputs")]
    left["without a value in some rows, though mapped"] = [
        f"{c.full} ({np.isnan(c.values).sum()} of {len(c.values)})"
        for c in {c.full: c for c in chosen.values()}.values()
        if np.isnan(c.values).any()
    ]
    result: dict[str, dict[str, object]] = defaultdict(dict)
    for option, c in chosen.items():
        kind, _, name = option.partition(".")
        unit = units.get(option)
        result[kind][name] = {"column": c.full, "unit": unit} if unit else c.full
        if option in ("velocity.surge", "velocity.sway") and c.frame == "earth":
            result["frames"]["velocity"] = "earth"
        elif option == "position.surge" and c.frame == "ENU":
            result["frames"]["position"] = "ENU"
        elif option == "wind.direction" and c.frame == "apparent":
            result[kind]["kind"] = "apparent"
        elif option == "position.yaw" and c.frame == "magnetic":
            asked.append(f"{c.full} is a magnetic heading: is its variation to be ignored?")
        asked += () if option in known else _doubts(option, c)
    sure = (f"{option}: {c.full}{known.get(option, '')}" for option, c in chosen.items())
    lines = (f"{why}: {', '.join(_folded(names))}" for why, names in left.items() if names)
    left_out = tuple(shorten(line, 600, placeholder=" ...") for line in lines)
    return Proposal({"time": _time(chosen, times), **result}, tuple(sure), tuple(asked), left_out)


def _folded(names: Sequence[str]) -> Iterator[str]:
    """Names, the elements of an array as one."""
    arrays = Counter(re.sub(r"\[\d+\]$", "[...]", name) for name in names)
    rest = dict(zip((re.sub(r"\[\d+\]$", "[...]", name) for name in names), names, strict=True))
    yield from (array if count > 1 else rest[array] for array, count in arrays.items())


def _candidates(
    sources: Sequence[Source], left: dict[str, list[str]]
) -> tuple[list[_Candidate], list[_Candidate]]:
    """Columns of numbers that move, and others; estimates first, then by how much a source has."""
    moving: list[_Candidate] = []
    still: list[_Candidate] = []
    left["not numbers"] = []
    many = len(sources) > 1 or bool(left["no column of time"])
    for source in sources:
        used = {name for c in clocks(source) for name in (c.name, c.nanoseconds, c.date)}
        words = set(words_of(source.name))
        estimate = words & ESTIMATES or any("kf" in word for word in words)
        rank = 3 if words & REFERENCES else 0 if estimate else 2 if words & RAW else 1
        titles, quaternion = _titles(source), _quaternion(source)
        for name in source.columns:
            full = f"{source.name}:{name}" if many else name
            try:
                values = source.numbers(name, gaps=True)
            except RecordingError:
                left["not numbers"] += [full] if name not in used else []
                continue
            if name in used:
                continue
            found = quantity(titles.get(name, name), source.name, source.units.get(name))
            if name in quaternion:
                found = Quantity(f"orientation.{quaternion[name]}")
            moves = name in quaternion or not np.nanmax(values, initial=-np.inf) <= np.nanmin(
                values, initial=np.inf
            )
            c = _Candidate(source, name, full, *(found or UNKNOWN), rank, values)
            (moving if moves else still).append(c)
    motion = ("position", "velocity", "geodetic", "orientation")
    covered = Counter(c.source.name for c in moving if c.option.startswith(motion))
    moving.sort(key=lambda c: (c.commanded, c.rank, -covered[c.source.name], c.source.name,
                               c.frame == "magnetic", c.strange))  # fmt: skip
    return moving, still


def _titles(source: Source) -> dict[str, str]:
    """Titles of the columns of matrices, `eta[2]` of three is psi, and of the forces X, Y, N."""
    groups: dict[str, list[str]] = defaultdict(list)
    for name in source.columns:
        if match := NUMBERED.fullmatch(name):
            groups[match[1]].append(name)
    result: dict[str, str] = {}
    for stem, names in groups.items():
        last = next((word for word in reversed(words_of(stem)) if word != "dot"), "")
        if last in (*KINDS, *SYMBOLS, "xyz"):
            axes = SYMBOLS.get(last, "x y z").split()
            axes = axes if len(names) == len(axes) else [*axes[:2], axes[-1]]
            if len(names) == len(axes):
                result |= {n: f"{stem} {axis}" for n, axis in zip(names, axes, strict=True)}
    forces = {"X", "N"} <= set(source.columns)
    return result | ({letter: f"tau {letter}" for letter in "XYZKMN"} if forces else {})


def _quaternion(source: Source) -> dict[str, str]:
    """Four columns that differ in w, x, y, z, or a number, and are of length one together."""
    groups: dict[str, dict[str, str]] = defaultdict(dict)
    for name in source.columns:
        if (match := PART.fullmatch(name)) and not set(words_of(name)) & REFERENCES:
            groups[match[1]][match[2]] = name
    for parts, order in product(groups.values(), ("wxyz", "0123", "1234")):
        if set(order) <= set(parts):
            with suppress(RecordingError):
                values = np.array([source.numbers(parts[part], gaps=True) for part in order])
                apart = np.abs(np.linalg.norm(values, axis=0) - 1.0)
                if np.any(apart < UNIT_LENGTH) and not np.any(apart > UNIT_LENGTH):
                    size = np.nansum(values**2, axis=1)  # x and y are small, z is not
                    last = order != "wxyz" and size[0] < size[2]
                    order = order[3] + order[:3] if last else order
                    return {parts[part]: q for part, q in zip(order, QUATERNION, strict=True)}
    return {}


def _motion(candidates: Sequence[_Candidate]) -> Chosen:
    """The columns of pose, velocities, wind and forces, of one source each as far as possible."""
    chosen: Chosen = {}
    first: Chosen = {}
    place: dict[str, int] = {}
    for i, c in enumerate(candidates):
        first.setdefault(c.option, c)
        place.setdefault(c.source.name, i)

    def take(kind: str, names: Sequence[str], near: _Candidate | None, *, only: bool = False,
             frames: Sequence[str] | None = None) -> None:  # fmt: skip
        for option in (f"{kind}.{name}" for name in names):
            fitting = [c for c in candidates if c.option == option]
            fitting = [c for c in fitting if frames is None or c.frame in frames]
            own = [c for c in fitting if near is None or c.source is near.source]
            if best := own or (fitting if not only else []):
                chosen[option] = best[0]

    x, latitude, yaw = (first.get(o) for o in ("position.surge", PATHS[1][0], "position.yaw"))
    if latitude and (x is None or place[latitude.source.name] < place[x.source.name]):
        take("geodetic", ("latitude", "longitude", "altitude"), latitude, only=True)
    else:
        take("position", DOFS[:3], x)
    whole = first.get("orientation.w")
    if whole and whole.rank < 3 and (yaw is None or whole.rank <= yaw.rank):
        yaw = whole
        take("orientation", QUATERNION, whole, only=True)
    else:
        near = x or latitude
        near = near if near and yaw and near.rank <= yaw.rank else yaw
        take("position", ("yaw",), near)
        yaw = chosen.get("position.yaw")
        take("position", ("roll", "pitch"), yaw)
    along = [c for c in candidates if c.option in ("velocity.surge", "velocity.sway")]
    along = [c for c in along if c.source is along[0].source]
    moving = next((c for c in along if c.frame != "earth"), along[0] if along else None)
    if moving:
        frames = ("earth",) if moving.frame == "earth" else ("body", "")
        take("velocity", DOFS[:3], moving, only=True, frames=frames)
    elif yaw and {"ground.speed", "ground.course"} <= set(first):
        take("ground", ("speed", "course"), first["ground.speed"])
    take("velocity", DOFS[3:], moving or yaw)
    if moving or "ground.speed" in chosen:
        take("water", ("speed",), None)
    if moving:
        take("acceleration", DOFS, moving, only=True)
    for frame in ("apparent", "true"):
        winds = [c for c in candidates if c.option == "wind.direction" and c.frame == frame]
        for c in candidates:
            if (
                winds
                and c.option == "wind.speed"
                and (c.frame == frame or c.source is winds[0].source)
            ):
                chosen |= {"wind.speed": c, "wind.direction": winds[0]}
                break
    acting = next((c for c in candidates if c.option.startswith("force.")), None)
    if acting:
        take("force", DOFS, acting, only=True)
    return chosen


def _actions(
    candidates: Sequence[_Candidate], still: Sequence[_Candidate], wanted: Sequence[str],
    chosen: Chosen,
) -> list[str]:  # fmt: skip
    """Choose what acts, by the names of the vessel, or by delta, n and own names; asks the rest."""
    forces = [option for option in chosen if option.startswith("force.")]
    if not wanted:
        for option in ("inputs.delta", "inputs.n", "inputs.") if not forces else ():
            same = [c for c in candidates if c.option == option]
            same = [c for c in same if not c.commanded] or same
            names = Counter(c.name for c in same)
            for c in same:
                own = c.name if names[c.name] == 1 and c.name != "data" else c.full
                alone = len(same) == 1 and option != "inputs."
                chosen[option if alone else f"inputs.{own}"] = c
        return []
    for option in forces:
        del chosen[option]
    free: list[_Candidate] = [c for c in (*candidates, *still) if c not in chosen.values()]
    asked = []
    for name in wanted:
        title, found = "_".join(words_of(name)), quantity(name)
        titles = {c.full: "_".join(words_of(c.name)) for c in free}
        named = [c for c in free if titles[c.full] == title]
        longer = [c for c in free if titles[c.full].startswith(f"{title}_")]
        same = [c for c in free if found and c.option == found.option]
        same = [c for c in same if c in candidates] or same
        fitting = named[:1] or longer or [c for c in same if _side(c.name) == _side(name)]
        fitting = fitting or ([] if _side(name) else same)
        fitting = [c for c in fitting if not c.commanded] or fitting
        if len(fitting) == 1:
            chosen[f"inputs.{name}"] = fitting[0]
            free.remove(fitting[0])
        else:
            some = ", ".join(c.full for c in fitting or same) or "no column looks like it"
            asked.append(
                f"which column is the input {name} of the vessel? ({some}): "
                f"inputs: {{{name}: COLUMN}}"
            )
    return asked


def _side(name: str) -> str:
    return next((SIDES.get(w, w) for w in words_of(name) if w in SIDES or w.isdigit()), "")


def _units(chosen: Chosen, times: Mapping[str, Column]) -> tuple[dict[str, str], dict[str, str]]:
    """Units to be written, and where those that are known are known from.

    By the header, the title, the motion, else as of the same quantity beside it.
    """
    read: dict[str, str] = {}
    known: dict[str, str] = {}

    def note(option: str, unit: str | None, origin: str) -> None:
        if unit and option not in read and any(is_known(unit, t) for t in targets_of(option)):
            read[option], known[option] = unit, f" in {unit} ({origin})"

    for option, c in chosen.items():
        note(option, c.source.units.get(c.name), "header")
        note(option, unit_in_title(c.name, targets_of(option)), "title")
    path = _path(chosen, times)
    for option, unit_of in (("position.yaw", angle_unit), ("ground.speed", speed_unit)):
        if path and option in chosen and option not in read:
            c = chosen[option]
            t = seconds(c.source, times[c.source.name])
            valid = np.isfinite(t) & np.isfinite(c.values)
            note(option, unit_of(path, t[valid], c.values[valid]), "by the motion")
    for option, c in chosen.items():
        kind, targets = option.partition(".")[0], targets_of(option)
        like = [o for o in read if o.partition(".")[0] == kind and targets_of(o) == targets]
        like = [o for o in BEARINGS if o in read] if option in BEARINGS else like
        beside = next((o for o in like if chosen[o].source is c.source), None)
        if beside is not None and kind != "inputs":
            note(option, read[beside], f"as {chosen[beside].name}")
    written = {}
    for option, unit in read.items():
        target = next(target for target in targets_of(option) if is_known(unit, target))
        header = "header" in known[option]
        if not header and factor(unit, target) != 1.0:
            written[option] = unit
    return written, known


def _path(chosen: Chosen, times: Mapping[str, Column]) -> Path | None:
    """Times [s] and positions along two axes [m]; None: not recorded in one source."""
    for first, second in PATHS:
        a, b = chosen.get(first), chosen.get(second)
        if a and b and a.source is b.source:
            rows = np.array([seconds(a.source, times[a.source.name]), a.values, b.values])
            t, x, y = rows[:, np.all(np.isfinite(rows), axis=0)]
            if first.startswith("geodetic") and len(x):
                x, y = x * METRES, y * METRES * np.cos(np.radians(x[0]))
            return (t, x, y) if len(t) > 2 else None
    return None


def _doubts(option: str, c: _Candidate) -> Iterator[str]:
    """What the range of values without a known unit makes doubtful."""
    kind, _, key = option.partition(".")
    least, most = float(np.nanmin(c.values)), float(np.nanmax(c.values))
    spans = f"{c.full} ranges from {least:.4g} to {most:.4g}"
    of = c.option.partition(".")[2] if kind == "inputs" else "angle" if option in BEARINGS else ""
    jumps = of == "angle" and np.any(np.abs(np.abs(np.diff(c.values)) - 360.0) < 36.0)
    if kind == "inputs" and PULSE_US[0] <= least and most <= PULSE_US[1]:
        pulse = f"{{column: {c.full}, neutral: 1500, full: 1900}}"
        yield f"{spans}: is it the width of a pulse in us? inputs: {{{key}: {pulse}}}"
    elif max(abs(least), abs(most)) > DOUBTFUL.get(of, np.inf) or jumps:
        unit = "rpm" if of == "n" else "deg"
        yield f"{spans}: in which unit? {kind}: {{{key}: {{column: {c.full}, unit: {unit}}}}}"


def _time(chosen: Chosen, times: Mapping[str, Column]) -> object:
    """The clock that most of the sources in use have, as it is written in a map."""
    used = {c.source.name: c.source for c in chosen.values()}
    shared = Counter(clock.name for source in used.values() for clock in clocks(source))
    own = [times[name] for name in used] or list(times.values())
    column = max(own, key=lambda time: shared[time.name])
    known = {f.name: getattr(column, f.name) for f in fields(column)
             if f.default is MISSING or getattr(column, f.name) != f.default}  # fmt: skip
    return column.column if set(known) == {"column"} else known
