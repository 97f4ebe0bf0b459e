"""The quadratic program of thrust allocation, solved by Newton's method on its dual.

    min u' W u,  T u = s tau,  every thruster within its limit, for the largest share s up to 1

Without limits the solution is the weighted pseudo-inverse u = W^-1 T' (T W^-1 T')^-1 tau. With
limits it is u = P(W^-1 T' lambda), where P saturates each thruster, for the multipliers lambda with
T u = s tau. They maximise the concave dual function, whose gradient is s tau - T u; the first step
of Newton's method is the pseudo-inverse, the following ones distribute what saturated thrusters do
not give. Boyd and Vandenberghe (2004), sections 5.5 and 9.5.
"""

from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.vessel.basis import Array, Codes

HALVINGS = 40  # of the interval that contains the scale of an unreachable force
ZERO_PIVOT = 1e-12  # of a pivot, relative to the largest entry
NEWTON_STEPS = 40
ZERO_THRUST = 1e-13  # of a force, relative to that of all thrusters at their limit
RIDGE = 1e-9  # added to the diagonal, relative to it, as saturated thrusters do not respond


class PseudoInverse(NamedTuple):
    """Geometry for the kernel, and work space for one allocation."""

    T: Array  # (n_dof, n_u)
    spare: Array  # (n_u,) 1 / weight
    low: Array  # (n_thrusters,) [N]
    high: Array
    first: Codes  # (n_thrusters + 1,) first component of each thruster
    u: Array  # (n_u,)
    pull: Array  # (n_u,) u without limits
    multiplier: Array  # (n_dof,) lambda
    way: Array  # (n_dof,) step of lambda
    reach: Array  # (n_dof,) [N, Nm] force of all thrusters at their limit
    give: Array  # (n_dof,) diagonal of T W^-1 T'
    G: Array  # (n_dof, n_dof + 1)


@lean_kernel
def _solve(G: Array) -> bool:
    """Solve the square system in G = [A b] by elimination, with the solution in its last column."""
    n = G.shape[0]
    largest = 0.0
    for i in range(n):
        for j in range(n):
            largest = max(largest, abs(G[i, j]))
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(G[i, k]) > abs(G[pivot, k]):
                pivot = i
        if not abs(G[pivot, k]) > ZERO_PIVOT * largest:
            return False
        for j in range(k, n + 1):
            G[k, j], G[pivot, j] = G[pivot, j], G[k, j]
        for i in range(n):
            if i != k:
                factor = G[i, k] / G[k, k]
                for j in range(k, n + 1):
                    G[i, j] -= factor * G[k, j]
    for k in range(n):
        G[k, n] /= G[k, k]
    return True


@lean_kernel
def _respond(table: PseudoInverse) -> float:
    """Write u = P(W^-1 T' lambda), saturated at the limits; returns the conjugate of the cost."""
    total = 0.0
    for t in range(table.low.shape[0]):
        at, end = table.first[t], table.first[t + 1]
        square = 0.0
        for c in range(at, end):
            table.pull[c] = 0.0
            for i in range(table.multiplier.shape[0]):
                table.pull[c] += table.spare[c] * table.T[i, c] * table.multiplier[i]
            square += table.pull[c] ** 2
        scale = 1.0
        if end - at == 2 and square > table.high[t] ** 2:
            scale = table.high[t] / np.sqrt(square)
        for c in range(at, end):
            table.u[c] = scale * table.pull[c]
            if end - at == 1:
                table.u[c] = min(max(table.pull[c], table.low[t]), table.high[t])
            total += (table.pull[c] - 0.5 * table.u[c]) * table.u[c] / table.spare[c]
    return total


@lean_kernel
def _curve(table: PseudoInverse, i: int, j: int) -> float:
    """d (T u)_i / d lambda_j: saturated thrusters do not respond, or only sideways."""
    total = 0.0
    for t in range(table.low.shape[0]):
        at = table.first[t]
        if table.first[t + 1] - at == 1:
            if table.low[t] < table.pull[at] < table.high[t]:
                total += table.T[i, at] * table.spare[at] * table.T[j, at]
        else:
            x, y = table.pull[at], table.pull[at + 1]
            size = np.sqrt(x * x + y * y)
            along = table.T[i, at] * table.T[j, at] + table.T[i, at + 1] * table.T[j, at + 1]
            if size <= table.high[t]:
                total += table.spare[at] * along
            else:
                along_i = (table.T[i, at] * x + table.T[i, at + 1] * y) / size
                along_j = (table.T[j, at] * x + table.T[j, at + 1] * y) / size
                total += table.spare[at] * table.high[t] / size * (along - along_i * along_j)
    return total


@lean_kernel
def _residual(table: PseudoInverse, tau: Array, scale: float) -> bool:
    """Write scale tau - T u to the last column of G; returns whether it exceeds rounding."""
    nonzero = False
    for i in range(tau.shape[0]):
        rest = scale * tau[i]
        for c in range(table.u.shape[0]):
            rest -= table.T[i, c] * table.u[c]
        table.G[i, -1] = rest
        nonzero = nonzero or abs(rest) > ZERO_THRUST * table.reach[i]
    return nonzero


@lean_kernel
def _newton_step(table: PseudoInverse, tau: Array, scale: float, value: float) -> float:
    """A Newton step that maximises the dual function, halved until it rises; gradient in G."""
    n = tau.shape[0]
    slope = 0.0
    for i in range(n):
        table.way[i] = table.G[i, n]
        for j in range(n):
            table.G[i, j] = _curve(table, i, j)
        table.G[i, i] += RIDGE * table.give[i]
    if not _solve(table.G):
        return value
    for i in range(n):
        slope += table.way[i] * table.G[i, n]
        table.way[i] = table.G[i, n]
        table.multiplier[i] += table.way[i]
    length = 1.0
    for _ in range(HALVINGS):
        increased = -_respond(table)
        for i in range(n):
            increased += scale * tau[i] * table.multiplier[i]
        if increased >= value + 1e-4 * length * slope - ZERO_THRUST * abs(value):
            return increased
        length *= 0.5
        for i in range(n):
            table.multiplier[i] -= length * table.way[i]
    return value


@lean_kernel
def _distribute(table: PseudoInverse, tau: Array, scale: float) -> bool:
    """Write the u of least cost within the limits with T u = scale tau; False if there is none."""
    for i in range(tau.shape[0]):
        table.multiplier[i] = 0.0
    value = -_respond(table)
    for _ in range(NEWTON_STEPS):
        if not _residual(table, tau, scale):
            return True
        value = _newton_step(table, tau, scale, value)
    return not _residual(table, tau, scale)


@lean_kernel
def by_pseudo_inverse(table: PseudoInverse, tau: Array, applied: Array) -> None:
    """Write T u for the largest share of tau, at most all of it, that the thrusters can give."""
    low, high = 0.0, 1.0
    if not _distribute(table, tau, 1.0):
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if _distribute(table, tau, middle):
                low = middle
            else:
                high = middle
        _distribute(table, tau, low)
    for i in range(tau.shape[0]):
        applied[i] = 0.0
        for c in range(table.u.shape[0]):
            applied[i] += table.T[i, c] * table.u[c]


@kernel
def allocate_all(table: PseudoInverse, tau: Array, u: Array, applied: Array) -> None:
    """Write u (N, n_u) and T u (N, n_dof) for forces tau (N, n_dof)."""
    for k in range(tau.shape[0]):
        by_pseudo_inverse(table, tau[k], applied[k])
        u[k] = table.u
