"""Packs of numbers against NumPy, lane by lane."""

import operator
from typing import Any

import numpy as np
import pytest

from seatrial.models.compiled import kernel
from seatrial.models.elementary import where
from seatrial.models.packs import WIDTH, as_packs

ROWS = 200
BINARY = ("add", "sub", "mul", "truediv")
COMPARISONS = ("lt", "le", "gt", "ge", "eq", "ne")


@kernel
def _arithmetic(x: Any, y: Any, result: Any) -> None:
    a, b, out = as_packs(x), as_packs(y), as_packs(result)
    for i in range(a.shape[0]):
        out[i, 0], out[i, 1] = a[i] + b[i], a[i] - b[i]
        out[i, 2], out[i, 3] = a[i] * b[i], a[i] / b[i]


@kernel
def _comparisons(x: Any, y: Any, result: Any) -> None:
    a, b, out = as_packs(x), as_packs(y), as_packs(result)
    for i in range(a.shape[0]):
        out[i, 0], out[i, 1] = where(a[i] < b[i], 1.0, 0.0), where(a[i] <= b[i], 1.0, 0.0)
        out[i, 2], out[i, 3] = where(a[i] > b[i], 1.0, 0.0), where(a[i] >= b[i], 1.0, 0.0)
        out[i, 4], out[i, 5] = where(a[i] == b[i], 1.0, 0.0), where(a[i] != b[i], 1.0, 0.0)


@kernel
def _functions(x: Any, y: Any, result: Any) -> None:
    a, b, out = as_packs(x), as_packs(y), as_packs(result)
    for i in range(a.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = abs(a[i]), np.sqrt(abs(a[i])), np.floor(a[i])
        out[i, 3], out[i, 4], out[i, 5] = np.cos(a[i]), np.sin(a[i]), np.arctan2(b[i], a[i])
        out[i, 6], out[i, 7] = -a[i], where(a[i] < b[i], a[i], b[i])
        out[i, 8] = np.exp(-abs(a[i]))


@kernel
def _with_numbers(x: Any, number: float, result: Any) -> None:
    a, out = as_packs(x), as_packs(result)
    for i in range(a.shape[0]):
        total = 0.0
        for power in range(3):
            total += power * a[i]
        total -= number
        out[i, 0], out[i, 1] = total, 1 / (2.0 + a[i] * a[i])
        out[i, 2] = number
        out[i, 2] *= a[i]


@kernel
def _view_of_what_is_dropped(rows: int) -> Any:
    """Only the view holds the buffer, while others are made and dropped."""
    view = as_packs(np.full((rows, WIDTH), 3.0))
    result, total = np.zeros((1, WIDTH)), 0.0
    for i in range(rows):
        other = np.full((rows, WIDTH), 7.0)
        total += view[i] + 0.0 * other[0, 0]
    as_packs(result)[0] = total
    return result


@pytest.fixture
def numbers() -> np.ndarray:
    """Two arrays of packs of every size and sign, with some equal, infinite and NaN."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, ROWS, WIDTH)) * 10.0 ** rng.integers(-5, 6, (2, ROWS, WIDTH))
    y[::7] = x[::7]
    x[3, ::2], y[5, ::3] = np.nan, np.nan
    x[11, ::2], y[13] = np.inf, -np.inf
    return np.array([x, y])


def test_arithmetic_is_that_of_numbers(numbers: np.ndarray) -> None:
    result = np.empty((ROWS, 4, WIDTH))
    _arithmetic(*numbers, result)
    with np.errstate(invalid="ignore"):
        expected = [getattr(operator, name)(*numbers) for name in BINARY]
    np.testing.assert_array_equal(result, np.stack(expected, axis=1))


def test_comparisons_are_those_of_numbers(numbers: np.ndarray) -> None:
    result = np.empty((ROWS, 6, WIDTH))
    _comparisons(*numbers, result)
    expected = [getattr(operator, name)(*numbers) for name in COMPARISONS]
    np.testing.assert_array_equal(result, np.stack(expected, axis=1))


def test_functions_are_those_of_numpy(numbers: np.ndarray) -> None:
    x, y = np.where(np.isfinite(numbers), numbers, 1.0)
    result = np.empty((ROWS, 9, WIDTH))
    _functions(x, y, result)
    exact = [np.abs(x), np.sqrt(np.abs(x)), np.floor(x)]
    np.testing.assert_array_equal(result[:, :3], np.stack(exact, axis=1))
    np.testing.assert_allclose(result[:, 3], np.cos(x), rtol=0.0, atol=2.3e-16)
    np.testing.assert_allclose(result[:, 4], np.sin(x), rtol=0.0, atol=2.3e-16)
    np.testing.assert_allclose(result[:, 5], np.arctan2(y, x), rtol=4.5e-16)
    np.testing.assert_array_equal(result[:, 6:8], np.stack([-x, np.minimum(x, y)], axis=1))
    np.testing.assert_allclose(result[:, 8], np.exp(-np.abs(x)), rtol=1e-15)


def test_a_number_beside_a_pack_stands_for_equal_ones(numbers: np.ndarray) -> None:
    x = np.where(np.isfinite(numbers[0]), numbers[0], 1.0)
    result = np.empty((ROWS, 3, WIDTH))
    _with_numbers(x, 0.7, result)
    expected = [0.0 * x + x + 2.0 * x - 0.7, 1.0 / (2.0 + x * x), 0.7 * x]
    np.testing.assert_array_equal(result, np.stack(expected, axis=1))


def test_a_view_keeps_its_buffer() -> None:
    np.testing.assert_array_equal(_view_of_what_is_dropped(500), np.full((1, WIDTH), 1500.0))
