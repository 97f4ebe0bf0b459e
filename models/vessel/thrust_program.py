"""Thrust allocation by a quadratic program, in Python."""

from collections.abc import Sequence
from typing import NamedTuple

import daqp
import numpy as np

from seatrial.models.vessel.basis import Array, Codes

SIDES = 16  # of the polygon around the circle of an azimuth thruster
CUTS = 12  # largest number of cuts; each adds the tangent where the force is outside the circle
INSIDE = 1e-9  # of a circle's radius


class QuadraticProgram(NamedTuple):
    """Geometry for the program; circles are inequality rows relative to the limits."""

    T: Array
    weight: Array  # (n_u,)
    low: Array  # (n_u,) [N]
    high: Array
    circles: Array  # (n_rows, n_u)
    pairs: Codes  # (n_azimuths, 2) their components in u
    u: Array


def _solve_program(table: QuadraticProgram, T: Array, tau: Array, circles: Array) -> Array | None:
    """(u, s) of the program, u relative to the limits; None if the solver fails."""
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
    circle_rows = np.hstack([circles, np.zeros((len(circles), 1))])
    for tolerance in (1e-10, 1e-8):  # nearly equal tangents can fail at the first
        solution, _, flag, _ = daqp.solve(
            H, f, np.vstack([rows, circle_rows]), upper, lower, sense.copy(), primal_tol=tolerance
        )
        if flag >= 1:
            return np.asarray(solution, dtype=np.float64)
    return None


def by_program(table: QuadraticProgram, tau: Array, applied: Array) -> None:
    """Write the solution of min delta/2 u' W u - s,  T u = s tau,  0 <= s <= 1,  u within limits.

    For a small delta the share s is the largest possible one (an exact penalty), and u the
    solution of least cost for it. The forces are relative to the limits, so that the tolerances of
    the solver are meaningful; its residual T u - s tau is then distributed over the thrusters that
    are not at a limit. The circle of an azimuth thruster is first a polygon around it; where the
    force is outside the circle, the tangent is added (cutting planes). Finally the forces are
    scaled by the remaining excess.
    """
    n_u = table.T.shape[1]
    T = table.T * table.high
    size = np.max(np.abs(T), axis=1)
    circles, solution = table.circles, np.zeros(n_u + 1)
    pairs = solution[:n_u][table.pairs]
    for _ in range(CUTS):
        improved = _solve_program(table, T / size[:, None], tau / size, circles)
        if improved is None:  # keep the last solution, which is close
            break
        solution = improved
        pairs = solution[:n_u][table.pairs]  # (n_azimuths, 2)
        outside = np.hypot(*pairs.T) > 1.0 + INSIDE
        if not np.any(outside):
            break
        tangents = np.zeros((int(np.sum(outside)), n_u))
        direction = pairs[outside] / np.hypot(*pairs[outside].T)[:, None]
        np.put_along_axis(tangents, table.pairs[outside], direction, axis=1)
        circles = np.vstack([circles, tangents])
    solution = solution / max(1.0, np.max(np.hypot(*pairs.T), initial=0.0))
    x, s = solution[:n_u], min(solution[n_u], 1.0)
    s = 1.0 if s > 1.0 - 1e-7 else s
    free = (x < 1.0 - 1e-6) & (x > table.low / table.high + 1e-6)
    residual = (s * tau - T @ x) / size
    x[free] += np.linalg.lstsq(T[:, free] / size[:, None], residual, rcond=None)[0]
    table.u[:] = x * table.high
    applied[:] = table.T @ table.u


def circles_of(counts: Sequence[int]) -> Array:
    """Rows c with c u <= 1: tangents of the circles of azimuth thrusters, relative to the limit."""
    angle = 2.0 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
    sides = np.column_stack([np.cos(angle), np.sin(angle)])
    rows = np.zeros((SIDES * counts.count(2), sum(counts)))
    row = 0
    for first, count in zip(np.cumsum([0, *counts[:-1]]), counts, strict=True):
        if count == 2:
            rows[row : row + SIDES, first : first + 2] = sides
            row += SIDES
    return rows
