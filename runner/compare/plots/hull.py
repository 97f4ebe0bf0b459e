"""The outline of a vessel seen from above, to scale, for tracks and their animation."""

from collections.abc import Mapping
from itertools import count

import numpy as np

from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.export.manoeuvre_tracks import length_of
from seatrial.runner.vocabulary import Config

# A hull of length 1 seen from above, bow to +x: body x and y of its corners, shape (5, 2).
HULL = np.array([[0.5, 0.0], [0.2, 0.18], [-0.5, 0.18], [-0.5, -0.18], [0.2, -0.18]])
SHARE = 0.045  # of the extent of the track, the length of a hull whose vessel's is not known
LEAST_SHARE = 0.02  # of the extent, the shortest hull that shows its heading


def drawn_length(config: Config, extent_m: float) -> tuple[float, str]:
    """Return the length of the hulls [m] on a track of this extent [m], and a note on it.

    It is that of the vessel; of a vessel too short to be seen it is the smallest of 2, 5, 10, 20,
    ... lengths that can.
    """
    length = length_of(config) if isinstance(config.get("vessel"), Mapping) else None
    if length is None:
        return SHARE * max(extent_m, 1e-6), "hulls not to scale, as the length is not stored"
    times = next(m * 10**k for k in count() for m in (1, 2, 5)
                 if m * 10**k * length >= LEAST_SHARE * extent_m)  # fmt: skip
    size = "hulls to scale" if times == 1 else f"hulls {times} times as long as the vessel"
    return times * length, f"{size}: {number_text(length, 3)} m"


def outline(north: float, east: float, psi: float, length_m: float) -> Sample:
    """Return east and north of the corners of a hull [m], shape (5, 2).

    It is rotated from body to NED by psi [rad] about the down axis.
    """
    forward, right = length_m * HULL[:, 0], length_m * HULL[:, 1]
    norths = north + np.cos(psi) * forward - np.sin(psi) * right
    easts = east + np.sin(psi) * forward + np.cos(psi) * right
    return np.column_stack([easts, norths])
