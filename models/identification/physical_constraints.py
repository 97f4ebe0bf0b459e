"""What physics asks of an identified table, as constraints of a convex program.

    inertia      M_0 / factor <= (M + M') / 2 <= factor M_0       linear matrix inequalities
    symmetry     |M_ij - M_ji| <= factor |M_0ij - M_0ji|
    dissipation  nu' d(nu) >= 0                                   at sampled velocities
    restoring    moments of roll and pitch that right the nominal vessel do so

M_0 is the nominal inertia; d(nu) are the forces that depend on velocities alone. A Coriolis force
does no work, so it may be part of d. Restoring forces, weather and constants are left out. A table
whose damping creates energy runs away in a free run, and one whose inertia is not positive
definite cannot be simulated at all.

The parameters p enter linearly, theta = theta_0 + L dp (`free_parameters`), so dissipation is a
row per velocity. The matrix inequalities are met by cutting planes: where an eigenvector x of the
solution violates one, the linear row x' M x is added and the quadratic program is solved again
(Kelley (1960)); a few rounds suffice for matrices of this size.

Dissipation between the sampled velocities is met in the same way. Terms are products of one to
three velocities or their moduli, so along a ray nu = s d, s > 0, the power is s^2 times a quadratic
function of s, whose least value is known. Only directions have to be searched.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import daqp
import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.notation import VELOCITIES
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import N_VARIABLES, VARIABLES, Array, Term
from seatrial.models.vessel.table import Vessel

MAX_VELOCITIES = 150  # recorded velocities at which the damping must dissipate
FURTHER_DRAWS = 100  # further ones, at each scale
VELOCITY_SCALES = (0.3, 1.0, 2.0, 10.0)  # of the recorded ones; the last: no runaway beyond them
MAX_CUTS = 60  # rounds of cutting planes
RIGHTING = (("roll", "sin(phi)cos(theta)"), ("pitch", "sin(theta)"))  # restoring moments
RAYS = 4096  # directions in which dissipation is searched
SEARCHED_MULTIPLE = 2.0  # times the largest velocities, as far as a ray is searched
CUTS_OF_RAYS = 30  # rows of dissipation that one round adds
SMALLEST = 1e-3  # of a ray
POWER_MARGIN = 0.02  # of the nominal power that remains at a velocity that was cut
PRIMAL = (1e-12, 1e-9, 1e-6)  # tolerances of the solver: the next one where it cycles
ACTIVE_LOWER = 3  # the solver's word for a row whose lower bound binds
REPEATS = 5  # of a quadratic program about its solution
ROW_TOLERANCE = 1e-6  # of a row of size one, and of an eigenvalue relative to the nominal inertia


@dataclass(frozen=True)
class Rows:
    """Linear constraints A dp >= b, each with the name of what it stands for."""

    A: Array  # (k, m)
    b: Array  # (k,)
    names: tuple[str, ...]

    def __add__(self, other: "Rows") -> "Rows":
        A, b = np.vstack([self.A, other.A]), np.concatenate([self.b, other.b])
        return Rows(A, b, self.names + other.names)


def damping_terms(table: Vessel) -> list[int]:
    """Indices of the terms that depend on velocities of the hull alone, such as u, |v|r, u^3.

    None of a table that is not that of a hull alone: they hold the lift of a rudder and the thrust
    of a propeller as well, so that they need not dissipate.
    """
    if not table.bare_hull:
        return []
    hull = {VARIABLES.index(letter) for letter in VELOCITIES}
    return [
        i
        for i, term in enumerate(table.terms)
        if any(term.codes) and all(code % N_VARIABLES in {0, *hull} for code in term.codes)
    ]


def dissipates(term: Term, letter: str) -> bool:
    """Whether a positive coefficient brakes its own axis `letter`: x, |x|x or x^3 in that of x."""
    letters = {VARIABLES[code % N_VARIABLES] for code in term.codes if code}
    odd = sum(0 < code < N_VARIABLES for code in term.codes) % 2 == 1
    return odd and letters == {letter}


def sampled_velocities(nu: Array, inertia: Array) -> Array:
    """Velocities (n, n_dof) [m/s, rad/s] for the dissipation, from the recorded ones (N, n_dof).

    Recorded ones and multiples of them, and a low-discrepancy sequence. An axis that hardly moved
    takes part in the latter with a velocity of the same kinetic energy as the others, by the
    diagonal of the inertia (n_dof, n_dof).
    """
    step = max(len(nu) // MAX_VELOCITIES, 1)
    recorded = [scale * nu[::step] for scale in VELOCITY_SCALES]
    drawn = largest_velocities(nu, inertia) * _spread(nu.shape[1], FURTHER_DRAWS)
    return np.vstack([*recorded, *(scale * drawn for scale in VELOCITY_SCALES[1:])])


def largest_velocities(nu: Array, inertia: Array) -> Array:
    """Velocities (n_dof,) of the largest recorded kinetic energy; see `sampled_velocities`."""
    M = np.diag(inertia)
    return np.asarray(np.sqrt(np.max(np.max(np.abs(nu), axis=0) ** 2 * M) / M))


@lru_cache(maxsize=16)
def _spread(n_dof: int, count: int) -> Array:
    """A low-discrepancy sequence (count, n_dof) between -1 and 1, of Halton (1960)."""
    halton = np.zeros((count, n_dof))
    for column, base in zip(halton.T, (2, 3, 5, 7, 11, 13), strict=False):
        digits, weight = np.arange(1, count + 1), 1.0 / base
        while np.any(digits):
            column += weight * (digits % base)
            digits, weight = digits // base, weight / base
    return 2.0 * halton - 1.0


class Rays(NamedTuple):
    """Directions of the velocity space, and the terms of the damping along them."""

    directions: Array  # (n, n_dof), whose largest part is that of the box of `AROUND`
    rows: list[int]  # of the terms in the table
    phi: Array  # (n, n_terms) at the directions
    order: NDArray[np.int64]  # (n_terms,) factors of each term, 1 to 3

    @classmethod
    def of(cls, table: Vessel, largest: Array) -> "Rays":
        """Rays to the sides of a box of `largest` velocities (n_dof,).

        Terms such as |u|v have kinks, and the power its least values, where a velocity is zero.
        """
        inside = _spread(len(largest), RAYS)
        planes = [np.where(axis, 0.0, inside[: RAYS // 4]) for axis in np.eye(len(largest))]
        inside = np.vstack([inside, *planes, np.eye(len(largest)), -np.eye(len(largest))])
        inside = inside[np.any(inside != 0.0, axis=1)]
        sides = inside / np.max(np.abs(inside), axis=1, keepdims=True)
        directions = SEARCHED_MULTIPLE * largest * sides
        index = damping_terms(table)
        terms = [table.terms[i] for i in index]
        motion = table.variables(np.zeros_like(directions), directions)
        order = np.array([term.order for term in terms], dtype=np.int64)
        return cls(directions, index, basis.evaluate(terms, motion), order)

    def power(self, theta: Array) -> Array:
        """Coefficients (n, 3) of s^2, s^3, s^4 in the power of a table at s times a direction."""
        each = self.phi * (self.directions @ theta[self.rows].T)  # (n, n_terms)
        return np.stack([np.sum(each[:, self.order == k], axis=1) for k in (1, 2, 3)], axis=1)

    def least(self, theta: Array) -> tuple[Array, Array]:
        """s (n,) in [0, 1] of the least power over s^2 of a table, and that value (n,)."""
        a, b, c = self.power(theta).T  # over s^2
        vertex = np.divide(-0.5 * b, c, out=np.zeros_like(b), where=c > 0.0)
        s = np.stack([np.full_like(b, SMALLEST), np.clip(vertex, SMALLEST, 1.0), np.ones_like(b)])
        values = a + b * s + c * s**2
        best = np.argmin(values, axis=0)
        rows = np.arange(len(a))
        return s[best, rows], values[best, rows]


def dissipated(table: Vessel, velocities: Array) -> Array:
    """Power (n,) [W] that the damping of a table takes from the motion at velocities (n, n_dof)."""
    index = damping_terms(table)
    damping = _terms_at(table, index, velocities) @ table.theta[index]
    return np.asarray(np.sum(damping * velocities, axis=1))


def _terms_at(table: Vessel, index: Sequence[int], velocities: Array) -> Array:
    """Some terms of a table (n, len(index)) at velocities (n, n_dof)."""
    motion = table.variables(np.zeros_like(velocities), velocities)
    return basis.evaluate([table.terms[i] for i in index], motion)


def unphysical(model: Vessel, nominal: Vessel, nu: Array) -> str | None:
    """What of an identified model cannot be at recorded velocities nu (N, n_dof); None: nothing.

    Its inertia is not positive definite, or its damping creates energy where the nominal one
    takes some.
    """
    if np.min(np.linalg.eigvalsh(0.5 * (model.inertia + model.inertia.T))) <= 0.0:
        return "its inertia is not positive definite"
    velocities = nu[:: max(len(nu) // MAX_VELOCITIES, 1)]
    own, reference = dissipated(model, velocities), dissipated(nominal, velocities)
    creates = (own < -ROW_TOLERANCE * np.abs(reference)) & (reference >= 0.0)
    if not np.any(creates):
        return None
    return (
        f"its damping creates energy at {100.0 * np.mean(creates):.2g} % of the recorded velocities"
    )


@dataclass(frozen=True, eq=False)
class PhysicalConstraints:
    """The constraints on the parameters of a table, and bounds of each by itself.

    `factor` bounds the inertia; None: there are only the bounds of the box.
    """

    free: FreeParameters
    nu: Array  # (N, n_dof) recorded velocities, about which damping must dissipate
    factor: float | None
    scale: Array  # (m,) size of the parameters, for the tolerance
    box: tuple[Array, Array] | None = None  # lower and upper bounds (m,), infinite: none

    @cached_property
    def velocities(self) -> Array:
        """Velocities (n, n_dof) at which the damping must dissipate."""
        return sampled_velocities(self.nu, self.free.nominal.inertia)

    @cached_property
    def rows(self) -> Rows:
        """Dissipation at the velocities, signs of single coefficients, symmetry, and the bounds.

        Rows that the nominal table itself violates ask nothing that it could not be.
        """
        if self.factor is None:
            return self._bounds
        physical = self._dissipation(self.velocities) + self._positive()
        return self._scaled(physical + self._asymmetry(self.factor)) + self._bounds

    @cached_property
    def changes(self) -> tuple[Array, Array]:
        """The box in changes of the nominal parameters."""
        infinite = np.full(len(self.free), np.inf)
        lower, upper = self.box or (-infinite, infinite)
        return lower - self.free.values, upper - self.free.values

    @cached_property
    def _bounds(self) -> Rows:
        A, (lower, upper) = np.diag(1.0 / self.scale), self.changes
        b = np.concatenate([lower, -upper]) / np.tile(self.scale, 2)
        kept = np.flatnonzero(np.isfinite(b))
        names = tuple(self.free.labels[i % len(A)] for i in kept)
        return Rows(np.vstack([A, -A])[kept], b[kept], names)

    @cached_property
    def _damping(self) -> list[int]:
        return damping_terms(self.free.nominal)

    def _dissipation(self, velocities: Array, share: float = 0.0) -> Rows:
        """Dissipation at velocities (n, n_dof) of at least a `share` of the nominal one."""
        table, index = self.free.nominal, self._damping
        phi = _terms_at(table, index, velocities)
        work = phi[:, :, None] * velocities[:, None, :]  # (n, terms, n_dof)
        slopes = np.tensordot(work, self.free.slopes[index], 2)
        nominal = np.sum((phi @ table.theta[index]) * velocities, axis=1)
        needed = (share - 1.0) * nominal
        return Rows(slopes, needed, ("dissipation",) * len(slopes))

    def _scaled(self, rows: Rows) -> Rows:
        """Rows of size one, without those that the nominal table violates or nothing changes."""
        size = np.linalg.norm(rows.A * self.scale, axis=1)
        keep = (rows.b <= 0.0) & (size > 0.0)
        names = tuple(name for name, kept in zip(rows.names, keep, strict=True) if kept)
        return Rows(rows.A[keep] / size[keep, None], rows.b[keep] / size[keep], names)

    def _positive(self) -> Rows:
        """Coefficients that stay positive where they nominally are.

        Those of x, |x|x and x^3 in the equation of x, and moments that right roll and pitch.
        """
        table, slopes = self.free.nominal, self.free.slopes
        A, b, names = [], [], []
        for i, k in zip(*np.nonzero((table.theta > 0.0) & np.any(slopes, axis=2)), strict=True):
            term, dof = table.terms[i], table.dofs[k]
            brakes = i in self._damping and dissipates(term, table.velocities[k])
            if brakes or (dof, term.name) in RIGHTING:
                A.append(slopes[i, k])
                b.append(-table.theta[i, k])
                names.append(f"{dof}.{term}" if brakes else "restoring")
        return Rows(np.array(A).reshape(-1, len(self.free)), np.array(b), tuple(names))

    def _asymmetry(self, factor: float) -> Rows:
        """M_ij - M_ji differs from zero by no more than `factor` times the nominal one."""
        M, slopes = self.free.nominal.inertia, self._inertia_slopes
        i, j = np.triu_indices(len(M), 1)
        slope, nominal = (slopes[:, i, j] - slopes[:, j, i]).T, M[i, j] - M[j, i]
        most = factor * np.abs(nominal)
        b = np.concatenate([-most - nominal, nominal - most])
        return Rows(np.vstack([slope, -slope]), b, ("symmetry",) * len(b))

    @cached_property
    def _inertia_slopes(self) -> Array:
        """Derivative of the inertia, shape (m, n_dof, n_dof)."""
        table = self.free.nominal
        rows = [table.terms.index(basis.term(letter)) for letter in table.accelerations]
        return np.asarray(self.free.slopes[rows].transpose(2, 1, 0))

    @cached_property
    def _inertia_directions(self) -> Array:
        """Derivative of the symmetric part of the inertia, shape (m, n_dof, n_dof)."""
        return np.asarray(0.5 * (self._inertia_slopes + self._inertia_slopes.transpose(0, 2, 1)))

    def violated(self, change: Array) -> tuple[str, ...]:
        """Names of the constraints that a change (m,) of the nominal parameters violates."""
        missed = self.rows.A @ change < self.rows.b - ROW_TOLERANCE
        names = [self.rows.names[i] for i in np.flatnonzero(missed)]
        cuts = self.cuts(change)
        return tuple(dict.fromkeys([*names, *(cuts.names if cuts else ())]))

    def longest(self, change: Array) -> Array:
        """The longest part of a change (m,) that meets the constraints, as none at all does."""
        low, high = 0.0, 1.0
        while high - low > ROW_TOLERANCE:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.violated(middle * change) else (middle, high)
        return low * change

    def _inertia(self, change: Array) -> tuple[Array, Array]:
        """Eigenvalues (n_dof,) and vectors of the inertia over the nominal one."""
        M_0 = 0.5 * (self.free.nominal.inertia + self.free.nominal.inertia.T)
        M = M_0 + np.einsum("m,mij->ij", change, self._inertia_directions)
        values, vectors = scipy.linalg.eigh(M, M_0)
        return values, vectors

    def cuts(self, change: Array) -> Rows | None:
        """Rows that a change (m,) of the parameters violates beside `rows`; None: none."""
        if self.factor is None:
            return None
        found = [cut for cut in (self.inertia_cuts(change), self.power_cuts(change)) if cut]
        return sum(found[1:], found[0]) if found else None

    def power_cuts(self, change: Array) -> Rows | None:
        """Dissipation where damping takes hardly any of the nominal power; None: nowhere."""
        nominal = self.free.nominal.theta
        theta = nominal + self.free.slopes @ change
        s, power = self._rays.least(theta - 0.5 * POWER_MARGIN * nominal)
        if not np.any(power < 0.0):
            return None
        worst = np.argsort(power)[:CUTS_OF_RAYS]
        worst = worst[power[worst] < 0.0]
        velocities = s[worst, None] * self._rays.directions[worst]
        rows = self._scaled(self._dissipation(velocities, POWER_MARGIN))
        missed = rows.A @ change < rows.b - 2.0 * ROW_TOLERANCE
        names = ("dissipation",) * int(np.count_nonzero(missed))
        return Rows(rows.A[missed], rows.b[missed], names) if names else None

    @cached_property
    def _rays(self) -> Rays:
        nominal = self.free.nominal
        return Rays.of(nominal, largest_velocities(self.nu, nominal.inertia))

    def inertia_cuts(self, change: Array) -> Rows | None:
        """Rows that the inertia violates after a change (m,) of the parameters; None: none."""
        assert self.factor is not None
        values, vectors = self._inertia(change)
        sign = np.where(values < 1.0, 1.0, -1.0)  # of a row that raises or lowers an eigenvalue
        bounds = np.where(values < 1.0, 1.0 / self.factor, self.factor)
        missed = sign * (bounds - values) > ROW_TOLERANCE
        if not np.any(missed):
            return None
        x = vectors[:, missed]
        slopes = np.einsum("ik,mij,jk->km", x, self._inertia_directions, x)
        A, b = sign[missed, None] * slopes, (sign * (bounds - 1.0))[missed]
        return Rows(A, b, ("inertia",) * len(b))


def solve(
    hessian: Array, gradient: Array, constraints: PhysicalConstraints | None, at: Array
) -> tuple[Array, tuple[str, ...]]:
    """The step d (m,) that minimises d'Hd/2 - g'd so that `at` + d meets the constraints.

    `at` (m,) is the change of the parameters from the nominal ones so far. Returns the names of
    the active constraints too. Raises IdentificationError if the program cannot be solved.
    """
    root = np.sqrt(np.diag(hessian))
    if not (np.all(np.isfinite(hessian)) and np.all(root > 0.0)):
        raise IdentificationError("the training part does not determine every parameter")
    H, g = hessian / np.outer(root, root), gradient / root
    if constraints is None:
        return _minimum(H, g) / root, ()
    rows, start = constraints.rows, at * root  # in the whole change, whose origin is feasible
    active = list[int]()
    for _ in range(MAX_CUTS):
        solution, active = _quadratic_program(H, g + H @ start, rows.A / root, rows.b, active)
        change = np.clip(solution / root, *constraints.changes)
        cuts = constraints.cuts(change)
        if cuts is None or np.any(rows.A @ (solution / root) < rows.b - ROW_TOLERANCE):
            break
        rows = rows + cuts
    if cuts is not None:  # rounding leaves it outside: of exact data, or of a table far outside
        change = constraints.longest(change)
    return change - at, tuple(dict.fromkeys(rows.names[i] for i in active))


def feasible(change: Array, constraints: PhysicalConstraints) -> Array:
    """A change (m,) that meets the constraints, or the nearest one relative to the sizes."""
    if not constraints.violated(change):
        return change
    H = np.diag(constraints.scale**-2.0)
    return change + solve(H, np.zeros(len(change)), constraints, change)[0]


def _minimum(H: Array, g: Array) -> Array:
    """The smallest minimiser of d'Hd/2 - g'd: beside exact data rounding may lose the prior."""
    return np.asarray(np.linalg.lstsq(H, g, rcond=None)[0])


def _quadratic_program(
    H: Array, g: Array, A: Array, b: Array, active: list[int]
) -> tuple[Array, list[int]]:
    """minimise d'Hd/2 - g'd so that A d >= b; the solution, and the rows that bind.

    The solver begins with the rows that are said to be `active`, most of which will be.
    The solver's tolerance is absolute; rows that it misses, of an axis whose weight is small beside
    that of another, are solved for again about the solution, until all of them hold.
    """
    if not len(A):
        return _minimum(H, g), []
    solution, active = _solved(H, g, A, b, active)
    for _ in range(REPEATS):
        missing = b - A @ solution
        if np.max(missing) <= ROW_TOLERANCE:
            break
        step, active = _solved(H, g - H @ solution, A, missing, active)
        solution = solution + step
    return solution, active


def _solved(H: Array, g: Array, A: Array, b: Array, active: list[int]) -> tuple[Array, list[int]]:
    norm = np.linalg.norm(A, axis=1)  # rows and a solution of size one, for the solver's tolerances
    size = max(float(np.max(np.abs(g))), float(np.max(b / norm))) or 1.0
    for tolerance, first in ((PRIMAL[0], active), *((each, []) for each in PRIMAL)):
        sense = np.zeros(len(A), dtype=np.int32)
        sense[first] = ACTIVE_LOWER
        solution, _, flag, info = daqp.solve(
            np.ascontiguousarray(H), -g / size, np.ascontiguousarray(A / norm[:, None]),
            np.full(len(A), 1e30), b / (norm * size), sense, primal_tol=tolerance,
        )  # fmt: skip
        if flag > 0:
            return np.asarray(solution) * size, np.flatnonzero(info["lam"]).tolist()
    raise IdentificationError(
        f"the bounds and physical constraints leave no solution (daqp: {flag}): "
        "identifier.inertia_factor=null lifts the latter"
    )
