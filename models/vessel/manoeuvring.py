"""Terms in which a vessel is identified from its inputs, after Abkowitz (1964).

A coefficient table about a straight course expands every product of sway velocity, yaw rate and
rudder angle in the change of the speed, u and U. Trials about one speed do not tell these apart:
of each product one is kept, with the factor of speed that makes it quadratic, uv or u^2delta as in
the prime system. What changes along a straight course is written by 1, u and u^2.
"""

from collections.abc import Sequence

from seatrial.models.notation import ACCELERATIONS, VELOCITIES
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import N_VARIABLES, VARIABLES, Term

NEEDED = {"surge", "sway", "yaw"}
STRAIGHT = ("1", "u", "u^2")
HULL = ("uv", "ur", "v^2", "vr", "r^2", "v^3/U", "v^2r/U", "vr^2/U", "r^3/U")
ROLL = ("up", "u^2phi", "vphi", "v^2phi")
RUDDER = ("u^2{}", "u^2{}^2", "u^2{}^3", "uv{}", "ur{}", "uv{}^2", "ur{}^2", "v^2{}", "r^2{}")
SHAFT = ("{}^2", "u{}")
SPEEDS = ("u", *basis.SPEED)
POWERS = ("u^2", "u", "", "/U", "/U^2")  # of the speed, by the number of velocities


def manoeuvring_basis(accelerations: Sequence[str], inputs: Sequence[str]) -> tuple[Term, ...]:
    """Accelerations, straight motion, hull, rudders `delta` and shafts `n`: 23 terms for a rudder.

    `accelerations` are those of the vessel, which moves in surge, sway and yaw at least.
    """
    texts = [*accelerations, *STRAIGHT]
    texts += [each.format(name) for name in inputs if name[0] == "n" for each in SHAFT]
    texts += [*HULL, *(ROLL if "p_dot" in accelerations else ())]
    texts += [each.format(name) for name in inputs if name.startswith("delta") for each in RUDDER]
    return basis.terms(texts)


def each_product_once(terms: Sequence[Term]) -> tuple[Term, ...]:
    """The accelerations of a table, 1, u, u^2 for its straight motion, and other products once."""
    kept = [term for term in terms if term.name in ACCELERATIONS]
    products = [_per_speed(term) for term in terms if term not in kept]
    if basis.term("u^2") in products:
        kept += basis.terms(STRAIGHT)
    return tuple(dict.fromkeys([*kept, *products]))


def _per_speed(term: Term) -> Term:
    """A term with the factors of speed replaced by those that make it quadratic in the speed.

    A term of the speed alone becomes u^2.
    """
    own = [code for code in term.codes if VARIABLES[code % N_VARIABLES] not in SPEEDS and code]
    spelled = basis.Term((0,) * (basis.FACTORS - len(own)) + tuple(own)).name if own else ""
    count = sum(VARIABLES[code % N_VARIABLES] in VELOCITIES for code in own)
    return basis.term(spelled + POWERS[count] if count > 2 else POWERS[count] + spelled)
