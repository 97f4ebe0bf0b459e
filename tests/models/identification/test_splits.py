"""Splits of the training part."""

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.splits import Selection, folds, left_out_mse, split


@pytest.mark.parametrize("selection", ["blocked", "kfold"])
def test_every_sample_is_left_out_once(selection) -> None:
    found = folds(selection, 103, 5, np.random.default_rng(0))
    left = np.concatenate([out for _, out in found])
    np.testing.assert_array_equal(np.sort(left), np.arange(103))
    assert all(set(kept).isdisjoint(out) and len(kept) + len(out) == 103 for kept, out in found)


def test_rolling_origin_never_looks_ahead() -> None:
    for kept, left in folds("rolling", 100, 4, np.random.default_rng(0)):
        assert kept.max() < left.min()


@pytest.mark.parametrize("selection", ["blocked", "rolling", "kfold"])
def test_pairs_are_moments_of_the_folds(selection: Selection) -> None:
    """Sums of the parts' moments are those of the rows themselves."""
    rng = np.random.default_rng(0)
    z = np.column_stack([np.ones(61), rng.standard_normal((61, 4))])
    splits = split(selection, z[:, :3], None, 3, np.random.default_rng(1))
    moments = splits.moments(z[:, 3:])
    np.testing.assert_allclose(sum(moments), z.T @ z)
    pairs = splits.pairs(moments)
    rows = folds(selection, 61, 3, np.random.default_rng(1))
    for (kept, left), (used, out) in zip(pairs, rows, strict=True):
        np.testing.assert_allclose(kept, z[used].T @ z[used])
        np.testing.assert_allclose(left, z[out].T @ z[out])
    sizes = left_out_mse(pairs, lambda _, left: left[0, :1])
    lengths = np.array([len(out) for _, out in rows])
    assert sizes == pytest.approx(np.sum(lengths**2) / np.sum(lengths))


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(IdentificationError, match="got 9 samples for 5 folds"):
        folds("blocked", 9, 5, np.random.default_rng(0))
