"""Choosing a model order without looking at the answer: splits of the training part.

blocked  consecutive blocks, each left out once (the default: neighbours are alike)
rolling  rolling origin: each block is predicted from all that came before it
kfold    random folds; optimistic where residuals are autocorrelated
test     the held-out validation part itself, as the thesis does; not a fair figure
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.basis import Array
from models.errors import ConfigurationError, IdentificationError
from models.recording import blocks

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


def moment_pairs(
    selection: Selection, z: Array, held_out: Array | None, count: int, rng: np.random.Generator
) -> list[Pair]:
    """Moments of the training part and of what is left out, of every fold of Z (N, m).

    `held_out` is Z of the validation part, which only `test` uses.
    """
    if selection == "test":
        assert held_out is not None
        return [(z.T @ z, held_out.T @ held_out)]
    splits = folds(selection, len(z), count, rng)
    return [(z[kept].T @ z[kept], z[left].T @ z[left]) for kept, left in splits]


def left_out_mse(pairs: list[Pair], score: Callable[[Array, Array], Array]) -> Array:
    """Mean squared error over everything left out; score(training, left out) is one fold's."""
    sizes = np.array([left[0, 0] for _, left in pairs])
    return np.asarray(np.tensordot(sizes / np.sum(sizes), [score(*pair) for pair in pairs], axes=1))
