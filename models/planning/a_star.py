"""A* search over a lattice of poses; the state includes the remaining count of each manoeuvre.

A state is (remaining counts, heading, cell); costs are integer numbers of control instants.
Ljungberg (slides), "Obtaining an experiment trajectory"; Hart, Nilsson and Raphael (1968).
"""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.compiled import kernel
from seatrial.models.vessel.basis import Array

Integers = NDArray[np.int64]
UNREACHED = np.int64(2**62)


class Moves(NamedTuple):
    """P primitives from H headings on a lattice of I x J cells."""

    di: Integers  # (P, H) displacement in cells
    dj: Integers
    to: Integers  # (P, H) final heading
    cost: Integers  # (P, H) control instants
    stride: Integers  # (P,) of its counter in the index of the counts; 0 for a basic primitive
    valid: NDArray[np.bool_]  # (P, H, I, J) whether the path from the cell is clear


class Bounds(NamedTuple):
    """Lower bounds of the cost to go by remaining counts (C,) and by place (H, I, J)."""

    manoeuvres: Integers  # (C,) minimum instants of the remaining manoeuvres
    reach: Array  # (C,) maximum displacement by them, in cells
    pace: float  # cells per instant of the fastest basic primitive
    relaxed: Integers  # (H, I, J) instants of passages if manoeuvres had no cost and no limit
    goal: Integers  # (2,) cell


@kernel
def heuristic(bounds: Bounds, c: int, h: int, i: int, j: int) -> int:
    """A lower bound of the cost to go [instants]; consistent, so no state is expanded twice.

    It is the time of the remaining manoeuvres plus the time of the passages. The passages cover at
    least the distance to the goal minus the reach of the manoeuvres, at the fastest pace, and at
    least the relaxed path around the obstacles.
    """
    distance = np.hypot(float(i - bounds.goal[0]), float(j - bounds.goal[1]))
    straight = int(max(0.0, (distance - bounds.reach[c]) / bounds.pace - 1e-6))
    return int(bounds.manoeuvres[c]) + max(straight, int(bounds.relaxed[h, i, j]))


@kernel
def relaxed(moves: Moves, free: NDArray[np.bool_], at: int, backward: bool) -> Integers:
    """Instants from `at` to every place, or `backward` from every place to `at`; Dijkstra.

    Primitives that are `free` (P,) have no cost and may be used any number of times. Returns shape
    (H, I, J).
    """
    n_p, n_h, n_i, n_j = moves.valid.shape
    best = np.full(n_h * n_i * n_j, UNREACHED)
    done = np.zeros(n_h * n_i * n_j, dtype=np.bool_)
    best[at] = 0
    heap = [(np.int64(0), np.int64(at))]
    while len(heap) > 0:
        cost, s = heappop(heap)
        if done[s]:
            continue
        done[s] = True
        h, i, j = s // (n_i * n_j), s // n_j % n_i, s % n_j
        for p in range(n_p):
            for a in range(n_h):
                if (backward and moves.to[p, a] != h) or (not backward and a != h):
                    continue
                side = -1 if backward else 1
                b = a if backward else moves.to[p, a]
                k, m = i + side * moves.di[p, a], j + side * moves.dj[p, a]
                if k < 0 or m < 0 or k >= n_i or m >= n_j:
                    continue
                clear = moves.valid[p, a, k, m] if backward else moves.valid[p, a, i, j]
                if not clear:
                    continue
                t = (b * n_i + k) * n_j + m
                total = cost + (np.int64(0) if free[p] else moves.cost[p, a])
                if total < best[t]:
                    best[t] = total
                    heappush(heap, (total, np.int64(t)))
    return best.reshape((n_h, n_i, n_j))


@kernel
def shortest(
    moves: Moves, sizes: Integers, bounds: Bounds, start: int, goal: int
) -> tuple[Integers, int]:
    """Primitives of the path of least cost, and the cost [instants]; empty and -1 if none exists.

    `start` and `goal` are places, h I J + i J + j; the path uses all counts. `sizes` (P,) is the
    count of an informative primitive plus one. Of several paths of equal cost the one that was
    reached first is returned.
    """
    n_p, n_h, n_i, n_j = moves.valid.shape
    places = n_h * n_i * n_j
    n_c = len(bounds.manoeuvres)
    cost = np.full(n_c * places, 2**31 - 1, dtype=np.int32)
    parent = np.full(n_c * places, -1, dtype=np.int32)
    via = np.full(n_c * places, -1, dtype=np.int16)
    done = np.zeros(n_c * places, dtype=np.bool_)
    first = (n_c - 1) * places + start
    cost[first] = 0
    heap = [(np.int64(0), np.int64(first))]
    while len(heap) > 0:
        _, s = heappop(heap)
        if done[s]:
            continue
        done[s] = True
        if s == goal:
            return _traceback(parent, via, s), int(cost[s])
        c, place = s // places, s % places
        h, i, j = place // (n_i * n_j), place // n_j % n_i, place % n_j
        for p in range(n_p):
            stride = moves.stride[p]
            if not moves.valid[p, h, i, j] or (stride > 0 and c // stride % sizes[p] == 0):
                continue
            k, m, b = i + moves.di[p, h], j + moves.dj[p, h], moves.to[p, h]
            if bounds.relaxed[b, k, m] >= UNREACHED:
                continue
            t = (c - stride) * places + (b * n_i + k) * n_j + m
            total = cost[s] + moves.cost[p, h]
            if not done[t] and total < cost[t]:
                cost[t], parent[t], via[t] = total, s, p
                heappush(heap, (total + heuristic(bounds, c - stride, b, k, m), np.int64(t)))
    return np.zeros(0, dtype=np.int64), -1


@kernel
def _traceback(parent: NDArray[np.int32], via: NDArray[np.int16], state: np.int64) -> Integers:
    """The primitives that lead to a state, from first to last."""
    steps = []
    while parent[state] >= 0:
        steps.append(np.int64(via[state]))
        state = np.int64(parent[state])
    return np.array(steps[::-1], dtype=np.int64)
