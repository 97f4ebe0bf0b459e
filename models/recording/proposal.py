"""Proposes which column is what, from names, units of the header, ranges and correlations."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.recording.column_map import Column
from seatrial.models.recording.proposal_by_motion import propose_by_motion
from seatrial.models.recording.source import Source
from seatrial.models.recording.times import seconds
from seatrial.models.vessel.basis import Array

# What a name is called, most telling first; of several columns the first in the file is taken.
NAMES: Mapping[str, tuple[str, ...]] = {
    "geodetic.latitude": (r"lat(itude)?",),
    "geodetic.longitude": (r"lon(gitude)?|lng",),
    "geodetic.altitude": (r"alt(itude)?",),
    "position.surge": (r"(x|pos(ition)?_?x|x_?(ned|north|pos(ition)?)|north(ing)?)(_.*)?",
                       r".*pos.*_x"),
    "position.sway": (r"(y|pos(ition)?_?y|y_?(ned|east|pos(ition)?)|east(ing)?)(_.*)?",
                      r".*pos.*_y"),
    "position.heave": (r"(z|pos(ition)?_?z|z_?(ned|down|pos(ition)?)|down|depth)(_.*)?",
                       r".*pos.*_z"),
    "position.roll": (r"(roll|phi)(_(angle|deg|rad|hat))?",),
    "position.pitch": (r"(pitch|theta)(_(angle|deg|rad|hat))?",),
    "position.yaw": (r"(yaw|psi|heading|hdg)(_(angle|deg|rad|hat))?",),
    "velocity.surge": (r"(u|surge|vel(ocity)?_?x|u_?(vel.*|kn|knots?|mps))",
                       r"surge_?(vel.*|speed)",
                       r"(spd|speed|vel.*)_?(fwd|forward|ahead|surge|long.*)",
                       r".*(linear|vel).*_x"),
    "velocity.sway": (r"(v|sway|vel(ocity)?_?y|vm?_?(vel.*|kn|knots?|mps))",
                      r"sway_?(vel.*|speed)",
                      r"(spd|speed|vel.*)_?(stbd|starboard|abeam|sway|lat.*)",
                      r".*(linear|vel).*_y"),
    "velocity.heave": (r"(w|heave|vel(ocity)?_?z|w_?(vel.*|mps))", r"heave_?(vel.*|speed)",
                       r".*(linear|vel).*_z"),
    "velocity.roll": (r"p|roll_?(rate|vel.*)|p_?ang.*", r".*angular.*_x"),
    "velocity.pitch": (r"q|pitch_?(rate|vel.*)|q_?ang.*", r".*angular.*_y"),
    "velocity.yaw": (r"r|yaw_?(rate|vel.*)|r_?ang.*|rot|rate_?of_?turn", r".*angular.*_z"),
    "acceleration.surge": (r"(u|surge)_?(dot|acc.*)",),
    "acceleration.sway": (r"(v|sway)_?(dot|acc.*)",),
    "acceleration.yaw": (r"(r|yaw)_?(dot|acc.*)",),
    "force.surge": (r"(.*force|tau|f)_?x|tau_?(u|surge)",),
    "force.sway": (r"(.*force|tau|f)_?y|tau_?(v|sway)",),
    "force.heave": (r"(.*force|tau|f)_?z|tau_?(w|heave)",),
    "force.roll": (r"(.*(torque|moment)|m)_?x|tau_?(p|roll|k)",),
    "force.pitch": (r"(.*(torque|moment)|m)_?y|tau_?(q|pitch|m)",),
    "force.yaw": (r"(.*(torque|moment)|m)_?z|tau_?(r|yaw|n)",),
    "inputs.delta": (r"(delta|rudder).*",),
    "inputs.n": (r"n|n_prop.*|rpm|rps|shaft.*|propeller.*",),
}  # fmt: skip
# The unit at the end of a name, and what it is where it is not that of SI.
SUFFIX = r"_(deg|rad)(_?(p|per)?_?(s|min))?$|_(m|m_?p?_?s|kn|kts?|knots?|k?nm?|rpm)$"
ENDINGS: Mapping[str, Mapping[str, str]] = {
    "velocity": {
        r"kn|kts?|knots?": "knot", r"deg(_?(p|per)?_?s)?": "deg/s", r"deg_?(p|per)?_?min": "deg/min"
    },
    "force": {"kn": "kN", "knm": "kNm"},
}  # fmt: skip
INPUT = r".*(thr|pwm|rudder|rpm|rps|motor_speed|throttle|force).*"  # where nothing else acts
TIMES = (r"(original_|elapsed_)?time(_?stamp)?|stamp", r"t|sec(ond)?s?|.*stamp.*secs")
TIME_SUFFIX = re.compile(r"_(?P<unit>s|sec|ms|us|ns)$", re.IGNORECASE)
QUATERNION = ("w", "x", "y", "z")
UNIT_STEPS = {"ns": 1e6, "us": 1e3, "ms": 1.5}  # median step above which numbers are of this unit
PREFERRED = ("nav", "odom", "estimate", "")  # sources of the state, before raw instruments
Options = dict[str, dict[str, object]]


def propose(sources: Mapping[str, Source]) -> dict[str, object]:
    """A map of the columns: time, and by option the column of each axis.

    Raises RecordingError if no source has a column of time.
    """
    clocked = {name: time for name, source in sources.items() if (time := _time(source))}
    if not clocked and len(sources) == 1:
        return propose_by_motion(next(iter(sources.values())))
    if not clocked:
        names = ", ".join(name for source in sources.values() for name in source.columns)
        raise RecordingError(
            f"{next(iter(sources.values())).path}: no column of time among {names[:300]}, expected "
            "one such as t or time"
        )
    result: dict[str, object] = {"time": _written(next(iter(clocked.values())))}
    many = len(sources) > 1
    ordered = sorted((sources[name] for name in clocked), key=_preference)
    quaternion = next((q for source in ordered if (q := _quaternion(source, many))), None)
    groups: Options = {}
    for option in NAMES:
        kind, _, dof = option.partition(".")
        if quaternion and kind == "position" and dof in DOFS[3:]:
            continue
        known = [source for source in ordered if _preference(source) <= len(PREFERRED)]
        column = next((c for source in known if (c := _named(source, option, many))), None)
        if column is not None:
            groups.setdefault(kind, {})[dof] = _written(column)
    if not (groups.get("force") or groups.get("inputs")):
        groups["inputs"] = _inputs(ordered, many)
    if quaternion:
        result["orientation"] = quaternion
    where = groups.pop("geodetic", {})
    if "surge" not in groups.get("position", {}) and {"latitude", "longitude"} <= set(where):
        result["geodetic"] = where
    return {**result, **groups}


def _inputs(sources: Sequence[Source], many: bool) -> dict[str, object]:
    """Columns that seem to act on the vessel, by their own names."""
    return {
        name: f"{source.name}:{name}" if many else name
        for source in sources
        for name in source.columns
        if re.fullmatch(INPUT, name, re.IGNORECASE) and _moves(source, name)
    }


def _preference(source: Source) -> int:
    """Rank of a source: states that were estimated stand before references and raw instruments."""
    name = source.name.lower()
    if re.search("ref|desired|setpoint|waypoint", name):
        return len(PREFERRED) + 1
    return next(i for i, word in enumerate(PREFERRED) if word in name)


def _time(source: Source) -> Column | None:
    """The column of time of a source, which must increase; its unit by the size of the steps."""
    for pattern in TIMES:
        for name in source.columns:
            if re.fullmatch(pattern, TIME_SUFFIX.sub("", name), re.IGNORECASE):
                column = Column(name)
                try:
                    steps = np.diff(seconds(source, column))
                except (RecordingError, ConfigurationError):
                    continue
                median = float(np.nanmedian(steps)) if len(steps) else 0.0
                if not median > 0.0:
                    continue
                dated = source.columns[name].dtype == np.object_
                if dated or name in source.units:
                    return column
                ending = TIME_SUFFIX.search(name)
                if ending and ending["unit"].lower() in UNIT_STEPS:
                    return Column(name, unit=ending["unit"].lower())
                unit = next((unit for unit, least in UNIT_STEPS.items() if median > least), None)
                return Column(name, unit=unit)
    return None


def _named(source: Source, option: str, many: bool) -> Column | None:
    """The first column of a source whose name is that of an option."""
    for pattern in NAMES[option]:
        for name in source.columns:
            bare = re.sub(SUFFIX, "", name, flags=re.IGNORECASE)
            known = any(re.fullmatch(pattern, one, re.IGNORECASE) for one in (name, bare))
            if known and _moves(source, name):
                full = f"{source.name}:{name}" if many else name
                return Column(full, unit=_unit(source, name, option))
    return None


def _moves(source: Source, name: str) -> bool:
    values = _numbers(source, name)
    known = np.empty(0) if values is None else values[~np.isnan(values)]
    return len(known) > 0 and bool(np.ptp(known) > 0.0)


def _unit(source: Source, name: str, option: str) -> str | None:
    """The unit that the name or the range tells, where the header has none."""
    if name in source.units:
        return None
    lower = name.lower()
    kind, _, dof = option.partition(".")
    if kind == "position" and dof in DOFS[3:]:
        return "deg" if lower.endswith("_deg") else None
    endings = ENDINGS.get(kind, {})
    return next((unit for end, unit in endings.items() if re.search(f"_({end})$", lower)), None)


def _quaternion(source: Source, many: bool) -> dict[str, str] | None:
    """Four columns that end in w, x, y, z, and are of length one together."""
    for name in source.columns:
        if not name.endswith("_w"):
            continue
        stem = name[:-1]
        parts = {part: f"{stem}{part}" for part in QUATERNION}
        values = [_numbers(source, column) for column in parts.values()]
        known = [v for v in values if v is not None]
        if len(known) != len(parts):
            continue
        if np.nanmax(np.abs(np.linalg.norm(np.array(known), axis=0) - 1.0)) < 0.05:
            full = f"{source.name}:" if many else ""
            return {part: f"{full}{column}" for part, column in parts.items()}
    return None


def _numbers(source: Source, name: str) -> Array | None:
    try:
        return source.numbers(name, gaps=True)
    except RecordingError:
        return None


def _written(column: Column) -> object:
    """A column as it is written in a map: its name, or its name and unit."""
    return column.column if column.unit is None else {"column": column.column, "unit": column.unit}
