"""Running performance metric: has a front stopped moving? Blank & Deb (2020b).

    d z*_t   = max_i (z*_i(t-1) - z*_i(t)) / (z_nad_i(t) - z*_i(t))                      Hoyer (3.9)
    d znad_t = max_i (z_nad_i(t-1) - z_nad_i(t)) / (z_nad_i(t) - z*_i(t))
    phi_t    = mean over the points of P_t of the distance to the nearest one of P_(t-1)

with ideal point z*, nadir point z_nad, and objectives normalised by both at t. The search has
converged when all three were below a threshold for `window` generations, Hoyer (3.10); the
changes are taken by magnitude.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from models.basis import Array

RESOLUTION = 1e-12  # of the objectives' scale: a front is not narrower


class Change(NamedTuple):
    """Change of a front over one generation, normalised."""

    ideal: float
    nadir: float
    front: float


@dataclass
class RunningMetric:
    """History of the changes of a front; scale (n_objectives,) are sizes of the objectives."""

    scale: Array
    window: int
    threshold: float
    changes: list[Change] = field(default_factory=list)
    last: Array | None = None

    def update(self, front: Array) -> None:
        """Take note of the next generation's front, shape (n, n_objectives)."""
        if self.last is not None:
            self.changes.append(change(self.last, front, RESOLUTION * self.scale))
        self.last = front

    @property
    def converged(self) -> bool:
        """Whether all changes of the last `window` generations are below the threshold.

        A front of one point has no extent to measure changes by, so it never counts as converged.
        """
        recent = self.changes[-self.window :]
        if self.last is None or len(self.last) < 2 or len(recent) < self.window:
            return False
        return max(map(max, recent)) < self.threshold


def change(before: Array, after: Array, least: Array) -> Change:
    """Change between the fronts of two generations; extents are at least `least`."""
    ideal, nadir = after.min(axis=0), after.max(axis=0)
    extent = np.maximum(nadir - ideal, least)
    distance = cKDTree((before - ideal) / extent).query((after - ideal) / extent)[0]
    return Change(
        float(np.max(np.abs(before.min(axis=0) - ideal) / extent)),
        float(np.max(np.abs(before.max(axis=0) - nadir) / extent)),
        float(np.mean(distance)),
    )
