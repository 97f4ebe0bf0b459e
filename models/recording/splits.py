"""Which samples an identifier may learn from: masks over the samples of one recording.

Neighbouring samples of a motion are alike, so a random split tests on what was learnt. All splits
here cut in time, and the cross-validating ones can leave a gap between training and testing.
"""

from collections.abc import Collection
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array

Mask = NDArray[np.bool_]


class Split(NamedTuple):
    """Masks over the samples, shape (N,): disjoint, not necessarily covering."""

    train: Mask
    test: Mask


def half(n: int, fraction: float = 0.5) -> Split:
    """The first `fraction` of n samples for training, the rest for testing."""
    if not 0.0 < fraction < 1.0:
        raise ConfigurationError(f"train_fraction must lie between 0 and 1, got {fraction:g}")
    train = np.arange(n) < fraction * n - 1e-9
    return Split(train, ~train)


def trips(t: Array, starts_s: Collection[float]) -> NDArray[np.int64]:
    """The trip of each sample, counted from 1; samples before the first start are trip 0.

    A trip begins at its start [s] and lasts until the next one. Starts must increase.
    """
    starts = np.array(list(starts_s), dtype=np.float64)
    if np.any(np.diff(starts) <= 0.0):
        raise ConfigurationError(f"trip_starts_s must increase, got {starts.tolist()}")
    return np.searchsorted(starts, t, side="right").astype(np.int64)


def by_trips(trip: NDArray[np.int64], training: Collection[int]) -> Split:
    """The `training` trips against the others; samples before the first trip are in neither.

    Jervan (2020), section 5.3: trips 1 and 3 for training, 2 and 4 for testing, so that weather
    that changed on the way is in both.
    """
    chosen = np.isin(trip, list(training))
    split = Split(chosen & (trip > 0), ~chosen & (trip > 0))
    if not np.any(split.train) or not np.any(split.test):
        raise ConfigurationError(
            f"training_trips must leave trips to train and to test with, got {list(training)} of "
            f"trips {np.unique(trip[trip > 0]).tolist()}"
        )
    return split


def rolling_origin(n: int, count: int, gap: int = 0) -> tuple[Split, ...]:
    """`count` splits that train on the past and test on the next of count + 1 equal blocks.

    `gap` samples before each test block are left out.
    """
    edges = _edges(n, count + 1, gap)
    k = np.arange(n)
    return tuple(
        Split(k < start - gap, (start <= k) & (k < end)) for start, end in pairwise(edges[1:])
    )


def blocked_k_fold(n: int, count: int, gap: int = 0) -> tuple[Split, ...]:
    """`count` splits that test on one block each and train on the others.

    `gap` samples on both sides of the test block are left out.
    """
    k = np.arange(n)
    return tuple(
        Split((k < start - gap) | (k >= end + gap), (start <= k) & (k < end))
        for start, end in pairwise(_edges(n, count, gap))
    )


def _edges(n: int, count: int, gap: int) -> list[int]:
    """Edges of `count` blocks that cover n samples; each block must be longer than the gap."""
    if count < 2 or gap < 0 or n // count <= gap:
        raise ConfigurationError(
            f"cannot cut {n} samples into {count} blocks with a gap of {gap}, "
            f"expected at least 2 blocks that are longer than the gap"
        )
    return [int(edge) for edge in np.linspace(0, n, count + 1).round()]
