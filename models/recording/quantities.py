"""Which quantity the title of a column names: `pose.pose.position.x`, `VN`, `yaw rate`.

A title is a kind (position, velocity, force ...), an axis (x, north, surge, roll, psi ...) and
words that say nothing, in any order. Where the kind is missing the axis tells it: `x` is a
position, `u` a velocity, `psi` an angle, `r` a rate.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from seatrial.models.notation import DOFS
from seatrial.models.recording.units import TITLES, is_known, targets_of, words_of


class Quantity(NamedTuple):
    """What a column is: an option of a map, its axes or reference, how many words are not known."""

    option: str  # such as velocity.surge; of inputs delta, n, or nothing where others have a name
    frame: str = ""  # body, earth, ENU, magnetic, true or apparent
    strange: int = 0
    commanded: bool = False


def _words(words: str) -> set[str]:
    return set(words.split())


def _table(rows: Mapping[str, str]) -> dict[str, str]:
    return {word: kind for kind, words in rows.items() for word in words.split()}


KINDS = _table({
    "position": "position pos pose eta location coordinates", "dot": "dot",
    "velocity": "velocity vel velo speed spd twist nu", "linear": "linear uvw",
    "rate": "rate rates angular gyro gyr omega angvelo turn pqr",
    "angle": "angle angles attitude euler rpy rph", "moment": "torque moment",
    "force": "force forces wrench tau", "acceleration": "acceleration accelerations acc accel",
})  # fmt: skip
AXES = {
    word: (kind, i)
    for kind, axes in {
        "space": ("x", "y", "z"),
        "earth": ("north northing", "east easting", "down depth"),
        "body": ("surge u forward fwd ahead longitudinal",
                 "sway v vm starboard stbd abeam lateral transverse", "heave w"),
        "angle": ("roll phi heel", "pitch theta trim", "yaw psi heading hdg hdt hdm"),
        "rate": ("p", "q", "r"),
    }.items()
    for i, words in enumerate(axes)
    for word in words.split()
}  # fmt: skip
LETTERS = {"n": ("earth", 0), "e": ("earth", 1), "d": ("earth", 2)}  # axes beside a kind only
MOMENTS = {"k": ("angle", 0), "m": ("angle", 1), "n": ("angle", 2)}  # the same of a force
NEUTRAL = _words(
    "estimated estimate est hat filtered filt smoothed measured meas mes actual true state states "
    "navigation nav ned enu body frame frd flu of vessel ship boat vehicle gps gnss ins imu ekf "
    "odom odometry value data mid world local inertial vector lmc over stamped xyz"
)
FOREIGN = _words(  # what is not measured of the motion of the vessel
    "error err std stdev cov covariance variance var bias sigma accuracy quality innov innovation "
    "residual noise current currents wave waves temp temperature pressure voltage max min offset "
    "origin home orientation power dop hdop stamp count deviation variation"
)
REFERENCES = _words("ref reference desired des setpoint sp target goal waypoint guidance plan")
COMMANDS = _words("cmd command commanded commands order ordered")
MAGNETIC, EARTH = _words("magnetic mag hdm compass"), _words("ned enu earth world inertial")
GROUND, APPARENT = _words("ground grnd gnd sog"), _words("apparent relative rel angle")
ESTIMATES = _words("nav navigation odom odometry estimate estimated estimator local ahrs")
RAW = _words("imu gps gnss mag baro raw sensor fix compass dvl")
SPEEDS = _words("speed spd velocity vel velo")
WHOLE = {
    "tws": ("wind.speed", "true"), "twd": ("wind.direction", "true"),
    "aws": ("wind.speed", "apparent"), "awa": ("wind.direction", "apparent"),
    "sog": ("ground.speed", ""), "stw": ("water.speed", ""), "bsp": ("water.speed", ""),
    **dict.fromkeys(("cog", "course", "track", "gcrs"), ("ground.course", "")),
    **dict.fromkeys(("latitude", "lat"), ("geodetic.latitude", "")),
    **dict.fromkeys(("longitude", "lng", "lon", "long"), ("geodetic.longitude", "")),
    **dict.fromkeys(("altitude", "alt"), ("geodetic.altitude", "")), "rot": ("velocity.yaw", ""),
}  # fmt: skip
INPUTS = _table({
    "delta": "rudder delta helm", "n": "rpm rps shaft propeller prop engine revolutions revs",
    "": "thruster thrusters thrust thr pwm servo servos motor motors throttle esc azimuth rcou "
        "actuator actuators elevator fin fins nozzle jet tunnel steering drive",
})  # fmt: skip
LOADS = _words("torque moment power temperature current voltage fuel load rate dot")
GLUED = (  # words that are written together
    r"(pos|vel|velo|acc|accel|gyr|gyro|force|torque|moment|tau|omega)([xyzned]|roll|pitch|yaw)",
    r"([vpfmwa])([xyz])|([vp])([ned])|(tau)([uvwpqr])",
    r"([xyzuvwpqr]|psi|phi|theta|yaw|roll|pitch|heading)(dot|rate|pos|vel|velo|speed|acc|angle)",
    r"(boat|wind|rudder|shaft|prop|thruster|servo|motor|engine)(speed|angle|direction|rpm|\d+)",
)
FIRST = {"v": "velocity", "p": "position", "f": "force", "m": "moment", "w": "omega", "a": "acc"}


def quantity(title: str, source: str = "", unit: str | None = None) -> Quantity | None:
    """The quantity that a title names; None: none that is known.

    Args:
        title: the title of a column, with or without a unit at its end
        source: the name of the table or topic that it is in
        unit: the unit by the metadata of the file: `heave` in m is a position
    """
    words, around, result = words_of(title), set(words_of(source)), None
    while len(words) > 1 and words[-1].isdigit():  # of several devices
        words = words[:-1]
    for count in range(min(4, max(len(words), 1))):
        ending = "_".join(words[len(words) - count :])
        if ending in TITLES or not count:
            found = _of_words(list(_split(words[: len(words) - count])), around)
            found = _with_unit(found, unit or next(iter(TITLES.get(ending, ())), None))
            if found and (result is None or found.strange < result.strange):
                result = found
    return result


def _split(words: Sequence[str]) -> Iterator[str]:
    """The words, those that are written together apart; a letter before an axis is its kind."""
    if len(words) > 1 and words[0] in ("m", "c", "sci") and (len(words[1]) > 1 or len(words) > 2):
        words = ["cmd" if words[0] == "c" else "data", *words[1:]]  # as gliders write it
    for word, after in zip(words, [*words[1:], ""], strict=True):
        forms = () if word in KINDS or word in INPUTS else GLUED
        match = next((m for form in forms if (m := re.fullmatch(form, word))), None)
        parts = [part for part in match.groups() if part] if match else [word]
        if len(parts) > 1 or after in (*LETTERS, "x", "y", "z", "north", "east", "down"):
            parts[0] = FIRST.get(parts[0], parts[0])
        yield from parts


def _of_words(words: Sequence[str], around: set[str]) -> Quantity | None:
    known, everything = set(words), set(words) | around
    core = [word for word in words if word not in NEUTRAL and not word.isdigit()]
    ordered = bool(everything & (COMMANDS | REFERENCES))
    if known & FOREIGN or not words:
        return None
    named = {INPUTS[w.rstrip("0123456789")] for w in core if w.rstrip("0123456789") in INPUTS}
    if core == ["n"]:
        named = {"n"}
    kinds = {KINDS[word] for word in core if word in KINDS}
    if not kinds and {AXES[word][0] for word in core if word in AXES} == {"space"}:
        kinds = {KINDS[word] for word in around if word in KINDS}  # angular_velocity: x
    letters = MOMENTS if kinds & {"force", "moment"} else LETTERS if kinds else {}
    axes = [word for word in core if word in AXES] or [word for word in core if word in letters]
    if not named and not axes:
        named = {INPUTS[word] for word in around if word in INPUTS}
        named |= {""} if "force" in kinds and len(core) > 1 else set()
    if named:
        strange = max(len(core) - 1, 0)
        return (
            None if everything & LOADS else Quantity(f"inputs.{max(named)}", "", strange, ordered)
        )
    if not ordered and (special := _special(core, known, everything)):
        return special if special.option else None
    if len(axes) != 1:
        return None
    kind, i = AXES.get(axes[0]) or letters[axes[0]]
    option = _option(kinds, kind, i)
    magnetic = bool(everything & MAGNETIC)
    if not option or (magnetic and option != "position.yaw"):
        return None
    if ordered and not option.startswith("force"):
        return None
    frame = kind if kind in ("body", "earth") else ""
    if option.startswith("velocity") and not frame and ("dot" in kinds or everything & EARTH):
        frame = "earth"
    if option.startswith("position"):
        frame = "magnetic" if magnetic else "ENU" if "enu" in everything and kind == "space" else ""
    strange = sum(w not in KINDS and w not in axes and w not in MAGNETIC for w in core)
    return Quantity(option, frame, strange, ordered)


def _special(core: Sequence[str], known: set[str], everything: set[str]) -> Quantity | None:
    """Wind, speeds over ground and through the water, latitude and longitude, rate of turn."""
    speed = bool(known & SPEEDS)
    if "wind" in everything:
        if not (speed or known & {"direction", "dir", "angle"}) or {"true", "angle"} <= known:
            return Quantity("")
        frame = "apparent" if everything & APPARENT else "true"
        return Quantity(f"wind.{'speed' if speed else 'direction'}", frame)
    if known & GROUND or (speed and len(core) == 1 and everything & {"gps", "gnss", "rmc", "vtg"}):
        option = "ground.course" if known & {"course", "track"} else "ground.speed"
        return Quantity(option, "", len(set(core) - GROUND - SPEEDS - {"course", "track"}))
    if speed and (known & {"water", "log"} or ("boat" in known and len(core) == 1)):
        return Quantity("water.speed")
    if {"rate", "turn"} <= known:
        return Quantity("velocity.yaw")
    whole = next((WHOLE[word] for word in core if word in WHOLE), None)
    return Quantity(*whole, len(core) - 1) if whole and not known & MAGNETIC else None


def _option(kinds: set[str], kind: str, i: int) -> str | None:
    """The option of a map by the kinds that a title states and the kind of its axis."""
    turning = kind in ("angle", "rate")
    dof = DOFS[i + 3 if turning else i]
    if kinds & {"force", "moment"}:
        return f"force.{DOFS[i + 3] if 'moment' in kinds else dof}"
    if "acceleration" in kinds or ("dot" in kinds and kind in ("body", "rate")):
        return None if kind in ("space", "earth") else f"acceleration.{dof}"
    if "rate" in kinds and "linear" not in kinds:
        return None if kind in ("body", "earth") else f"velocity.{DOFS[i + 3]}"
    if kinds & {"velocity", "dot", "linear"} or (kind in ("body", "rate") and not kinds):
        return f"velocity.{dof}"
    return None if kind == "rate" else f"position.{DOFS[i + 3] if 'angle' in kinds else dof}"


def _with_unit(found: Quantity | None, unit: str | None) -> Quantity | None:
    """A quantity that may be in a unit, or its rate or integral that may; None: neither."""
    if found is None or unit is None or not is_known(unit, unit):
        return found
    kind, _, name = found.option.partition(".")
    swapped = {"position": "velocity", "velocity": "position"}.get(kind, kind)
    for option in (found.option, f"{swapped}.{name}"):
        if any(is_known(unit, target) for target in targets_of(option)):
            return found._replace(option=option)
    return None
