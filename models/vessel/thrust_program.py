"""Thrust allocation by a quadratic program, in Python."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from seatrial.models.vessel.basis import Array, Codes

SIDES = 16  # of the polygon about an azimuth thruster's circle, for the quadratic program
CUTS = 12  # at most; each brings the circle's tangent where the force lies outside it
INSIDE = 1e-9  # of a circle's radius


class QuadraticProgram(NamedTuple):
    """Geometry for the program; circles are inequality rows in shares of the limit."""

    T: Array
    weight: Array  # (n_u,)
    low: Array  # (n_u,) [N]
    high: Array
    circles: Array  # (n_rows, n_u)
    pairs: Codes  # (n_azimuths, 2) their components in u
    u: Array


def _solve_program(table: QuadraticProgram, T: Array, tau: Array, circles: Array) -> Array | None:
    """(u, s) of the program, u in shares of the limits; None where the solver gives up."""
    import daqp

    n_dof, n_u = T.shape
    rows = np.hstack([T, -tau[:, None]])
    H = np.diag([*(1e-6 * table.weight), 1e-6])
    f = np.append(np.zeros(n_u), -1.0)
    upper = np.concatenate([np.ones(n_u + 1), np.zeros(n_dof), np.ones(len(circles))])
    lower = np.concatenate(
        [table.low / table.high, [0.0], np.zeros(n_dof), np.full(len(circles), -1e30)]
    )
    sense = np.zeros(len(upper), dtype=np.int32)
    sense[n_u + 1 : n_u + 1 + n_dof] = 5  # equality
    round_ = np.hstack([circles, np.zeros((len(circles), 1))])
    for tolerance in (1e-10, 1e-8):  # tangents that nearly coincide can be too fine for the first
        found, _, flag, _ = daqp.solve(
            H, f, np.vstack([rows, round_]), upper, lower, sense.copy(), primal_tol=tolerance
        )
        if flag >= 1:
            return np.asarray(found, dtype=np.float64)
    return None


def by_program(table: QuadraticProgram, tau: Array, applied: Array) -> None:
    """min delta/2 u' W u - s,  T u = s tau,  0 <= s <= 1,  u within its limits.

    For a small delta the share s is the largest possible one (an exact penalty), and u the
    lightest that gives it. In shares of the limits, so that the solver's tolerances have a
    meaning; what they leave of T u - s tau is then given to the thrusters between their limits.
    The circle of an azimuth thruster begins as a polygon about it; where its force lies outside,
    the tangent there is added (cutting planes), and at the end it is scaled by what is left.
    """
    n_u = table.T.shape[1]
    T = table.T * table.high
    size = np.max(np.abs(T), axis=1)
    circles, found = table.circles, np.zeros(n_u + 1)
    pairs = found[:n_u][table.pairs]
    for _ in range(CUTS):
        better = _solve_program(table, T / size[:, None], tau / size, circles)
        if better is None:  # what was found before is nearly it
            break
        found = better
        pairs = found[:n_u][table.pairs]  # (n_azimuths, 2)
        outside = np.hypot(*pairs.T) > 1.0 + INSIDE
        if not np.any(outside):
            break
        tangents = np.zeros((int(np.sum(outside)), n_u))
        way = pairs[outside] / np.hypot(*pairs[outside].T)[:, None]
        np.put_along_axis(tangents, table.pairs[outside], way, axis=1)
        circles = np.vstack([circles, tangents])
    found = found / max(1.0, np.max(np.hypot(*pairs.T), initial=0.0))
    x, s = found[:n_u], min(found[n_u], 1.0)
    s = 1.0 if s > 1.0 - 1e-7 else s
    free = (x < 1.0 - 1e-6) & (x > table.low / table.high + 1e-6)
    left = (s * tau - T @ x) / size
    x[free] += np.linalg.lstsq(T[:, free] / size[:, None], left, rcond=None)[0]
    table.u[:] = x * table.high
    applied[:] = table.T @ table.u


def circles_of(counts: Sequence[int]) -> Array:
    """Rows c with c u <= 1, tangents of azimuth thrusters' circles, in shares of their limit."""
    angle = 2.0 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
    sides = np.column_stack([np.cos(angle), np.sin(angle)])
    rows = np.zeros((SIDES * counts.count(2), sum(counts)))
    at = 0
    for first, count in zip(np.cumsum([0, *counts[:-1]]), counts, strict=True):
        if count == 2:
            rows[at : at + SIDES, first : first + 2] = sides
            at += SIDES
    return rows
