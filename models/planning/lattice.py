"""The lattice of poses in given waters, and from which of them each primitive is clear.

It is anchored at the starting pose: its cells are squares along and across the starting heading,
its headings multiples of 45 deg from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.a_star import Integers
from seatrial.models.planning.primitives import (
    HEADINGS,
    STEP,
    Pace,
    Primitive,
    basic,
    closed,
    nearest,
    turned,
)
from seatrial.models.planning.waters import Waters, clear, inside, simplified
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, in_ned

STRAY = 0.02  # cells that a path may be simplified by; the clearance is as much larger
MOST_CELLS = 250_000
AT_ONCE = 20_000  # paths that are tested together


@dataclass(frozen=True, eq=False)
class Lattice:
    """I x J cells of `cell_m` about the pose `anchor` (north, east, heading) [m, m, rad]."""

    anchor: Array
    cell_m: float
    first: tuple[int, int]  # cell of the first row and column, counted from the anchor
    shape: tuple[int, int]

    @classmethod
    def over(cls, waters: Waters, anchor: Array, cell_m: float) -> "Lattice":
        """The lattice that covers an area."""
        n0, n1, e0, e1 = waters.bounds
        corners = np.array([(n, e) for n in (n0, n1) for e in (e0, e1)])
        own = in_body(corners - anchor[:2], anchor[2]) / cell_m
        low, high = np.ceil(own.min(axis=0)).astype(int), np.floor(own.max(axis=0)).astype(int)
        shape = (int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
        if shape[0] * shape[1] > MOST_CELLS:
            raise ConfigurationError(
                f"cell_m: {cell_m:g} m makes {shape[0]} x {shape[1]} cells of the area, expected "
                f"at most {MOST_CELLS}: a larger cell"
            )
        return cls(anchor, cell_m, (int(low[0]), int(low[1])), shape)

    def place(self, pose: Array) -> int:
        """Number of the place nearest to a pose (north, east, heading)."""
        own = pose - self.anchor
        own[:2] = in_body(own[:2], self.anchor[2])
        return self.number(*nearest(own, self.cell_m))

    def number(self, i: int, j: int, h: int) -> int:
        """Number of the place in a cell, counted from the anchor, and a heading."""
        row, column = i - self.first[0], j - self.first[1]
        return ((h % HEADINGS) * self.shape[0] + row) * self.shape[1] + column

    def pose(self, place: int) -> Array:
        """The pose (north, east, heading) of a place."""
        h, i, j = np.unravel_index(place, (HEADINGS, *self.shape))
        own = np.array([i + self.first[0], j + self.first[1]], dtype=np.float64) * self.cell_m
        return np.array(
            [*(self.anchor[:2] + in_ned(own, self.anchor[2])), self.anchor[2] + h * STEP]
        )

    @property
    def centres(self) -> Array:
        """Positions of the cells in NED [m], shape (I, J, 2)."""
        i, j = (np.arange(n) + first for n, first in zip(self.shape, self.first, strict=True))
        own = self.cell_m * np.stack(np.meshgrid(i, j, indexing="ij"), axis=-1).astype(np.float64)
        return np.asarray(self.anchor[:2] + in_ned(own, self.anchor[2]))


@dataclass(frozen=True, eq=False)
class Placed:
    """P primitives from every heading: their paths, where they lead, and where they are clear."""

    names: tuple[str, ...]
    paths: tuple[tuple[Array, ...], ...]  # P x H, (N, 3) in the frame of the lattice, absolute
    di: Integers  # (P, H)
    dj: Integers
    to: Integers
    cost: Integers
    valid: NDArray[np.bool_]  # (P, H, I, J)


def placed(
    lattice: Lattice, waters: Waters, informative: Sequence[Primitive], pace: Pace, hold: int
) -> Placed:
    """The informative primitives and then the basic ones, on a lattice."""
    by_heading = [
        [closed(one, h, lattice.cell_m, pace, hold) for one in informative]
        + [replace(one, path=turned(one.path, h * STEP)) for one in basic(h, lattice.cell_m, pace)]
        for h in range(HEADINGS)
    ]
    paths = tuple(zip(*([one.path for one in row] for row in by_heading), strict=True))
    ends = np.array([[nearest(path[-1], lattice.cell_m) for path in row] for row in paths])
    margin = STRAY * lattice.cell_m
    free = waters.free(margin)
    return Placed(
        names=tuple(one.name for one in by_heading[0]),
        paths=paths,
        di=ends[..., 0].astype(np.int64),
        dj=ends[..., 1].astype(np.int64),
        to=(ends[..., 2] % HEADINGS).astype(np.int64),
        cost=np.array([[len(path) for path in row] for row in paths], dtype=np.int64),
        valid=np.array([[_valid(lattice, free, path, margin) for path in row] for row in paths]),
    )


def _valid(lattice: Lattice, free: Any, path: Array, margin: float) -> NDArray[np.bool_]:
    """Whether a path is clear, and its end on the lattice, from every cell, shape (I, J)."""
    i, j, _ = nearest(path[-1], lattice.cell_m)
    rows, columns = np.indices(lattice.shape)
    inner = (rows + i >= 0) & (rows + i < lattice.shape[0])
    inner &= (columns + j >= 0) & (columns + j < lattice.shape[1])
    centres = lattice.centres
    track = np.vstack([np.zeros((1, 2)), path[:, :2]])
    corners = in_ned(simplified(track, margin), lattice.anchor[2])
    for corner in corners:  # cheap, and rules most out
        inner[inner] = inside(free, centres[inner] + corner)
    found = np.flatnonzero(inner)
    origins = centres.reshape(-1, 2)[found]
    for a in range(0, len(found), AT_ONCE):
        some = slice(a, a + AT_ONCE)
        inner.ravel()[found[some]] = clear(free, corners, origins[some])
    return inner
