"""The solver: small problems by hand, and problems without an answer."""

import numpy as np
import pytest

from seatrial.models.control.horizon import Quadratic, Solver
from seatrial.models.vessel.basis import Array


def boxed(shift: Array | None = None) -> Quadratic:
    """1/2 |z|^2 + theta' z with |z| <= 1: z = -theta, cut at the bounds."""
    width = 2 if shift is None else 3
    f = np.eye(2, width)
    rows = np.zeros((0, 2)) if shift is None else np.ones((1, 2))
    shifted = np.zeros((2, width)) if shift is None else np.vstack([np.zeros((2, 3)), shift])
    return Quadratic(np.eye(2), f, rows, shifted, np.ones(len(shifted)), 2)


@pytest.mark.parametrize(
    ("theta", "expected"),
    [((0.2, -0.3), (-0.2, 0.3)), ((5.0, 0.1), (-1.0, -0.1)), ((-9.0, 9.0), (1.0, -1.0))],
)
def test_a_box_is_solved_by_hand(theta: tuple[float, float], expected: tuple[float, float]) -> None:
    solver = Solver(boxed())
    for _ in range(3):  # warm as cold
        np.testing.assert_allclose(solver.solve(np.array(theta)), expected, atol=1e-9)


def test_an_equality_with_a_singular_cost_is_solved_exactly() -> None:
    """min 1/2 z1^2 with z1 + z2 = theta: z1 = 0."""
    H = np.diag([1.0, 0.0])
    problem = Quadratic(
        H, np.zeros((2, 1)), np.ones((1, 2)), np.array([[0.0], [1.0]]), np.array([9.0, 0.0]), 1
    )
    assert problem.equal.tolist() == [False, True]
    np.testing.assert_allclose(Solver(problem).solve(np.array([3.0])), [0.0, 3.0], atol=1e-9)


def test_no_answer_is_none_and_the_next_is_right_again() -> None:
    """|z1 + z2 - theta_3| <= 1 within the box has no solution when theta_3 is 5."""
    solver = Solver(boxed(np.array([[0.0, 0.0, 1.0]])))
    easy = np.array([0.1, 0.1, 0.0])
    for hard in ([0.1, 0.1, 5.0], [np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, np.nan]):
        np.testing.assert_allclose(solver.solve(easy), [-0.1, -0.1], atol=1e-9)
        assert solver.solve(np.array(hard)) is None
        np.testing.assert_allclose(solver.solve(easy), [-0.1, -0.1], atol=1e-9)
