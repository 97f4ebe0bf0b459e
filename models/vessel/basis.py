"""Named basis functions of the motion, their parser and the compiled kernel.

Every term is a product of up to six factors out of 1, x_i and |x_i|, where x is the vector of
*variables* below: accelerations, velocities, attitude, the motion through the air, the speed and
the inputs of a steered vessel. Terms are written as in the literature:

    1   u_dot   u   |u|u   u^3   |u|   u^2   vr   |r|v   |u||v|   cos(psi)   sin(theta)   V_qu_q
    u^2delta   v^3/U   v^4/U^2   |n|n   vphi^2

`u`, `v`, ... are velocities through the water, which equal those over ground if there is no
current; `u_q` and `v_q` are the velocities through the air in body axes (nu_q = nu - nu_w of
Ljungberg) and `V_q` is their norm, the relative wind speed. `U` is the speed through the water,
sqrt(u^2 + v^2 + w^2); `/U` and `/U^2` divide by it and are zero at rest. `beta` is the sideslip
angle atan2(v, u) [rad]. `phi` and `theta` are angles [rad]. The inputs are what is commanded on
board: `delta` a rudder or fin angle, `alpha` an azimuth angle [rad], `n` a shaft speed [1/s], `pwm`
a signal between -1 and 1.

With z = [x, |x|] and the codes (a, b, ...) of a term, phi = z_a z_b .... The kernel evaluates the
codes; two spellings of one function (`v|r|` and `|r|v`, `rrr` and `r^3`) have the same codes.

The terms in which a vessel is identified from its inputs are those of Abkowitz (1964). A
coefficient table about a straight course expands every product of sway velocity, yaw rate and
rudder angle in the change of the speed, u and U. Trials about one speed do not tell these apart.
The forces on the hull are quadratic in the speed, as in the prime system: uv, v^3/U. Those of a
rudder in the slipstream, delta and udelta, hardly fall with the speed of the ship while the shaft
turns at the same rate, and what changes along a straight course is written by 1, u and u^2.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS, DOFS, POSES, VELOCITIES

Array = NDArray[np.float64]
Codes = NDArray[np.int64]
ATTITUDE = tuple(f"{f}({angle})" for angle in POSES[3:] for f in ("cos", "sin"))
AIR = ("V_q", "u_q", "v_q")
ANGLES = ("phi", "theta")
SPEED = ("U", "1/U", "1/U^2")
INPUTS = (
    "delta", "delta_r", "delta_s", "n", "n_1", "n_2", "n_3", "n_4",
    "alpha_1", "alpha_2", "alpha_3", "alpha_4", "pwm_1", "pwm_2", "pwm_3", "pwm_4",
)  # fmt: skip
SIDESLIP = "beta"
VARIABLES = (
    "1", *ACCELERATIONS, *VELOCITIES, *ATTITUDE, *AIR, *ANGLES, *SPEED, SIDESLIP, *INPUTS,
)  # fmt: skip
N_VARIABLES = len(VARIABLES)
REST_M_S = 1e-9  # a lower speed is rest
INDEX = {name: i for i, name in enumerate(VARIABLES)}
_ATTITUDE, _LINEAR, _THROUGH, _ANGLES = (
    slice(INDEX[names[0]], INDEX[names[0]] + len(names))
    for names in (ATTITUDE, VELOCITIES[:3], AIR[1:], ANGLES)
)
FACTORS = 6
FEWEST_FACTORS = 3  # columns of the codes, whatever the terms
_NAMES = "|".join(
    re.escape(v) for v in sorted(VARIABLES[1:], key=len, reverse=True) if "/" not in v
)
_FACTOR = re.compile(rf"\|(?P<abs>{_NAMES})\||(?P<var>{_NAMES})|1?(?P<over>/U)")
_POWER = re.compile(r"\^([123456])")


@dataclass(frozen=True, order=True)
class Term:
    """One basis function: the sorted codes of its factors, led by those of the constant 1 (0)."""

    codes: tuple[int, ...]

    @cached_property
    def name(self) -> str:
        """The canonical spelling: magnitudes first, powers as `u^2`; `1` for the constant."""
        return _spell(self.codes)

    @property
    def order(self) -> int:
        """Number of variables multiplied together, beta of Jervan (2020), eq. (4.8)."""
        return sum(code > 0 for code in self.codes)

    def __str__(self) -> str:
        return self.name


@lru_cache(maxsize=1024)
def term(text: str) -> Term:
    """Parse a term; raises ConfigurationError that names the unknown part."""
    codes: list[int] = []
    rest = text.replace(" ", "").replace("*", "")
    while rest and rest != "1":
        match = _FACTOR.match(rest)
        if match is None:
            raise ConfigurationError(
                f"term {text!r}: got {rest!r}, expected factors from {', '.join(VARIABLES)}"
            )
        rest = rest[match.end() :]
        power = _POWER.match(rest)
        rest = rest[power.end() :] if power else rest
        name = match["abs"] or match["var"] or "1/U"
        code = INDEX[name] + (N_VARIABLES if match["abs"] else 0)
        codes += [code] * (int(power[1]) if power else 1)
    factors = _canonical(codes)
    if len(factors) > FACTORS or not text:
        raise ConfigurationError(
            f"term {text!r}: got {len(factors)} factors, expected 1 to {FACTORS}"
        )
    return Term((0,) * (FACTORS - len(factors)) + factors)


def terms(texts: Iterable[str]) -> tuple[Term, ...]:
    """Parse several terms; raises ConfigurationError if a term is repeated."""
    parsed = tuple(term(text) for text in texts)
    for i, parsed_term in enumerate(parsed):
        if parsed_term in parsed[:i]:
            raise ConfigurationError(f"term {parsed_term} is given twice, expected it once")
    return parsed


def _canonical(codes: Sequence[int]) -> tuple[int, ...]:
    """Sorted codes in which |x||x| is written x x.

    The speed is not negative, so |U| is written U; U and 1/U cancel.
    """
    plain = [code - N_VARIABLES if code - N_VARIABLES == INDEX["U"] else code for code in codes]
    for variable in {code - N_VARIABLES for code in plain if code >= N_VARIABLES}:
        _replace_pairs(plain, (variable + N_VARIABLES,) * 2, [variable, variable])
    _replace_pairs(plain, (INDEX["U"], INDEX["1/U"]), [])
    _replace_pairs(plain, (INDEX["1/U"], INDEX["1/U"]), [INDEX["1/U^2"]])
    return tuple(sorted(plain))


def _replace_pairs(codes: list[int], pair: tuple[int, int], by: list[int]) -> None:
    """Replace every pair of factors by others."""
    first, second = pair
    count = codes.count(first) // 2 if first == second else min(map(codes.count, pair))
    for _ in range(count):
        codes.remove(first)
        codes.remove(second)
        codes += by


def _spell(codes: Sequence[int]) -> str:
    signed = [VARIABLES[c] for c in codes if 0 < c < N_VARIABLES]
    magnitudes = [VARIABLES[c - N_VARIABLES] for c in codes if c >= N_VARIABLES]
    parts = [f"|{name}|" for name in magnitudes]
    over = "".join(name[1:] for name in signed if name in SPEED[1:])
    for name in dict.fromkeys(name for name in signed if name not in SPEED[1:]):
        power = signed.count(name)
        parts.append(name if power == 1 else f"{name}^{power}")
    return ("".join(parts) or "1") + over


def codes(basis: Sequence[Term]) -> Codes:
    """Integer codes of a list of terms, shape (n_terms, 3), or up to 6 for longer products."""
    rows = np.array([term.codes for term in basis], dtype=np.int64).reshape(len(basis), FACTORS)
    longest = max((FACTORS - term.codes.count(0) for term in basis), default=0)
    return np.ascontiguousarray(rows[:, FACTORS - max(longest, FEWEST_FACTORS) :])


def magnify(x: Array) -> Array:
    """z = [x, |x|] along the last axis; x has shape (..., N_VARIABLES)."""
    return np.concatenate([x, np.abs(x)], axis=-1)


def features(codes: Codes, z: Array, phi: Array) -> None:
    """Write phi_k = z[a_k] z[b_k] z[c_k] ...; codes (n, 3 to 6), z (2 N_VARIABLES,), phi (n,)."""
    for k in range(codes.shape[0]):
        product = z[codes[k, 0]] * z[codes[k, 1]] * z[codes[k, 2]]
        for factor in range(3, codes.shape[1]):
            product = product * z[codes[k, factor]]
        phi[k] = product


features_kernel = lean_kernel(features)


@kernel
def _features_of_samples(codes: Codes, x: Array, phi: Array) -> None:
    z = np.empty(2 * x.shape[1])
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            z[j] = x[i, j]
            z[x.shape[1] + j] = abs(x[i, j])
        features_kernel(codes, z, phi[i])


def evaluate(basis: Sequence[Term], x: Array) -> Array:
    """Regressor matrix Phi, shape (N, n_terms), of the variables x, shape (N, N_VARIABLES)."""
    return evaluate_codes(codes(basis), x)


def evaluate_codes(codes: Codes, x: Array) -> Array:
    """Phi of the terms with these codes, as `evaluate`."""
    phi = np.empty((x.shape[0], len(codes)))
    _features_of_samples(codes, np.ascontiguousarray(x, dtype=np.float64), phi)
    return phi


def variables(
    nu_dot: Array,
    nu: Array,
    attitude: Array,
    dofs: Sequence[str],
    wind: Array | None = None,
    inputs: Mapping[str, Array] | None = None,
) -> Array:
    """Variables x of sampled motion, shape (N, N_VARIABLES).

    nu_dot [m/s^2, rad/s^2] and nu [m/s, rad/s] have shape (N, n_dof) with columns `dofs`;
    attitude is (phi, theta, psi) [rad], shape (N, 3). `wind` is the velocity of the air in body
    axes [m/s], shape (N, 2); None means still air. `inputs` are the inputs by name, shape (N,).
    """
    x = np.zeros((len(nu), N_VARIABLES))
    x[:, 0] = 1.0
    for column, dof in enumerate(dofs):
        x[:, INDEX[ACCELERATIONS[DOFS.index(dof)]]] = nu_dot[:, column]
        x[:, INDEX[VELOCITIES[DOFS.index(dof)]]] = nu[:, column]
    angles, (u, v, w) = x[:, _ATTITUDE], x[:, _LINEAR].T
    angles[:, 0::2], angles[:, 1::2] = np.cos(attitude), np.sin(attitude)
    through = x[:, _LINEAR][:, :2] - (0.0 if wind is None else wind)
    x[:, _THROUGH] = through
    x[:, INDEX["V_q"]] = np.hypot(*through.T)
    x[:, _ANGLES] = attitude[:, :2]
    speed = np.hypot(np.hypot(u, v), w)
    over = np.divide(1.0, speed, out=np.zeros(len(nu)), where=speed > REST_M_S)
    x[:, INDEX["U"]], x[:, INDEX["1/U"]], x[:, INDEX["1/U^2"]] = speed, over, over * over
    x[:, INDEX[SIDESLIP]] = np.arctan2(v, u)
    for name, values in (inputs or {}).items():
        x[:, INDEX[name]] = values
    return x


def full_basis(dofs: Sequence[str]) -> tuple[Term, ...]:
    """The constant and the terms of Jervan (2020), eqs. (4.10)-(4.12), for any degrees of freedom.

    Accelerations; nu, |nu|nu, nu^3, |nu|, nu^2; and for every pair the six cross products
    without a common sign. For surge, sway and yaw these are 31 terms.
    """
    names = [VELOCITIES[DOFS.index(dof)] for dof in dofs]
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    texts = ["1", *(f"{a}_dot" for a in names), *names]
    texts += [f"|{a}|{a}" for a in names] + [f"{a}^3" for a in names]
    texts += [f"|{a}|" for a in names] + [f"{a}^2" for a in names]
    texts += [f"{a}{b}" for a, b in pairs]
    texts += [f"|{a}|{b}" for a in names for b in names if a != b]
    texts += [f"|{a}||{b}|" for a, b in pairs]
    return terms(texts)


NEEDED = {"surge", "sway", "yaw"}
STRAIGHT = ("1", "u", "u^2")
HULL = ("uv", "ur", "v^2", "vr", "r^2", "v^3/U", "v^2r/U", "vr^2/U", "r^3/U")
ROLL = ("up", "u^2phi", "vphi", "v^2phi")
RUDDER = ("{}", "u{}", "{}^2", "{}^3", "v{}", "r{}")
SHAFT = ("{}^2", "u{}")
SPEEDS = ("u", *SPEED)
MAX_SPEED_POWER = 2  # powers of the speed with which a product is kept


def manoeuvring_basis(accelerations: Sequence[str], inputs: Sequence[str]) -> tuple[Term, ...]:
    """Accelerations, straight motion, hull, rudders `delta` and shafts `n`.

    `accelerations` are those of the vessel, which moves in surge, sway and yaw at least.
    """
    texts = [*accelerations, *STRAIGHT]
    texts += [each.format(name) for name in inputs if name[0] == "n" for each in SHAFT]
    texts += [*HULL, *(ROLL if "p_dot" in accelerations else ())]
    texts += [each.format(name) for name in inputs if name.startswith("delta") for each in RUDDER]
    return terms(texts)


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
        kept += members if len(members) <= max(len(fewer), MAX_SPEED_POWER) else fewer
    return tuple(dict.fromkeys(kept))


def _without_speed(term: Term) -> tuple[int, ...]:
    """The codes of the factors other than u, U and 1/U."""
    return tuple(
        code for code in term.codes if code and VARIABLES[code % N_VARIABLES] not in SPEEDS
    )


def _fewer(own: tuple[int, ...]) -> tuple[Term, ...]:
    """The terms in which a product is written, by the codes of its factors other than speed."""
    if not own:
        return terms(STRAIGHT)
    product = Term((0,) * (FACTORS - len(own)) + own).name
    count = sum(VARIABLES[code % N_VARIABLES] in VELOCITIES for code in own)
    if count == 0:
        return terms([product, f"u{product}"])
    return terms([("u" if count == 1 else "") + product + "/U" * (count - 2)])
