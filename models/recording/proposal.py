"""Proposes which column is what, by titles, units and motion, and says what it is unsure of."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.column_map import (
    QUATERNION,
    SI_ASSUMED,
    Column,
    ColumnMap,
    readings,
    si_factor,
    stated_unit,
    targets_of,
    together,
    words_of,
)  # fmt: skip
from seatrial.models.recording.quantities import KIND_OF, WORDS, Quantity, quantity
from seatrial.models.recording.source import Source
from seatrial.models.recording.times import clocks, find_time
from seatrial.models.vessel.basis import INPUTS, Array

SYMBOLS = {"eta": "x y z phi theta psi", "nu": "u v w p q r", "tau": "x y z k m n"}  # of matrices
PLANE = ("x", "y", "z", "phi", "psi", "yaw", "roll")  # of which two stand beside a heading theta
RUN = re.compile(r"(.*)/\d+")
PART = re.compile(r"(.*?)([wxyz]|\d)[\])]?")
SIDES = {"port": "1", "left": "1", "starboard": "2", "stbd": "2", "right": "2"}
RANKS = {"reference": 3, "estimate": 0, "raw": 2}  # of sources by their names, others between
MIN_SAMPLES = 30  # of a record that is preferred to others
UNKNOWN = Quantity("", strange=99)
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
    every = _candidates([sources[name] for name in longest.values()], len(sources) > 1)
    acting = {f"force.{dof}" for dof in PLANAR}  # also where they are zero
    candidates = [c for c in every if c.moves or c.option in acting]
    chosen = _motion([c for c in candidates if not (wanted and c.option.startswith("force."))])
    asked = [*_actions(every, wanted, chosen)]
    clock, line = _clock(chosen, times, sources)
    sure, columns = [line], defaultdict[str, Any](dict)
    for option, c in chosen.items():
        kind, _, name = option.partition(".")
        columns[kind][name] = c.full
        group, key, frame = AXES_OF.get(option, ("", "", "any"))
        if c.frame == frame:
            columns[group][key] = frame
        if c.frame == "magnetic":
            asked.append(f"{c.full} is a magnetic heading: is its variation to be ignored?")
    for option, reading in readings(sources, ColumnMap(clock, **columns)).items():
        (kind, _, name), unit, origin = option.partition("."), reading.unit, reading.known_from
        known = unit if targets_of(option) and origin != SI_ASSUMED else ""
        sure.append(f"{option}: {reading.column}" + (f" in {unit} ({origin})" if known else ""))
        if known and origin != "the file" and si_factor(option, unit) != 1.0:
            columns[kind][name] = {"column": reading.column, "unit": unit}
    asked += _doubts(every, chosen)
    notes = [f"column {name}:*: no column of time" for name in sources if name not in times]
    notes += [f"column {name}:*: like those of another source, which is longer"
              for name in times if name not in longest.values()]  # fmt: skip
    used = {c.full for c in chosen.values()}
    for c in every:
        if c.full not in used:
            name = re.sub(r"\[\d+\]$", "[...]", c.full)  # the elements of an array as one
            reason = "look like inputs, not mapped" if c.option.startswith("inputs") else "not used"
            reason = (reason if c.moves else "do not move") if len(c.values) else "not numbers"
            notes.append(f"column {name}: {reason}")
        elif missing := np.isnan(c.values).sum():
            rows = f"{c.full} ({missing} of {len(c.values)})"
            notes.append(f"column {rows}: without a value in some rows, though mapped")
    node = {"time": clock.written, **columns}
    return Proposal(node, tuple(sure), tuple(asked), tuple(together(notes)))


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


def _candidates(sources: Sequence[Source], many: bool) -> list[_Candidate]:
    """The columns but those of time, the likeliest first; those of text have no values.

    What moves comes first; then what is measured, estimates, sources with more of the motion.
    """
    every = list[_Candidate]()
    for source in sources:
        words = {word.rstrip("0123456789") for word in words_of(source.name)}
        rank = next((rank for kind, rank in RANKS.items() if words & WORDS[kind]), 1)
        used = {name for c, _ in clocks(source) for name in (c.name, c.nanoseconds, c.date)}
        beside = _beside(source)
        for name in (name for name in source.columns if name not in used):
            text = source.columns[name].dtype == np.object_
            values = np.empty(0) if text else source.numbers(name, gaps=True)
            titles = () if text else (name, source.titles.get(name, name))
            results = (quantity(t, source.name, source.units.get(name)) for t in titles)
            result = beside.get(name) or next(filter(None, results), UNKNOWN)
            moves = "orientation" in result.option or np.any(np.diff(values[~np.isnan(values)]))
            full = f"{source.name}:{name}" if many else name
            every.append(_Candidate(source, name, full, *result, rank, values, bool(moves)))
    motion = ("position", "velocity", "geodetic", "orientation")
    covered = Counter(c.source.name for c in every if c.moves and c.option.startswith(motion))
    every.sort(key=lambda c: (not c.moves, len(c.values) < MIN_SAMPLES, c.commanded, c.rank,
                              -covered[c.source.name], c.source.name, c.frame == "magnetic",
                              c.strange))  # fmt: skip
    return every


def _beside(source: Source) -> dict[str, Quantity]:
    """What columns mean that tell it together: matrices, quaternions, a pose, the forces X, Y, N.

    `eta[2]` of three is psi; four columns that differ in a letter or number, and are of length one,
    are a quaternion.
    """
    numeric = [name for name, values in source.columns.items() if values.dtype != np.object_]
    titles, result = dict[str, str](), dict[str, Quantity]()
    if {"X", "N"} <= {*numeric}:
        titles = {letter: f"tau {letter}" for letter in "XYZKMN"}
    if {"N", "E"} <= {*numeric}:
        titles |= {"N": "position north", "E": "position east", "D": "position down", "U": "up"}
    groups = defaultdict[str, dict[str, str]](dict)
    for name in numeric:
        if match := PART.fullmatch(name):
            groups[match[1]][match[2]] = name
        beside = {axis for axis in PLANE if re.sub("(?i)theta$", axis, name) in numeric}
        if name.lower().endswith("theta") and beside == {"x", "y"}:  # a pose in the plane
            titles |= {name: "yaw", "w": "yaw rate", "omega": "yaw rate"}
    for stem, parts in groups.items():
        words = [w for w in words_of(stem) if w != "dot" and w not in WORDS["neutral"]]
        last = (words or words_of(source.name) or [""])[-1]
        axes = SYMBOLS.get(last, "x y z").split()
        axes = axes if len(parts) == len(axes) else [*axes[:2], axes[-1]]
        known = last in (*SYMBOLS, "xyz") or last in KIND_OF
        if known and len(parts) == len(axes) and "".join(parts).isdigit():
            stem = last if not words and last in SYMBOLS else stem
            titles |= {n: f"{stem} {axis}" for n, axis in zip(parts.values(), axes, strict=True)}
        orders = (order for order in ("wxyz", "0123", "1234") if {*order} <= {*parts})
        for order in orders if not {*words_of(stem)} & WORDS["reference"] else ():
            values = np.array([source.columns[parts[part]] for part in order])
            apart = np.abs(np.linalg.norm(values, axis=0) - 1.0)
            if np.any(apart < UNIT_LENGTH) and not np.any(apart > UNIT_LENGTH) and not result:
                size = np.nansum(values**2, axis=1)  # x and y are small, z is not
                order_of = "xyzw" if order != "wxyz" and size[0] < size[2] else "wxyz"
                result = {parts[part]: Quantity(f"orientation.{q}")
                          for q, part in zip(order_of, order, strict=True)}  # fmt: skip
    named = {name: quantity(title, source.name, source.units.get(name)) or UNKNOWN
             for name, title in titles.items()}  # fmt: skip
    return named | result


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

    def pair(option: str, other: str) -> _Candidate | None:  # a path has two, of one instrument
        beside = [c.source for c in all_of(other)]
        return next((c for c in all_of(option) if c.source in beside), None)

    latitude, x = (pair("geodetic.latitude", "geodetic.longitude"),
                   pair("position.surge", "position.sway"))  # fmt: skip
    x = x or (None if latitude or first("position.sway") else first("position.surge"))
    yaw, whole = first("position.yaw"), first("orientation.w")
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
        free = [c for c in every if len(c.values) and c.full not in used]
        same = [c for c in kinds.get(words[0], []) if c.full not in used]
        fitting = (
            [c for c in free if words_of(c.name) == words][:1]
            or [c for c in same if _side(name) in ("", _side(c.name))]
            or [
                c for c in free if words[0] not in kinds and words_of(c.name)[: len(words)] == words
            ]
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
) -> tuple[Column, str]:
    """The clock that most of the sources in use have, as in a map, and where it is known from."""
    used = dict.fromkeys(c.source.name for c in chosen.values()) or times
    shared = Counter(clock.name for name in used for clock, _ in clocks(sources[name]))
    holder = sources[max(used, key=lambda name: shared[times[name].name])]
    clock = times[holder.name]
    guessed = (clock.unit, "by its numbers") if clock.unit else ("s", "no unit is stated")
    unit, origin = stated_unit(holder, clock.name, ("s",)) or guessed
    text = holder.columns[clock.name].dtype == np.object_
    how = "dates or times of day" if text else f"in {unit} ({origin})"
    return clock, f"time: {clock.name} {how}"
