"""Proposes which column is what, from titles, units and how columns move; says what it is unsure of."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from itertools import product
from textwrap import shorten
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.recording.column_map import QUATERNION, Column
from seatrial.models.recording.proposal_by_motion import angle_unit, propose_by_motion, speed_unit
from seatrial.models.recording.quantities import KINDS, REFERENCES, Quantity, quantity
from seatrial.models.recording.source import Source
from seatrial.models.recording.times import clocks, find_time, seconds
from seatrial.models.recording.units import factor, is_known, targets_of, unit_in_title, words_of
from seatrial.models.vessel.basis import Array

ESTIMATES = set("nav navigation odom odometry estimate estimated estimator local filtered ahrs".split())
RAW = set("imu gps gnss mag baro raw sensor fix compass dvl".split())
SYMBOLS = {"eta": "x y z phi theta psi", "nu": "u v w p q r", "tau": "x y z k m n"}  # of matrices
NUMBERED = re.compile(r"(.*?)[\[(_.]?(\d)[\])]?")
PART = re.compile(r"(.*?)([wxyz]|\d)[\])]?")
SIDES = {"port": "1", "left": "1", "starboard": "2", "stbd": "2", "right": "2"}
BEARINGS = ("position.roll", "position.pitch", "position.yaw", "ground.course", "wind.direction")
UNIT_LENGTH = 0.05  # largest deviation of the length of a quaternion from one
DEGREES = {"angle": 4.0 * np.pi, "delta": 0.5 * np.pi, "n": 30.0}  # larger: not rad, or not 1/s
PULSE_US = (800.0, 2300.0)  # widths that are sent to servos and speed controllers
METRES = 111_195.0  # of a degree of latitude


@dataclass(frozen=True)
class Proposal:
    """A map as written in YAML, what is sure of it, what must be asked, and what was left out."""

    map: dict[str, object]
    sure: tuple[str, ...] = ()
    questions: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


class _Candidate(NamedTuple):
    """A column, the quantity that its title names, and the rank of its source."""

    source: Source
    name: str
    quantity: Quantity
    rank: int
    values: Array
    moves: bool


@dataclass
class _Draft:
    """What is chosen: columns by option, and what is said of others."""

    many: bool
    chosen: dict[str, _Candidate] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    how: dict[str, str] = field(default_factory=dict)
    questions: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def written(self, source: Source, name: str, **options: object) -> object:
        """A column as in a map: its name, or its name and what else must be said of it."""
        full = f"{source.name}:{name}" if self.many else name
        known = {key: value for key, value in options.items() if value}
        return {"column": full, **known} if known else full


def propose(sources: Mapping[str, Source], wanted: Sequence[str] = ()) -> Proposal:
    """A map of the columns of a recording.

    Args:
        sources: tables and topics of the recording, by name
        wanted: names of the inputs of the vessel, if one is named

    Raises RecordingError if no source has a column of time.
    """
    times = {name: time for name, source in sources.items() if (time := find_time(source))}
    if not times:
        if len(sources) == 1:
            found = propose_by_motion(*sources.values())
            return Proposal(found, ("the columns are told by how they move together",))
        names = ", ".join(name for source in sources.values() for name in source.columns)
        first = next(iter(sources.values()))
        raise RecordingError(
            f"{first.path}: no column of time among {names[:300]}, expected one such as t or time"
        )
    draft = _Draft(len(sources) > 1)
    timeless = [name for name in sources if name not in times]
    _say(draft, "no column of time", timeless)
    candidates = _candidates([sources[name] for name in times], draft)
    _choose(candidates, draft)
    _choose_inputs(candidates, wanted, draft)
    _find_units(draft, times)
    used = {id(c): c for c in draft.chosen.values()}
    rest = [c for c in candidates if id(c) not in used and c.moves]
    acting = [c for c in rest if c.quantity.option.startswith("inputs")]
    _say(draft, "look like inputs, not mapped", [_full(c, draft) for c in acting])
    others = [_full(c, draft) for c in rest if c not in acting]
    _say(draft, "not used", others)
    gaps = [f"{_full(c, draft)} ({np.isnan(c.values).sum()} of {len(c.values)})" for c in used.values()
            if np.isnan(c.values).any()]  # fmt: skip
    _say(draft, "cells without a value in columns that are mapped", gaps)
    result: dict[str, object] = {"time": _time(draft, times)}
    for option, c in draft.chosen.items():
        kind, _, name = option.partition(".")
        group = result.setdefault(kind, {})
        assert isinstance(group, dict)
        group[name] = draft.written(c.source, c.name, unit=draft.units.get(option))
    linear = draft.chosen.get("velocity.surge") or draft.chosen.get("velocity.sway")
    frames = {"velocity": "earth"} if linear and linear.quantity.frame == "earth" else {}
    if (c := draft.chosen.get("position.surge")) and c.quantity.frame == "ENU":
        frames["position"] = "ENU"
    if frames:
        result["frames"] = frames
    if (c := draft.chosen.get("wind.direction")) and c.quantity.frame == "apparent":
        result["wind"] = {**dict(result["wind"]), "kind": "apparent"}  # type: ignore[call-overload]
    sure = (f"{option}: {_full(c, draft)}{draft.how.get(option, '')}" for option, c in draft.chosen.items())
    return Proposal(result, tuple(sure), tuple(draft.questions), tuple(draft.left_out))


def _say(draft: _Draft, why: str, names: Sequence[str]) -> None:
    if names:
        draft.left_out.append(shorten(f"{why}: {', '.join(names)}", 600, placeholder=" ..."))


def _full(c: _Candidate, draft: _Draft) -> str:
    return f"{c.source.name}:{c.name}" if draft.many else c.name


def _candidates(sources: Sequence[Source], draft: _Draft) -> list[_Candidate]:
    """Columns of numbers by preference: estimates before raw instruments, rich sources first."""
    found, still, texts = [], [], []
    for source in sources:
        known = [value for clock in clocks(source) for value in (clock.name, clock.nanoseconds, clock.date)]
        quaternion = _quaternion(source)
        words = set(words_of(source.name))
        estimate = words & ESTIMATES or any("kf" in word for word in words)
        rank = 3 if words & REFERENCES else 0 if estimate else 2 if words & RAW else 1
        titles = _titles(source)
        for name in source.columns:
            if name in known:
                continue
            full = f"{source.name}:{name}" if draft.many else name
            try:
                values = source.numbers(name, gaps=True)
            except RecordingError:
                texts.append(full)
                continue
            some = values[~np.isnan(values)]
            moves = len(some) > 0 and bool(np.ptp(some) > 0.0)
            if name in quaternion:
                what, moves = Quantity(f"orientation.{quaternion[name]}"), True
            else:
                what = quantity(titles.get(name, name), source.name, source.units.get(name))
            if not moves:
                still.append(full)
            found.append(_Candidate(source, name, what or Quantity("", "", 99), rank, values, moves))
    _say(draft, "not numbers", texts)
    _say(draft, "do not move", still)
    motion = ("position", "velocity", "geodetic", "orientation")
    covered = Counter(c.source.name for c in found if c.moves and c.quantity.option.startswith(motion))
    return sorted(found, key=lambda c: (c.quantity.commanded, c.rank, -covered[c.source.name],
                  c.source.name, c.quantity.frame == "magnetic", c.quantity.strange))  # fmt: skip


def _titles(source: Source) -> dict[str, str]:
    """Titles of the columns of matrices: `eta[2]` of three columns is psi, and forces X, Y, N."""
    groups: dict[str, list[str]] = defaultdict(list)
    for name in source.columns:
        if match := NUMBERED.fullmatch(name):
            groups[match[1]].append(name)
    result = {}
    for stem, names in groups.items():
        last = next((word for word in reversed(words_of(stem)) if word != "dot"), "")
        if last not in KINDS and last not in SYMBOLS and last != "xyz":
            continue
        axes = SYMBOLS.get(last, "x y z").split()
        axes = axes if len(names) == 6 and len(axes) == 6 else [*axes[:2], axes[-1]]
        probe = quantity(f"{stem} x", source.name)
        if len(names) == len(axes) and probe and not probe.option.startswith("inputs"):
            result |= {name: f"{stem} {axis}" for name, axis in zip(names, axes, strict=True)}
    if {"X", "N"} <= set(source.columns):
        result |= {letter: f"tau {letter}" for letter in "XYZKMN"}
    return result


def _choose(candidates: Sequence[_Candidate], draft: _Draft) -> None:
    """Choose the columns of pose, velocities, wind and forces."""

    def pick(option: str, near: _Candidate | None = None, frames: Sequence[str] = ()) -> _Candidate | None:
        fitting = [c for c in candidates if c.quantity.option == option and c.moves
                   and (not frames or c.quantity.frame in frames)]  # fmt: skip
        close = (c for c in fitting if near is not None and c.source is near.source)
        return next(close, fitting[0] if fitting else None)

    def take(kind: str, names: Sequence[str], near: _Candidate | None, only: bool = False,
             frames: Sequence[str] = ()) -> None:  # fmt: skip
        for name in names:
            c = pick(f"{kind}.{name}", near, frames)
            if c is not None and not (only and near is not None and c.source is not near.source):
                draft.chosen[f"{kind}.{name}"] = c

    place = {c.source.name: i for i, c in reversed(list(enumerate(candidates)))}
    x, latitude, yaw = pick("position.surge"), pick("geodetic.latitude"), pick("position.yaw")
    if latitude and (x is None or place[latitude.source.name] < place[x.source.name]):
        take("geodetic", ("latitude", "longitude", "altitude"), latitude, only=True)
    else:
        take("position", DOFS[:3], x)
    near = x or latitude
    quaternion = pick("orientation.w")
    if quaternion and quaternion.rank < 3 and (yaw is None or quaternion.rank <= yaw.rank):
        yaw = quaternion
        take("orientation", QUATERNION, quaternion)
    elif yaw:
        yaw = pick("position.yaw", near) if near and near.rank <= yaw.rank else yaw
        take("position", DOFS[3:], yaw)
        if draft.chosen["position.yaw"].quantity.frame == "magnetic":
            name = _full(draft.chosen["position.yaw"], draft)
            draft.questions.append(f"{name} is a magnetic heading, no true one is recorded: are its "
                                   "deviation and variation to be ignored?")  # fmt: skip
    else:
        take("position", DOFS[3:], near)
    moving = next((c for c in candidates if c.moves
                   and c.quantity.option in ("velocity.surge", "velocity.sway")), None)  # fmt: skip
    if moving:
        body = [c for c in candidates if c.source is moving.source and c.moves and c.quantity.option
                in ("velocity.surge", "velocity.sway") and c.quantity.frame != "earth"]  # fmt: skip
        take("velocity", DOFS[:3], moving, True, ("body", "") if body else ("earth",))
    elif yaw:
        speed, course = pick("ground.speed"), pick("ground.course")
        if speed and course:
            take("ground", ("speed", "course"), speed)
    take("velocity", DOFS[3:], moving or yaw)
    if moving or "ground.speed" in draft.chosen:
        take("water", ("speed",), None)
    take("acceleration", DOFS, moving, only=True)
    for frame in ("true", "apparent"):
        direction = pick("wind.direction", None, (frame,))
        speed = direction and (pick("wind.speed", direction, (frame,)) or pick("wind.speed", direction))
        if direction and speed:
            draft.chosen |= {"wind.speed": speed, "wind.direction": direction}
            break
    acting = next((c for c in candidates if c.quantity.option.startswith("force.") and c.moves), None)
    if acting:
        take("force", DOFS, acting, only=True)


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
                length = np.linalg.norm(values, axis=0)
                if np.nanmax(np.abs(length - 1.0), initial=0.0) < UNIT_LENGTH and np.any(length):
                    size = np.nansum(values**2, axis=1)  # x and y are small, z is not
                    last = order != "wxyz" and size[0] < size[2]
                    order = order[3] + order[:3] if last else order
                    return {parts[part]: q for part, q in zip(order, QUATERNION, strict=True)}
    return {}


def _choose_inputs(candidates: Sequence[_Candidate], wanted: Sequence[str], draft: _Draft) -> None:
    """Columns that act, by the names of the vessel, or by delta, n and their own names."""
    free = [c for c in candidates if c not in draft.chosen.values()]
    if not wanted:
        acting = [c for c in free if c.quantity.option.startswith("inputs.") and c.moves]
        if any(option.startswith("force.") for option in draft.chosen):
            return
        for option in ("inputs.delta", "inputs.n", "inputs."):
            same = [c for c in acting if c.quantity.option == option]
            same = [c for c in same if not c.quantity.commanded] or same
            names = Counter(c.name for c in same)
            for c in same:
                own = c.name if names[c.name] == 1 and c.name != "data" else _full(c, draft)
                draft.chosen[option if len(same) == 1 and option != "inputs." else f"inputs.{own}"] = c
        return
    for option in [option for option in draft.chosen if option.startswith("force.")]:
        del draft.chosen[option]
    for name in wanted:
        concept, side = quantity(name), _side(name)
        exact = [c for c in free if "_".join(words_of(c.name)).startswith("_".join(words_of(name)))]
        exact = [c for c in exact if "_".join(words_of(c.name)) == "_".join(words_of(name))] or exact
        same = [c for c in free if concept and c.quantity.option == concept.option]
        same = [c for c in same if c.moves] or same
        fitting = exact[:1] or [c for c in same if _side(c.name) == side] or (same if not side else [])
        fitting = [c for c in fitting if not c.quantity.commanded] or fitting
        if len(fitting) == 1:
            draft.chosen[f"inputs.{name}"] = fitting[0]
            free.remove(fitting[0])
        else:
            some = ", ".join(_full(c, draft) for c in fitting or same) or "no column looks like it"
            draft.questions.append(f"which column is the input {name} of the vessel? ({some}): inputs: {{{name}: COLUMN}}")


def _side(name: str) -> str:
    return next((SIDES.get(w, w) for w in words_of(name) if w in SIDES or w.isdigit()), "")


def _find_units(draft: _Draft, times: Mapping[str, Column]) -> None:
    """Units by header, title, motion, then as of the same quantity beside it; questions by range."""
    read: dict[str, str] = {}  # units that are known, also those that need not be written
    for option, c in draft.chosen.items():
        header, targets = c.source.units.get(c.name), targets_of(option)
        title = unit_in_title(c.name, targets)
        if header and any(is_known(header, target) for target in targets):
            read[option], draft.how[option] = header, f" in {header} (header)"
        elif title:
            read[option], draft.how[option] = title, f" in {title} (title)"
            _write(draft, option, title)
    path = _path(draft, times)
    for option, unit_of in (("position.yaw", angle_unit), ("ground.speed", speed_unit)):
        c = draft.chosen.get(option)
        if path and c and option not in read:
            t = seconds(c.source, times[c.source.name])
            known = np.isfinite(t) & np.isfinite(c.values)
            if unit := unit_of(path, t[known], c.values[known]):
                read[option], draft.how[option] = unit, f" in {unit} (by the motion)"
                _write(draft, option, unit)
    for option, c in draft.chosen.items():
        if option in read or option.startswith("inputs."):
            continue
        like = BEARINGS if option in BEARINGS else [
            other for other in read if other.partition(".")[0] == option.partition(".")[0]
            and targets_of(other) == targets_of(option)]  # fmt: skip
        beside = next((o for o in like if o in read and draft.chosen[o].source is c.source), None)
        if beside is not None:
            draft.how[option] = f" in {read[beside]} (as {draft.chosen[beside].name})"
            _write(draft, option, read[beside])
            read[option] = read[beside]
    for option, c in draft.chosen.items():
        draft.questions += () if option in read else _questions(option, _full(c, draft), c)


def _write(draft: _Draft, option: str, unit: str) -> None:
    target = next(target for target in targets_of(option) if is_known(unit, target))
    if factor(unit, target) != 1.0:
        draft.units[option] = unit


def _questions(option: str, name: str, c: _Candidate) -> Iterator[str]:
    """What the range of values without a known unit makes doubtful."""
    kind, _, key = option.partition(".")
    least, most = float(np.nanmin(c.values)), float(np.nanmax(c.values))
    spans = f"{name} ranges from {least:.4g} to {most:.4g}"
    jumps = np.any(np.abs(np.abs(np.diff(c.values)) - 360.0) < 36.0)
    asked = c.quantity.option.partition(".")[2] if kind == "inputs" else "angle"
    size = max(abs(least), abs(most))
    if kind == "inputs" and PULSE_US[0] <= least and most <= PULSE_US[1]:
        yield (f"{spans}: is it the width of a pulse in us? inputs: {{{key}: {{column: {name}, "
               "neutral: 1500, full: 1900}}")  # fmt: skip
    elif (option in BEARINGS or kind == "inputs") and (size > DEGREES.get(asked, np.inf) or (jumps and asked == "angle")):
        unit = "rpm" if asked == "n" else "deg"
        yield f"{spans}: in which unit? {kind}: {{{key}: {{column: {name}, unit: {unit}}}}}"


def _path(draft: _Draft, times: Mapping[str, Column]) -> tuple[Array, Array, Array] | None:
    """Times [s] and positions along two axes [m]; None: not recorded in one source."""
    pairs = (("position.surge", "position.sway"), ("geodetic.latitude", "geodetic.longitude"))
    for first, second in pairs:
        a, b = draft.chosen.get(first), draft.chosen.get(second)
        if a and b and a.source is b.source:
            t, x, y = seconds(a.source, times[a.source.name]), a.values, b.values
            known = np.isfinite(t) & np.isfinite(x) & np.isfinite(y)
            t, x, y = t[known], x[known], y[known]
            if first.startswith("geodetic") and len(x):
                x, y = x * METRES, y * METRES * np.cos(np.radians(x[0]))
            return (t, x, y) if len(t) > 2 else None
    return None


def _time(draft: _Draft, times: Mapping[str, Column]) -> object:
    """The clock that most of the sources in use have, as it is written in a map."""
    used = {c.source.name: c.source for c in draft.chosen.values()}
    shared = Counter(clock.name for source in used.values() for clock in clocks(source))
    own = [times[name] for name in used] or list(times.values())
    column = max(own, key=lambda time: shared[time.name])
    known = {f.name: getattr(column, f.name) for f in fields(column)}
    known = {f.name: known[f.name] for f in fields(column) if known[f.name] != f.default}
    return column.column if set(known) == {"column"} else known
