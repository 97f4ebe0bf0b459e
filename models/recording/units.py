"""Units of recorded columns, and the factor that gives SI units and radians."""

from functools import lru_cache
from typing import TYPE_CHECKING

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATION_UNIT, FORCE_UNIT, POSE_UNIT, VELOCITY_UNIT

if TYPE_CHECKING:  # slow to import
    import pint
else:
    import lazy_loader

    pint = lazy_loader.load("pint")

SI = {
    "position": POSE_UNIT,
    "velocity": VELOCITY_UNIT,
    "acceleration": ACCELERATION_UNIT,
    "force": FORCE_UNIT,
    "actual_force": FORCE_UNIT,
    "wind": {"speed": "m/s", "direction": "rad"},
}
# As instruments write them, where pint means something else or nothing.
SPELLINGS = {
    "kn": "knot", "kt": "knot", "kts": "knot", "knots": "knot", "°": "deg", "°/s": "deg/s",
    "rps": "revolution/s", "1/s": "revolution/s", "Hz": "revolution/s", "degrees": "deg",
    "deg/sec": "deg/s", "m/sec": "m/s", "sec": "s", "Nm": "N*m", "kNm": "kN*m", "rad/s2": "rad/s^2",
    "m/s2": "m/s^2", "-": "",
}  # fmt: skip
TURNS = "revolution/s"  # in which the shaft speed of a vessel is given


@lru_cache(maxsize=256)
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


def input_factor(unit: str) -> float:
    """The factor of an input of a vessel: angles in rad, speeds of shafts in 1/s, others in SI."""
    name = SPELLINGS.get(unit, unit)
    for target in ("rad", TURNS, "N", "N*m", "m/s", ""):
        try:
            return factor(name, target)
        except ConfigurationError:
            continue
    raise ConfigurationError(
        f"unit: got {unit!r}, expected that of an angle, a shaft speed or a force, or a number"
    )


def froude_factor(unit: str, scale: float) -> float:
    """The factor of a quantity in `unit` of a ship that gives that of a model, by Froude's law.

    Lengths of the ship are `scale` times those of the model, times the root of it, and masses its
    cube: the same water is taken for both.
    """
    if scale == 1.0:
        return 1.0
    amount = _registry().parse_units(SPELLINGS.get(unit, unit)).dimensionality
    length, time, mass = (
        float(str(amount.get(f"[{name}]", 0))) for name in ("length", "time", "mass")
    )
    return float(scale ** -(length + 0.5 * time + 3.0 * mass))


def is_known(unit: str, target: str) -> bool:
    """Whether a unit, as written in a header, is one of the kind of `target`."""
    try:
        factor(unit, target)
    except ConfigurationError:
        return False
    return True


@lru_cache(maxsize=1)
def _registry() -> "pint.UnitRegistry[float]":
    return pint.UnitRegistry()
