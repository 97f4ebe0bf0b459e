"""A step that is called through its address does what it does when it is called by name."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError
from numba.extending import overload

from seatrial.models.bound import ROW, Bound, bound, entry, is_lean
from seatrial.models.compiled import LEAN, kernel, lean_kernel, tuple_of


class Gain(NamedTuple):
    """A step that scales."""

    gain: float


class Sum(NamedTuple):
    """A step that adds a row, and notes a number of calls."""

    row: Any
    calls: Any


@lean_kernel
def scale(step: Gain, x: Any) -> None:
    for i in range(x.shape[0]):
        x[i] *= step.gain


@lean_kernel
def add(step: Sum, x: Any) -> None:
    step.calls[0] += 1.0
    for i in range(x.shape[0]):
        x[i] += step.row[i]


STEPS: dict[type, Any] = {Gain: scale, Sum: add}


def apply(step: Any, x: Any) -> None:
    STEPS[type(step)](step, x)


@overload(apply, jit_options=LEAN)
def _apply(step: Any, x: Any) -> Any:
    chosen = STEPS[tuple_of(step)]

    def call(step: Any, x: Any) -> None:
        chosen(step, x)

    return call


_bind, _call = entry(apply, ROW)


@kernel
def bind(memory: Any, parts: Any) -> int:
    return _bind(memory, parts)  # type: ignore[no-any-return]


@kernel
def repeat(step: Bound, x: Any, times: int) -> None:
    for _ in range(times):
        _call(step.address, step.memory, (x,))


def test_one_loop_calls_steps_of_any_type_and_sees_their_arrays() -> None:
    row, calls, x = np.array([1.0, 2.0]), np.zeros(1), np.array([3.0, 5.0])
    gain, total = bound(bind, Gain(2.0)), bound(bind, Sum(row, calls))
    repeat(gain, x, 2)
    row[0] = 10.0
    repeat(total, x, 3)
    assert x.tolist() == [3.0 * 4.0 + 30.0, 5.0 * 4.0 + 6.0]
    assert calls[0] == 3.0
    assert len(repeat.overloads) == 1  # type: ignore[attr-defined]


def test_other_arguments_are_refused() -> None:
    with pytest.raises(TypingError, match="a bound step: got"):
        repeat(bound(bind, Gain(2.0)), np.zeros((2, 2)), 1)


def test_steps_that_count_references_are_not_bound() -> None:
    assert is_lean(scale)
    assert not is_lean(bind)
    assert not is_lean(apply)
