"""Terms in which a vessel is identified from its inputs, after Abkowitz (1964).

A coefficient table about a straight course expands every product of sway velocity, yaw rate and
rudder angle in the change of the speed, u and U. Trials about one speed do not tell these apart.
The forces on the hull are quadratic in the speed, as in the prime system: uv, v^3/U. Those of a
rudder in the slipstream, delta and udelta, hardly fall with the speed of the ship while the shaft
turns at the same rate, and what changes along a straight course is written by 1, u and u^2.
"""

from collections.abc import Sequence

from seatrial.models.notation import VELOCITIES
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import N_VARIABLES, VARIABLES, Term

NEEDED = {"surge", "sway", "yaw"}
STRAIGHT = ("1", "u", "u^2")
HULL = ("uv", "ur", "v^2", "vr", "r^2", "v^3/U", "v^2r/U", "vr^2/U", "r^3/U")
ROLL = ("up", "u^2phi", "vphi", "v^2phi")
RUDDER = ("{}", "u{}", "{}^2", "{}^3", "v{}", "r{}")
SHAFT = ("{}^2", "u{}")
SPEEDS = ("u", *basis.SPEED)
MOST = 2  # powers of the speed with which a product is kept


def manoeuvring_basis(accelerations: Sequence[str], inputs: Sequence[str]) -> tuple[Term, ...]:
    """Accelerations, straight motion, hull, rudders `delta` and shafts `n`.

    `accelerations` are those of the vessel, which moves in surge, sway and yaw at least.
    """
    texts = [*accelerations, *STRAIGHT]
    texts += [each.format(name) for name in inputs if name[0] == "n" for each in SHAFT]
    texts += [*HULL, *(ROLL if "p_dot" in accelerations else ())]
    texts += [each.format(name) for name in inputs if name.startswith("delta") for each in RUDDER]
    return basis.terms(texts)


def each_product_once(terms: Sequence[Term]) -> tuple[Term, ...]:
    """The terms of a table, with fewer for a product that it has with many powers of the speed.

    These are two for products of rudder angles, one for others, and three for straight motion.
    """
    groups: dict[tuple[int, ...], list[Term]] = {}
    for term in terms:
        groups.setdefault(_without_speed(term), []).append(term)
    kept: list[Term] = []
    for own, members in groups.items():
        fewer = _fewer(own)
        kept += members if len(members) <= max(len(fewer), MOST) else fewer
    return tuple(dict.fromkeys(kept))


def _without_speed(term: Term) -> tuple[int, ...]:
    """The codes of the factors other than u, U and 1/U."""
    return tuple(
        code for code in term.codes if code and VARIABLES[code % N_VARIABLES] not in SPEEDS
    )


def _fewer(own: tuple[int, ...]) -> tuple[Term, ...]:
    """The terms in which a product is written, by the codes of its factors other than speed."""
    if not own:
        return basis.terms(STRAIGHT)
    product = basis.Term((0,) * (basis.FACTORS - len(own)) + own).name
    count = sum(VARIABLES[code % N_VARIABLES] in VELOCITIES for code in own)
    if count == 0:
        return basis.terms([product, f"u{product}"])
    return basis.terms([("u" if count == 1 else "") + product + "/U" * (count - 2)])
