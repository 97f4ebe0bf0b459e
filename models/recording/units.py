"""Units of recorded columns: as a map, a file or a title states them, and their factor to SI."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATION_UNIT, FORCE_UNIT, POSE_UNIT, VELOCITY_UNIT

if TYPE_CHECKING:  # slow to import
    import pint
else:
    import lazy_loader

    pint = lazy_loader.load("pint")

TURNS = "revolution/s"  # in which the shaft speed of a vessel is given
INPUTS = ("rad", TURNS, "N", "N*m", "m/s", "")  # of the inputs of a vessel
OWN = {"inputs": INPUTS, "commands": INPUTS, "loads": ("N",)}  # kinds with names of the user
SI = {
    "position": POSE_UNIT, "velocity": VELOCITY_UNIT, "acceleration": ACCELERATION_UNIT,
    "force": FORCE_UNIT, "actual_force": FORCE_UNIT, "wind": {"speed": "m/s", "direction": "rad"},
    "ground": {"speed": "m/s", "course": "rad"}, "water": {"speed": "m/s"},
    "current": {"north": "m/s", "east": "m/s"}, "air": {"surge": "m/s", "sway": "m/s"},
    "geodetic": {"latitude": "deg", "longitude": "deg", "altitude": "m"},
}  # fmt: skip
BEARINGS = tuple(f"{kind}.{name}" for kind in ("position", "ground", "wind")
                 for name, unit in SI[kind].items() if unit == "rad")  # fmt: skip
# As instruments write them, where pint means something else or nothing.
SPELLINGS = {
    "kn": "knot", "kt": "knot", "kts": "knot", "knots": "knot", "°": "deg", "°/s": "deg/s",
    "rps": TURNS, "1/s": TURNS, "Hz": TURNS, "degrees": "deg", "deg/sec": "deg/s",
    "m/sec": "m/s", "sec": "s", "Nm": "N*m", "kNm": "kN*m", "rad/s2": "rad/s^2", "m/s2": "m/s^2",
    "-": "", "RPM": "rpm", "Deg": "deg", "Degrees": "deg", "Radians": "rad", "%": "percent",
    "°/min": "deg/min", "meters": "m", "metres": "m", "epoch": "s", "timestamp": "s",
    "decimal degrees": "deg", "1/min": "rpm", "U/min": "rpm", "tr/min": "rpm", "min-1": "rpm",
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


@lru_cache(maxsize=512)
def factor(unit: str, target: str) -> float:
    """The factor on a number in `unit` that gives it in `target`; raises ConfigurationError."""
    target = SPELLINGS.get(target, target)
    try:
        amount = _registry().parse_expression(SPELLINGS.get(unit, unit))
        quantity = amount if hasattr(amount, "to") else amount * _registry().dimensionless
        return float(quantity.to(target).magnitude)
    except Exception as error:  # of many kinds: pint evaluates an expression
        raise ConfigurationError(
            f"unit: got {unit!r}, expected a unit of the kind of {target or 'a number'}"
        ) from error


def target_of(unit: str, targets: Sequence[str]) -> str | None:
    """The first of some units of which `unit` is a kind; None: of none."""
    for target in targets:
        try:
            factor(unit, target)
        except ConfigurationError:
            continue
        return target
    return None


def si_factor(option: str, unit: str) -> float:
    """The factor on an option such as `velocity.surge` in some unit that gives it in SI units.

    Angles are in rad, speeds of shafts in 1/s. Raises ConfigurationError.
    """
    targets = targets_of(option)
    if not (targets and unit):
        return 1.0
    if (target := target_of(unit, targets)) is None:
        kinds = " or ".join(target or "a number" for target in targets)
        raise ConfigurationError(f"unit: got {unit!r}, expected a unit of the kind of {kinds}")
    return factor(unit, target)


def words_of(title: str) -> list[str]:
    """The words of a title in lower case: `TimeUS` is time, us; `yaw_rate (deg/s)` four of them."""
    letters = unicodedata.normalize("NFKD", title.translate({216: "O", 248: "o"}))
    plain = "".join(letter for letter in letters if not unicodedata.combining(letter))
    return [word.lower() for word in WORDS.split(plain) if word]


def unit_in_title(title: str, targets: Sequence[str]) -> str | None:
    """The unit that the last words of a title spell, if it is of the kind of one of `targets`."""
    words = words_of(re.sub(r"\W*_\d+$", "", title))  # without the number of a device
    for count in (3, 2, 1):
        for unit in TITLES.get("_".join(words[-count:]), ()) if len(words) > count else ():
            if target_of(unit, targets) is not None:
                return unit
    if TURNS in targets:
        bare = (word.rstrip("0123456789") for word in words)
        return next((SHAFTS[word] for word in bare if word in SHAFTS), None)
    return None


def targets_of(option: str) -> tuple[str, ...]:
    """The units in which an option such as `velocity.surge` is kept, any of which may be meant."""
    kind, _, name = option.partition(".")
    return OWN.get(kind) or ((SI[kind][name],) if kind in SI else ())


@lru_cache(maxsize=1)
def _registry() -> "pint.UnitRegistry[float]":
    return pint.UnitRegistry()
