"""Which quantity the title of a column names: `pose.pose.position.x`, `VN`, `yaw rate`.

A title is a kind (position, velocity, force ...), an axis (x, north, surge, roll, psi ...) and
words that say nothing, in any order. Where the kind is missing the axis tells it: `x` is a
position, `u` a velocity, `psi` an angle, `r` a rate.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, TypeVar

from seatrial.models.notation import DOFS
from seatrial.models.recording.column_map import TITLES, target_of, targets_of, words_of

Row = TypeVar("Row")


class Quantity(NamedTuple):
    """What a column is: an option of a map, its axes or reference, how many words are not known."""

    option: str  # such as velocity.surge; of inputs delta, n, or nothing where others have a name
    frame: str = ""  # body, earth, ENU, magnetic, true or apparent
    strange: int = 0
    commanded: bool = False


def _by_word(rows: Mapping[Row, str]) -> dict[str, Row]:
    return {word: row for row, words in rows.items() for word in words.split()}


KIND_OF = _by_word({
    "position": "position pos pose eta location coordinates", "dot": "dot",
    "velocity": "velocity vel velo speed spd twist nu geschwindigkeit vitesse fart",
    "linear": "linear uvw",
    "rate": "rate rates angular gyro gyr omega angvelo turn pqr",
    "angle": "angle angles ang attitude euler rpy rph", "moment": "torque moment",
    "force": "force forces wrench tau", "acceleration": "acceleration accelerations acc accel",
})  # fmt: skip
DEVICE_OF = _by_word({  # by inputs of a vessel: delta, n, and those of other names
    "delta": "rudder rsa delta helm ruder ruderwinkel barre ror rorvinkel",
    "n": "rpm rps shaft propeller prop engine revolutions revs drehzahl regime turtall",
    "": "thruster thrusters thrust thr pwm servo servos motor motors throttle esc azimuth rcou "
        "actuator actuators elevator fin fins nozzle jet tunnel steering drive",
})  # fmt: skip
WORDS = {name: frozenset(words.split()) for name, words in {
    "load": "torque moment power temperature current voltage fuel load rate dot",  # of a device
    "neutral": "estimated estimate est hat filtered filt smoothed measured meas mes actual true "
               "state states navigation nav ned enu body frame frd flu of vessel ship boat vehicle "
               "veh gps gnss ins imu ekf odom odometry value data mid world local inertial vector "
               "lmc over stamped xyz mid cg center centre signals values log",
    "foreign": "error err std stdev cov covariance variance var bias sigma accuracy quality innov "
               "innovation residual noise current currents wave waves temp temperature pressure "
               "voltage max min offset origin home orientation power dop hdop stamp count "
               "deviation variation",  # no motion of the vessel
    "reference": "ref reference desired des setpoint sp target goal waypoint guidance plan "
                 "controller",
    "command": "cmd command commanded commands order ordered",
    "estimate": "nav navigation odom odometry estimate estimated estimator local ahrs ekf nkf xkf",
    "raw": "imu gps gnss mag baro raw sensor fix compass dvl", "wind": "wind vent",
    "magnetic": "magnetic mag hdm compass", "earth": "ned enu earth world inertial",
    "direction": "direction dir angle", "course": "course track route",
    "ground": "ground grnd gnd sog fond", "satellite": "gps gnss rmc vtg",
    "apparent": "apparent relative rel angle", "water": "water log surface",
}.items()}  # fmt: skip
AXES = _by_word({
    ("space", 0): "x", ("space", 1): "y", ("space", 2): "z",
    ("rate", 0): "p", ("rate", 1): "q", ("rate", 2): "r",
    ("earth", 0): "north northing nord", ("earth", 1): "east easting ost",
    ("earth", 2): "down depth", ("body", 2): "heave w",
    ("body", 0): "surge u forward fwd ahead longitudinal longitudinale langsgeschwindigkeit",
    ("body", 1): "sway v vm starboard stbd abeam lateral transverse transversale "
                 "quergeschwindigkeit",
    ("angle", 0): "roll phi heel roulis gite", ("angle", 1): "pitch theta trim tangage",
    ("angle", 2): "yaw psi heading hdg hdt hdm head azimuth cap lacet kurswinkel steuerkurs",
})  # fmt: skip
LETTERS = {"n": ("earth", 0), "e": ("earth", 1), "d": ("earth", 2)}  # axes beside a kind only
MOMENTS = {"k": ("angle", 0), "m": ("angle", 1), "n": ("angle", 2)}  # the same of a force
ALONE = _by_word({
    Quantity("wind.speed", "true"): "tws", Quantity("wind.direction", "true"): "twd",
    Quantity("wind.speed", "apparent"): "aws", Quantity("wind.direction", "apparent"): "awa",
    Quantity("ground.speed"): "sog", Quantity("ground.course"): "cog course track gcrs mot",
    Quantity("water.speed"): "stw bsp", Quantity("velocity.yaw"): "rot drehrate gierrate",
    Quantity("geodetic.latitude"): "latitude lat", Quantity("geodetic.altitude"): "altitude alt",
    Quantity("geodetic.longitude"): "longitude lng lon long",
})  # fmt: skip
GLUED = (  # words that are written together
    r"(pos|vel|velo|acc|accel|gyr|gyro|force|torque|moment|tau|omega)([xyzned]|roll|pitch|yaw)",
    r"([vpfmwa])([xyz])|([vp])([ned])|(tau)([uvwpqr])",
    r"([xyzuvwpqr]|psi|phi|theta|yaw|roll|pitch|heading)(dot|rate|pos|vel|velo|speed|acc|angle)",
    r"(boat|wind|rudder|shaft|prop|thruster|servo|motor|engine)(speed|angle|direction|rpm|\d+)",
)
INTEGRALS = {"position": "velocity", "velocity": "position"}  # and the other way round
FIRST = {"v": "velocity", "p": "position", "f": "force", "m": "moment", "w": "omega", "a": "acc"}


def quantity(title: str, source: str = "", unit: str | None = None) -> Quantity | None:
    """The quantity that a title names in the source of some name; None: none that is known.

    The title may end in a unit. `unit` is that of the file: `heave` in m is a position.
    """
    words, around, results = words_of(title), set(words_of(source)), list[Quantity]()
    if any(word.isdigit() for word in words):  # of several thrusters, not of the vessel
        words = ["thruster" if word == "azimuth" else word for word in words]
    while len(words) > 1 and words[-1].isdigit():  # of several devices
        words.pop()
    for end in range(len(words), max(len(words) - 4, 0), -1):
        units = TITLES.get("_".join(words[end:]), [])
        result = _matched(list(_split(words[:end])), around) if units or end == len(words) else None
        if result is None:
            continue
        fitting = [u for u in units if target_of(u, targets_of(result.option))]
        stated = [unit] if unit else fitting or units
        if stated and target_of(stated[0], stated):  # perhaps of its rate or integral
            kind, _, name = result.option.partition(".")
            options = (result.option, f"{INTEGRALS.get(kind, kind)}.{name}")
            known = (o for o in options if target_of(stated[0], targets_of(o)) is not None)
            result = result._replace(option=next(known, ""))
        results += [result] if result.option else []
    return min(results, key=lambda result: result.strange, default=None)


def _split(words: Sequence[str]) -> Iterator[str]:
    """The words, those that are written together apart; a letter before an axis is its kind."""
    if len(words) > 1 and words[0] in ("m", "c", "sci") and (len(words[1]) > 1 or len(words) > 2):
        words = ["cmd" if words[0] == "c" else "data", *words[1:]]  # as gliders write it
    for word, after in zip(words, [*words[1:], ""], strict=True):
        forms = () if word in KIND_OF or word in DEVICE_OF else GLUED
        match = next((m for form in forms if (m := re.fullmatch(form, word))), None)
        parts = [part for part in match.groups() if part] if match else [word]
        if len(parts) > 1 or after in (*LETTERS, "x", "y", "z", "north", "east", "down"):
            parts[0] = FIRST.get(parts[0], parts[0])
        yield from parts


def _matched(words: Sequence[str], around: set[str]) -> Quantity | None:
    """The quantity of words in a source that is called `around`: a device, by name, by its axis."""
    core = [word for word in words if word not in WORDS["neutral"] and not word.isdigit()]
    known, everything = set(words), set(words) | around
    ordered = bool(everything & (WORDS["command"] | WORDS["reference"]))
    angled = any(AXES.get(word, ("",))[0] == "angle" for word in core)
    if not words or known & WORDS["foreign"] - ({"orientation"} if angled else set()):
        return None
    kinds = {KIND_OF[word] for word in core if word in KIND_OF}
    if not kinds and {AXES[word][0] for word in core if word in AXES} == {"space"}:
        kinds = {KIND_OF[word] for word in around if word in KIND_OF}  # angular_velocity: x
    letters = MOMENTS if kinds & {"force", "moment"} else LETTERS if kinds else {}
    axes = [word for word in core if word in AXES] or [word for word in core if word in letters]
    bare = (word.rstrip("0123456789") for word in core)
    devices = {DEVICE_OF[word] for word in bare if word in DEVICE_OF}
    devices |= {"n"} if core == ["n"] else set()
    if not devices and not axes:
        devices = {DEVICE_OF[word] for word in around if word in DEVICE_OF}
        devices |= {""} if "force" in kinds and len(core) > 1 else set()
    change = "delta" in core and (kinds - {"angle"} or {*axes} & {"x", "y", "z"})
    if devices and not (change or core == ["azimuth"] or everything & WORDS["wind"]):
        device = max(devices)  # a shaft rather than a rudder, and that than others
        result = Quantity(f"inputs.{device}", "", max(len(core) - 1, 0), ordered)
        return None if everything & WORDS["load"] else result
    if not ordered and (named := _named(core, known, everything)):
        return named if named.option else None
    kind, i = AXES.get(axes[0]) or letters[axes[0]] if len(axes) == 1 else ("", 0)
    option, magnetic = _option(kinds, kind, i), bool(everything & WORDS["magnetic"])
    if (magnetic and option != "position.yaw") or (ordered and not option.startswith("force")):
        return None
    frame = kind if kind in ("body", "earth") else ""
    if option.startswith("position"):
        frame = "magnetic" if magnetic else "ENU" if "enu" in everything and kind == "space" else ""
    elif option.startswith("velocity") and ("dot" in kinds or everything & WORDS["earth"]):
        frame = frame or "earth"
    strange = sum(w not in KIND_OF and w not in axes and w not in WORDS["magnetic"] for w in core)
    if not option or (strange and not kinds and kind == "space"):  # `VibeX` is no position
        return None
    return Quantity(option, frame, strange, ordered)


def _named(core: Sequence[str], known: set[str], everything: set[str]) -> Quantity | None:
    """Wind, speeds over ground and through the water, latitude and longitude, rate of turn."""
    speeds = {word for word in known if KIND_OF.get(word) == "velocity"}
    speed, single = bool(speeds), len(core) == 1
    course = known & WORDS["course"] or any(AXES.get(word) == ("angle", 2) for word in core)
    if everything & WORDS["wind"]:
        speed = speed or "force" in known
        clear = speed or (known & WORDS["direction"] and not {"true", "angle"} <= known)
        frame = "apparent" if everything & WORDS["apparent"] and "earth" not in known else "true"
        return Quantity(f"wind.{'speed' if speed else 'direction'}" if clear else "", frame)
    if known & WORDS["ground"] or (speed and single and everything & WORDS["satellite"]):
        rest = set(core) - WORDS["ground"] - speeds - WORDS["course"] - set(AXES)
        return Quantity(f"ground.{'course' if course else 'speed'}", "", len(rest))
    water = known & WORDS["water"] or ("boat" in known and single)
    if speed and (water or single):
        return Quantity("water.speed" if water else "speed")
    if {"rate", "turn"} <= known:
        return Quantity("velocity.yaw")
    alone = None if known & WORDS["magnetic"] else next((w for w in core if w in ALONE), None)
    return ALONE[alone]._replace(strange=len(core) - 1) if alone else None


def _option(kinds: set[str], kind: str, i: int) -> str:
    """The option of a map by the kinds that a title states and that of its axis; "": none."""
    about, dof = DOFS[i + 3], DOFS[i + 3 if kind in ("angle", "rate") else i]
    if not kind:
        return ""
    if kinds & {"force", "moment"}:
        return f"force.{about if 'moment' in kinds else dof}"
    if "acceleration" in kinds or ("dot" in kinds and kind in ("body", "rate")):
        return "" if kind in ("space", "earth") else f"acceleration.{dof}"
    if ("rate" in kinds or {"angle", "velocity"} <= kinds) and "linear" not in kinds:
        return "" if kind in ("body", "earth") else f"velocity.{about}"
    if kinds & {"velocity", "dot", "linear"} or (kind in ("body", "rate") and not kinds):
        return f"velocity.{dof}"
    return "" if kind == "rate" else f"position.{about if 'angle' in kinds else dof}"
