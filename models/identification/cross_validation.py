"""Choosing a model order without looking at the answer: splits of the training part.

blocked  consecutive blocks, each left out once (the default: neighbours are alike)
rolling  rolling origin: each block is predicted from all that came before it
kfold    random folds; optimistic where residuals are autocorrelated
test     the held-out validation part itself, as the thesis does; not a fair figure
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.recording.recording import blocks
from seatrial.models.vessel.basis import Array

Selection = Literal["blocked", "rolling", "kfold", "test"]
Fold = tuple[NDArray[np.int64], NDArray[np.int64]]
Pair = tuple[Array, Array]  # moment matrices Z'Z of a training part and of what it leaves out


def check_folds(folds: int) -> None:
    """Refuse a cross-validation with fewer than two folds."""
    if folds < 2:
        raise ConfigurationError(f"folds must be at least 2, got {folds}")


def folds(selection: Selection, n: int, count: int, rng: np.random.Generator) -> list[Fold]:
    """(training, left out) indices of n samples; rolling and kfold are scikit-learn's splitters."""
    if n < 2 * count:
        raise IdentificationError(f"{selection} selection: got {n} samples for {count} folds")
    everything = np.arange(n)
    if selection == "blocked":
        return [(np.delete(everything, part), everything[part]) for part in blocks(n, count)]
    from sklearn.model_selection import KFold, TimeSeriesSplit  # slow to import

    if selection == "rolling":
        return list(TimeSeriesSplit(count).split(everything))
    seed = int(rng.integers(2**31))
    return list(KFold(count, shuffle=True, random_state=seed).split(everything))


class Part(NamedTuple):
    """Some of the samples: their rows, regressors with the constant, and X'X."""

    rows: NDArray[np.int64] | slice
    x: Array
    xx: Array

    def moment(self, outputs: Array) -> Array:
        """Z'Z of Z = [X, Y] for outputs of all samples (N, K)."""
        y = outputs[self.rows]
        xy = self.x.T @ y
        n, k = xy.shape
        moment = np.empty((n + k, n + k))  # np.block takes longer than the products
        moment[:n, :n], moment[:n, n:] = self.xx, xy
        moment[n:, :n], moment[n:, n:] = xy.T, y.T @ y
        return moment


def part(x: Array, rows: NDArray[np.int64] | slice) -> Part:
    """The samples of some rows; those of a slice are not copied."""
    return Part(rows, x[rows], x[rows].T @ x[rows])


@dataclass(frozen=True, eq=False)
class Splits:
    """What is trained on and what is left out, for any outputs on the same regressors.

    The parts have no sample in common and are all there is, so that the moments of a training
    part, and of the whole, are sums of theirs. `folds` are (trained on, left out), numbers of
    parts. `held_out` is Z'Z of the validation part, which only `test` looks at.
    """

    parts: tuple[Part, ...]
    folds: tuple[tuple[tuple[int, ...], int], ...]
    held_out: Array | None

    def moments(self, outputs: Array) -> list[Array]:
        """Z'Z of every part."""
        return [one.moment(outputs) for one in self.parts]

    def pairs(self, moments: list[Array]) -> list[Pair]:
        """Moments of the training part and of what is left out, of every fold."""
        if self.held_out is not None:
            return [(moments[0], self.held_out)]
        return [
            (np.asarray(sum(moments[i] for i in used)), moments[left]) for used, left in self.folds
        ]


def split(
    selection: Selection, x: Array, held_out: Array | None, count: int, rng: np.random.Generator
) -> Splits:
    """Splits of regressors x (N, 1 + J); `held_out` is Z of the validation part, for `test`."""
    if selection == "test":
        assert held_out is not None
        return Splits((part(x, slice(None)),), (), held_out.T @ held_out)
    left = [part(x, _run(rows)) for _, rows in folds(selection, len(x), count, rng)]
    if selection != "rolling":
        others = [tuple(k for k in range(len(left)) if k != fold) for fold in range(len(left))]
        return Splits(tuple(left), tuple((used, k) for k, used in enumerate(others)), None)
    first = part(x, slice(0, len(x) - sum(len(one.x) for one in left)))
    before = tuple((tuple(range(k)), k) for k in range(1, len(left) + 1))
    return Splits((first, *left), before, None)


def _run(rows: NDArray[np.int64]) -> NDArray[np.int64] | slice:
    """Rows that follow each other as a slice, which copies nothing."""
    if rows[-1] - rows[0] == len(rows) - 1 and np.all(np.diff(rows) == 1):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def left_out_mse(pairs: list[Pair], score: Callable[[Array, Array], Array]) -> Array:
    """Mean squared error over everything left out; score(training, left out) is one fold's."""
    sizes = np.array([left[0, 0] for _, left in pairs])
    return np.asarray(np.tensordot(sizes / np.sum(sizes), [score(*pair) for pair in pairs], axes=1))
