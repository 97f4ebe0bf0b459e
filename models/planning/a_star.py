"""A* over a lattice of poses, its state augmented by how often each manoeuvre is still to come.

A state is (remaining counts, heading, cell); costs are whole control instants. Ljungberg (slides),
"Obtaining an experiment trajectory"; Hart, Nilsson and Raphael (1968).
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

    di: Integers  # (P, H) cells that a primitive leads on
    dj: Integers
    to: Integers  # (P, H) heading that it leads to
    cost: Integers  # (P, H) control instants
    stride: Integers  # (P,) of its counter in the number of the counts; 0 for a basic one
    valid: NDArray[np.bool_]  # (P, H, I, J) whether it is clear from there


class Bounds(NamedTuple):
    """What the cost to go cannot be below, by what is still to come (C,) and where (H, I, J)."""

    manoeuvres: Integers  # (C,) least instants of the manoeuvres to come
    reach: Array  # (C,) cells that they can lead on at most
    pace: float  # cells an instant, the fastest basic primitive
    relaxed: Integers  # (H, I, J) instants of passages, were manoeuvres free of charge and number
    goal: Integers  # (2,) cell


@kernel
def heuristic(bounds: Bounds, c: int, h: int, i: int, j: int) -> int:
    """A lower bound of the cost to go [instants]; consistent, so no state is opened twice.

    The manoeuvres to come take their time; they can bring the vessel nearer by their reach, the
    rest is sailed at the fastest pace, and around the obstacles.
    """
    far = np.hypot(float(i - bounds.goal[0]), float(j - bounds.goal[1]))
    straight = int(max(0.0, (far - bounds.reach[c]) / bounds.pace - 1e-6))
    return int(bounds.manoeuvres[c]) + max(straight, int(bounds.relaxed[h, i, j]))


@kernel
def relaxed(moves: Moves, free: NDArray[np.bool_], at: int, backward: bool) -> Integers:
    """Instants from every place to `at` (or from `at` to it), shape (H, I, J); Dijkstra.

    Primitives that are `free` (P,) cost nothing, and any number of them may be used.
    """
    n_p, n_h, n_i, n_j = moves.valid.shape
    found = np.full(n_h * n_i * n_j, UNREACHED)
    done = np.zeros(n_h * n_i * n_j, dtype=np.bool_)
    found[at] = 0
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
                if total < found[t]:
                    found[t] = total
                    heappush(heap, (total, np.int64(t)))
    return found.reshape((n_h, n_i, n_j))


@kernel
def shortest(
    moves: Moves, sizes: Integers, bounds: Bounds, start: int, goal: int
) -> tuple[Integers, int]:
    """Primitives of the cheapest path and its cost; none and -1 where there is no path.

    `start` and `goal` are places, h I J + i J + j; from all counts to none. `sizes` (P,) is one
    more than the count of an informative primitive. Of equal costs the first state counts.
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
            return _traced(parent, via, s), int(cost[s])
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
def _traced(parent: NDArray[np.int32], via: NDArray[np.int16], state: np.int64) -> Integers:
    """The primitives that led to a state, first to last."""
    steps = []
    while parent[state] >= 0:
        steps.append(np.int64(via[state]))
        state = np.int64(parent[state])
    return np.array(steps[::-1], dtype=np.int64)
