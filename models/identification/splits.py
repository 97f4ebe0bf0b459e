"""Splits of the training part for the choice of a model order.

blocked  consecutive blocks, each left out once (the default: neighbouring samples are correlated)
rolling  rolling origin: each block is predicted from all samples before it
kfold    random folds; optimistic if the residuals are autocorrelated
test     the held-out validation part itself, as in the thesis; its error is too optimistic
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import IdentificationError
from seatrial.models.recording.recording import blocks
from seatrial.models.vessel.basis import Array

Selection = Literal["blocked", "rolling", "kfold", "test"]
Fold = tuple[NDArray[np.int64], NDArray[np.int64]]
Pair = tuple[Array, Array]  # moment matrices Z'Z of a training part and of what it leaves out


def folds(
    selection: Selection,
    n: int,
    count: int,
    rng: np.random.Generator,
    file: NDArray[np.int64] | None = None,
) -> list[Fold]:
    """Indices (training, left out) of n samples for each of `count` folds.

    Blocks are files where the samples are of several, by their numbers `file` (N,).

    `rolling` and `kfold` are scikit-learn's splitters. Raises IdentificationError when there are
    fewer than two samples per fold.
    """
    if n < 2 * count:
        raise IdentificationError(
            f"{selection} selection: got {n} samples for {count} folds, expected at least "
            f"{2 * count}"
        )
    indices = np.arange(n)
    if selection == "blocked":
        return [(np.delete(indices, part), indices[part]) for part in blocks(n, count, file)]
    from sklearn.model_selection import KFold, TimeSeriesSplit  # slow to import

    if selection == "rolling":
        return list(TimeSeriesSplit(count).split(indices))
    seed = int(rng.integers(2**31))
    return list(KFold(count, shuffle=True, random_state=seed).split(indices))


class Subset(NamedTuple):
    """A subset of the samples: its rows, regressors with the constant, and X'X."""

    rows: NDArray[np.int64] | slice
    x: Array
    xx: Array

    def moment(self, outputs: Array) -> Array:
        """Z'Z of Z = [X, Y] for outputs of all samples (N, K)."""
        y = outputs[self.rows]
        xy = self.x.T @ y
        n, k = xy.shape
        moment = np.empty((n + k, n + k))  # np.block would take longer than the products
        moment[:n, :n], moment[:n, n:] = self.xx, xy
        moment[n:, :n], moment[n:, n:] = xy.T, y.T @ y
        return moment


def part(x: Array, rows: NDArray[np.int64] | slice) -> Subset:
    """The subset of the given rows; the rows of a slice are not copied."""
    return Subset(rows, x[rows], x[rows].T @ x[rows])


@dataclass(frozen=True, eq=False)
class Splits:
    """Training and left-out parts for any outputs on the same regressors.

    The parts are disjoint and cover all samples, so the moments of a training part, and of all
    samples, are sums of the moments of the parts. `folds` are (training, left out) as indices of
    parts. `held_out` is Z'Z of the validation part, used only by `test`.
    """

    parts: tuple[Subset, ...]
    folds: tuple[tuple[tuple[int, ...], int], ...]
    held_out: Array | None

    def moments(self, outputs: Array) -> list[Array]:
        """Z'Z of every part."""
        return [part.moment(outputs) for part in self.parts]

    def pairs(self, moments: list[Array]) -> list[Pair]:
        """Moments of the training part and of the left-out part of every fold."""
        if self.held_out is not None:
            return [(moments[0], self.held_out)]
        return [
            (np.asarray(sum(moments[i] for i in used)), moments[left]) for used, left in self.folds
        ]


def split(
    selection: Selection,
    x: Array,
    held_out: Array | None,
    count: int,
    rng: np.random.Generator,
    file: NDArray[np.int64] | None = None,
) -> Splits:
    """Splits of regressors x (N, 1 + J); `held_out` is Z of the validation part, for `test`."""
    if selection == "test":
        assert held_out is not None
        return Splits((part(x, slice(None)),), (), held_out.T @ held_out)
    left = [part(x, _as_slice(rows)) for _, rows in folds(selection, len(x), count, rng, file)]
    if selection != "rolling":
        others = [tuple(k for k in range(len(left)) if k != fold) for fold in range(len(left))]
        return Splits(tuple(left), tuple((used, k) for k, used in enumerate(others)), None)
    first = part(x, slice(0, len(x) - sum(len(item.x) for item in left)))
    before = tuple((tuple(range(k)), k) for k in range(1, len(left) + 1))
    return Splits((first, *left), before, None)


def _as_slice(rows: NDArray[np.int64]) -> NDArray[np.int64] | slice:
    """Consecutive rows as a slice, which avoids a copy."""
    if rows[-1] - rows[0] == len(rows) - 1 and np.all(np.diff(rows) == 1):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def left_out_mse(pairs: list[Pair], score: Callable[[Array, Array], Array]) -> Array:
    """Mean squared error over all left-out samples; score(training, left out) gives one fold's."""
    sizes = np.array([left[0, 0] for _, left in pairs])
    return np.asarray(np.tensordot(sizes / np.sum(sizes), [score(*pair) for pair in pairs], axes=1))
