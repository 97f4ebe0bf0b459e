"""Proposes which column is what, by titles, units and motion, and says what it is unsure of."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from textwrap import shorten
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.column_map import (
    BEARINGS,
    QUATERNION,
    Column,
    factor,
    stated_unit,
    target_of,
    targets_of,
    words_of,
)  # fmt: skip
from seatrial.models.recording.column_map import INPUTS as UNITS_OF_INPUTS
from seatrial.models.recording.quantities import KIND_OF, WORDS, Quantity, quantity
from seatrial.models.recording.source import Source
from seatrial.models.recording.times import clocks, find_time
from seatrial.models.vessel.basis import INPUTS, Array

SYMBOLS = {"eta": "x y z phi theta psi", "nu": "u v w p q r", "tau": "x y z k m n"}  # of matrices
PLANE = ("x", "y", "z", "phi", "psi", "yaw", "roll")  # of which two stand beside a heading theta
NUMBERED = re.compile(r"(.*?)[\[(_.]?(\d)[\])]?")
RUN = re.compile(r"(.*)/\d+")
PART = re.compile(r"(.*?)([wxyz]|\d)[\])]?")
SIDES = {"port": "1", "left": "1", "starboard": "2", "stbd": "2", "right": "2"}
RANKS = {"reference": 3, "estimate": 0, "raw": 2}  # of sources by their names, others between
MIN_SAMPLES = 30  # of a record that is preferred to others
UNIT_LENGTH = 0.05  # largest deviation of the length of a quaternion from one
AXES_OF = {  # where a map states the axes or reference of a column
    **dict.fromkeys(("velocity.surge", "velocity.sway"), ("frames", "velocity", "earth")),
    "position.surge": ("frames", "position", "ENU"), "wind.direction": ("wind", "kind", "apparent"),
}  # fmt: skip


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
    rank: int  # of its source: 0 an estimate, 1 others, 2 a sensor, 3 a reference
    values: Array
    moves: bool


Chosen = dict[str, _Candidate]  # by option of a map


def propose(sources: Mapping[str, Source], wanted: Sequence[str] = ()) -> Proposal:
    """A map of the columns of a recording; `wanted` are the inputs of the vessel, if one is named.

    Raises RecordingError if no source has a column of time.
    """
    times = {name: time for name, source in sources.items() if (time := find_time(source))}
    if not times:
        names = ", ".join(name for source in sources.values() for name in source.columns)
        raise RecordingError(
            f"{next(iter(sources.values())).path}: no column of time among {names[:300]}, expected "
            "one such as t or time, or a map with text: {names: [t, ...]} or time: COLUMN"
        )
    longest = dict[tuple[str, ...], str]()  # of runs, or sensors, that have the same columns
    for name in sorted(times, key=lambda name: -len(sources[name])):
        number = RUN.fullmatch(name)
        longest.setdefault((number[1], *sources[name].columns) if number else (name,), name)
    used = [name for name in times if name in longest.values()]
    every, texts = _candidates([sources[name] for name in used], len(sources) > 1)
    acting = {f"force.{dof}" for dof in PLANAR}  # also where they are zero
    candidates = [c for c in every if c.moves or c.option in acting]
    chosen = _motion([c for c in candidates if not (wanted and c.option.startswith("force."))])
    asked = [*_actions(every, wanted, chosen)]
    clock, line = _clock(chosen, times, sources)
    sure, columns = [line], defaultdict[str, dict[str, object]](dict)
    stated = {o: stated_unit(c.source, c.name, targets_of(o)) for o, c in chosen.items()}
    for option, c in chosen.items():
        kind, _, name = option.partition(".")
        beside = ((told[0], f"as {chosen[o].name}") for o, told in stated.items()
                  if told and chosen[o].source is c.source
                  and targets_of(o) == targets_of(option) != UNITS_OF_INPUTS
                  and (o.startswith(f"{kind}.") or {o, option} <= {*BEARINGS}))  # fmt: skip
        unit, origin = stated[option] or next(beside, ("", ""))
        sure.append(f"{option}: {c.full}" + (f" in {unit} ({origin})" if unit else ""))
        target = target_of(unit, targets_of(option)) or ""
        written = unit and origin != "the file" and factor(unit, target) != 1.0
        columns[kind][name] = {"column": c.full, "unit": unit} if written else c.full
        group, key, frame = AXES_OF.get(option, ("", "", "any"))
        if c.frame == frame:
            columns[group][key] = frame
        if c.frame == "magnetic":
            asked.append(f"{c.full} is a magnetic heading: is its variation to be ignored?")
    left = [("no column of time", name) for name in sources if name not in times]
    left += [("of the same columns as another", name) for name in times if name not in used]
    left += [("not numbers", name) for name in texts]
    lines = _left_out(left, every, {c.full for c in chosen.values()})
    asked += _doubts(every, chosen)
    return Proposal({"time": clock, **columns}, tuple(sure), tuple(asked), tuple(lines))


def _doubts(every: Sequence[_Candidate], chosen: Chosen) -> Iterator[str]:
    """What is asked of the motion: the meaning of a speed, and of the heading."""
    speed, course = (next((c.full for c in every if c.option == o and c.moves), None)
                     for o in ("speed", "ground.course"))  # fmt: skip
    if speed and course and not {"velocity.surge", "velocity.sway", "ground.speed"} & set(chosen):
        yield (f"is {speed} over ground (ground: {{speed: {speed}, course: {course}}}) or "
               f"through the water (water: {{speed: {speed}}})?")  # fmt: skip
    placed = {"geodetic.latitude", "position.surge"} & set(chosen)
    if placed and not {"position.yaw", "orientation.w"} & set(chosen):
        yield "which column is the heading (a course is none)? position: {yaw: COLUMN}"


def _left_out(
    left: list[tuple[str, str]], every: Sequence[_Candidate], used: set[str]
) -> Iterator[str]:
    """Lines of what is not in the map, by reason; those of `left` are known."""
    for c in every:
        reason = "look like inputs, not mapped" if c.option.startswith("inputs") else "not used"
        if c.full not in used:  # the elements of an array as one
            name = re.sub(r"\[\d+\]$", "[...]", c.full)
            left.append((reason if c.moves else "do not move", name))
        elif missing := np.isnan(c.values).sum():
            name = f"{c.full} ({missing} of {len(c.values)})"
            left.append(("without a value in some rows, though mapped", name))
    for why in dict.fromkeys(why for why, _ in left):
        names = dict.fromkeys(name for reason, name in left if reason == why)
        yield shorten(f"{why}: {', '.join(names)}", 600, placeholder=" ...")


def _candidates(sources: Sequence[Source], many: bool) -> tuple[list[_Candidate], list[str]]:
    """Columns of numbers, the likeliest first, and the names of others.

    What moves comes first; then what is measured, estimates, sources with more of the motion.
    """
    every, texts = list[_Candidate](), list[str]()
    for source in sources:
        words = {word.rstrip("0123456789") for word in words_of(source.name)}
        rank = next((rank for kind, rank in RANKS.items() if words & WORDS[kind]), 1)
        titles, quaternion = _titles(source), _quaternion(source)
        used = {name for c, _ in clocks(source) for name in (c.name, c.nanoseconds, c.date)}
        for name in (name for name in source.columns if name not in used):
            full = f"{source.name}:{name}" if many else name
            try:
                values = source.numbers(name, gaps=True)
            except RecordingError:
                texts.append(full)
                continue
            known_as = [titles[name]] if name in titles else [name, source.titles.get(name, name)]
            results = (quantity(t, source.name, source.units.get(name)) for t in known_as)
            result = next(filter(None, results), Quantity("", strange=99))
            result = quaternion.get(name, result)
            moves = name in quaternion or bool(np.any(np.diff(values[~np.isnan(values)])))
            every.append(_Candidate(source, name, full, *result, rank, values, moves))
    motion = ("position", "velocity", "geodetic", "orientation")
    covered = Counter(c.source.name for c in every if c.moves and c.option.startswith(motion))
    every.sort(key=lambda c: (not c.moves, len(c.values) < MIN_SAMPLES, c.commanded, c.rank,
                              -covered[c.source.name], c.source.name, c.frame == "magnetic",
                              c.strange))  # fmt: skip
    return every, texts


def _titles(source: Source) -> dict[str, str]:
    """Titles of the columns of matrices, `eta[2]` of three is psi, and of the forces X, Y, N."""
    forces = {"X", "N"} <= set(source.columns)
    result = {letter: f"tau {letter}" for letter in "XYZKMN"} if forces else {}
    if {"N", "E"} <= set(source.columns):
        result |= {"N": "position north", "E": "position east", "D": "position down", "U": "up"}
    for name in source.columns:  # a pose in the plane, as of ROS: x, y and theta
        beside = {axis for axis in PLANE if re.sub("(?i)theta$", axis, name) in source.columns}
        if name.lower().endswith("theta") and beside == {"x", "y"}:
            result |= {name: "yaw", "w": "yaw rate", "omega": "yaw rate"}
    groups = defaultdict[str, list[str]](list)
    for name in source.columns:
        if match := NUMBERED.fullmatch(name):
            groups[match[1]].append(name)
    for stem, names in groups.items():
        words = [w for w in words_of(stem) if w != "dot" and w not in WORDS["neutral"]]
        last = (words or words_of(source.name) or [""])[-1]
        axes = SYMBOLS.get(last, "x y z").split()
        axes = axes if len(names) == len(axes) else [*axes[:2], axes[-1]]
        if len(names) == len(axes) and (last in (*SYMBOLS, "xyz") or last in KIND_OF):
            stem = last if not words and last in SYMBOLS else stem
            result |= {n: f"{stem} {axis}" for n, axis in zip(names, axes, strict=True)}
    return result


def _quaternion(source: Source) -> dict[str, Quantity]:
    """Four columns that differ in w, x, y, z, or a number, and are of length one together."""
    groups = defaultdict[str, dict[str, str]](dict)
    for name in source.columns:
        if (match := PART.fullmatch(name)) and not set(words_of(name)) & WORDS["reference"]:
            groups[match[1]][match[2]] = name
    for parts, order in product(groups.values(), ("wxyz", "0123", "1234")):
        with suppress(KeyError, RecordingError):
            values = np.array([source.numbers(parts[part], gaps=True) for part in order])
            apart = np.abs(np.linalg.norm(values, axis=0) - 1.0)
            if np.any(apart < UNIT_LENGTH) and not np.any(apart > UNIT_LENGTH):
                size = np.nansum(values**2, axis=1)  # x and y are small, z is not
                last = order != "wxyz" and size[0] < size[2]
                named = zip("xyzw" if last else "wxyz", order, strict=True)
                return {parts[part]: Quantity(f"orientation.{q}") for q, part in named}
    return {}


def _motion(candidates: Sequence[_Candidate]) -> Chosen:
    """The columns of pose, velocities, wind and forces, of one source each as far as possible."""
    chosen = Chosen()

    def all_of(option: str) -> list[_Candidate]:
        return [c for c in candidates if c.option == option]

    def first(option: str) -> _Candidate | None:
        return next(iter(all_of(option)), None)

    def take(kind: str, names: Sequence[str], near: _Candidate | None, only: bool = True) -> None:
        for option in (f"{kind}.{name}" for name in names):  # of the source of a column, else any
            own = [c for c in all_of(option) if near is None or c.source is near.source]
            if best := own or ([] if only else all_of(option)):
                chosen[option] = best[0]

    latitude, yaw, whole = map(first, ("geodetic.latitude", "position.yaw", "orientation.w"))
    across = [c.source for c in all_of("position.sway")]
    # a path has two coordinates, of one instrument
    x = next((c for c in all_of("position.surge")
              if c.source in across or not (across or latitude)), None)  # fmt: skip
    order = [c.source.name for c in candidates]
    if latitude and not (x and order.index(x.source.name) <= order.index(latitude.source.name)):
        take("geodetic", ("latitude", "longitude", "altitude"), latitude)
    else:
        take("position", DOFS[:3] if x else DOFS[2:3], x)
    if whole and whole.rank < 3 and (yaw is None or whole.rank <= yaw.rank):
        yaw = whole
        take("orientation", QUATERNION, whole)
    elif yaw:
        near = x or latitude or yaw
        take("position", ("yaw",), near if near.rank <= yaw.rank else yaw, only=False)
        yaw = chosen["position.yaw"]
    if "orientation.w" not in chosen:
        take("position", ("roll", "pitch"), yaw, only=False)
    linear = [f"velocity.{dof}" for dof in DOFS[:3]]
    along = [c for c in candidates if c.option in linear[:2]]
    along = [c for c in along if c.source is along[0].source]
    moving = min(along, key=lambda c: c.frame == "earth", default=None)
    if moving:
        candidates = [c for c in candidates if c.option not in linear
                      or (c.frame == "earth") == (moving.frame == "earth")]  # fmt: skip
        take("velocity", DOFS[:3], moving)
    elif yaw and first("ground.speed") and first("ground.course"):
        take("ground", ("speed", "course"), first("ground.speed"), only=False)
    take("velocity", DOFS[3:], moving or yaw, only=False)
    if moving or "ground.speed" in chosen:
        take("water", ("speed",), None)
    winds = [(v, a) for v, a in product(all_of("wind.speed"), all_of("wind.direction"))
             if v.frame == a.frame or v.source is a.source]  # fmt: skip
    winds.sort(key=lambda pair: (pair[0].frame != pair[1].frame, pair[1].frame != "true"))
    for v, a in winds[:1]:  # of one kind, or at least of one source; rather true than apparent
        chosen |= {"wind.speed": v, "wind.direction": a}
    acting = next((c for c in candidates if c.option.startswith("force.")), None)
    if acting and acting.moves:
        take("force", DOFS, acting)
    return chosen


def _actions(every: Sequence[_Candidate], wanted: Sequence[str], chosen: Chosen) -> Iterator[str]:
    """Choose what acts, by the names of the vessel, or by those that one can have; asks the rest.

    Shafts are n, or n_1, n_2 ... from port to starboard, other devices pwm_1, angles alpha_1 ...
    """
    kinds: dict[str, list[_Candidate]] = {"delta": [], "n": [], "pwm": [], "alpha": []}
    for c in every:
        if c.option.startswith("inputs.") and (c.moves or wanted):
            other = "alpha" if stated_unit(c.source, c.name, ("rad",)) else "pwm"
            kinds[c.option.removeprefix("inputs.") or other].append(c)
    for kind, same in kinds.items():
        best = min(((not c.moves, c.commanded) for c in same), default=())
        same = [c for c in same if (not c.moves, c.commanded) == best]
        kinds[kind] = same = sorted(same, key=lambda c: _side(c.name))
        forces = any(option.startswith("force.") for option in chosen)
        for i, c in enumerate(same if not wanted and not forces else (), 1):
            name = kind if len(same) == 1 and kind in INPUTS else f"{kind}_{i}"
            chosen[f"inputs.{name if name in INPUTS else c.full}"] = c
    for name in wanted:
        used, words = {c.full for c in chosen.values()}, words_of(name)
        same = [c for c in kinds.get(words[0], []) if c.full not in used]
        titled = [c for c in every if words_of(c.name)[: len(words)] == words]
        fitting = (
            [c for c in titled if words_of(c.name) == words and c.full not in used][:1]
            or [c for c in same if _side(c.name) == _side(name)]
            or (same if not _side(name) else [])
            or [c for c in titled if words[0] not in kinds and c.full not in used]
        )
        if len(fitting) == 1:
            chosen[f"inputs.{name}"] = fitting[0]
        else:
            some = ", ".join(c.full for c in fitting or same) or "no column looks like it"
            yield (f"which column is the input {name} of the vessel? ({some}): "
                   f"inputs: {{{name}: COLUMN}}")  # fmt: skip


def _side(name: str) -> str:
    """The number of a device in a name, from port to starboard; "" without any."""
    return next((SIDES.get(w, w) for w in words_of(name) if w in SIDES or w.isdigit()), "")


def _clock(
    chosen: Chosen, times: Mapping[str, Column], sources: Mapping[str, Source]
) -> tuple[object, str]:
    """The clock that most of the sources in use have, as in a map, and where it is known from."""
    used = dict.fromkeys(c.source.name for c in chosen.values()) or times
    shared = Counter(clock.name for name in used for clock, _ in clocks(sources[name]))
    holder = sources[max(used, key=lambda name: shared[times[name].name])]
    clock = times[holder.name]
    guessed = (clock.unit, "by its numbers") if clock.unit else ("s", "no unit is stated")
    unit, origin = stated_unit(holder, clock.name, ("s",)) or guessed
    text = holder.columns[clock.name].dtype == np.object_
    how = "dates or times of day" if text else f"in {unit} ({origin})"
    return clock.written, f"time: {clock.name} {how}"
