"""Four formulations of one problem, against each other, another solver, and by hand."""

from typing import Any

import numpy as np
import pytest

from seatrial.models.control.horizon import (
    Horizon,
    Quadratic,
    Solver,
    condensed,
    increments,
    reduced,
    standard,
    unconstrained_gain,
)
from seatrial.models.control.linear_controller import lqi_gain
from seatrial.models.control.linear_design import design_model
from seatrial.models.vessel.basis import Array
from tests.models.control.sailing import LIMITS, ship

SQUARES = np.square(LIMITS)
WEIGHTS = {  # Bargouth (2022), the appendices; the input's in SI
    "G": ((1e4, 1e4, 1e8), (1e-5, 1e-6, 1e-15)),
    "I": ((5e2, 1e3, 1e8), (1e-6, 1e-7, 1e-16)),
    "K": ((1e2, 1e0, 1e3), (1e-7, 1e-7, 1e-10)),
    "M": ((1e3, 1e3, 1e9), (1e-10, 1e-10, 1e-9)),
    "N": ((1e2, 1e2, 1e9), (1e-9, 1e-10, 1e-9)),
    "P": ((2.2e2, 2.6e4, 1e8), (1e-7, 1e-7, 1e-15)),
    "issue": ((1e2, 1e2, 1e5), (1e-7, 1e-7, 1e-10)),
}


def problem(name: str, steps: int, period_s: float, integral: bool = False) -> Horizon:
    model = design_model(ship(), LIMITS, period_s).model
    model = model.with_integral_action() if integral else model
    q, p = WEIGHTS[name]
    return Horizon(model.A, model.B, model.C, np.diag(q), np.diag(p * SQUARES), steps)


def drawn(h: Horizon, rng: np.random.Generator, size: float = 1.0) -> Array:
    """Random parameters of the size of a move of a few metres."""
    theta = np.zeros(h.width)
    state, reference, known, last = h.parameters
    theta[state] = rng.normal(size=h.sizes[0]) * np.resize([5, 5, 0.1, 0.2, 0.2, 0.003], h.sizes[0])
    theta[reference] = np.tile(rng.normal(size=3) * [10.0, 10.0, 0.2], h.steps)
    theta[known] = 0.1 * rng.normal(size=h.steps * 3)
    theta[last] = rng.uniform(-0.9, 0.9, 3)
    return size * theta


def oracle(h: Horizon, form: Quadratic, theta: Array) -> Array:
    """The same problem by quadprog: min 1/2 z'Hz - a'z, C'z >= b, the first rows equalities."""
    quadprog: Any = pytest.importorskip("quadprog")
    rows = np.vstack([np.eye(len(form.H))[: form.simple], form.rows])
    middle = form.shift @ theta
    C = np.vstack([rows, -rows]).T
    b = np.concatenate([middle - form.bound, -(middle + form.bound)])
    return np.asarray(quadprog.solve_qp(form.H, -form.f @ theta, C, b)[0])


def cost(h: Horizon, u: Array, theta: Array) -> float:
    """J, step by step from its definition."""
    state, reference, known, _ = h.parameters
    x, r, d = theta[state], theta[reference].reshape(h.steps, -1), theta[known].reshape(h.steps, -1)
    total = 0.0
    for i, command in enumerate(u.reshape(h.steps, -1)):
        x = h.A @ x + h.B @ (command + d[i])
        e = h.C @ x - r[i]
        total += 0.5 * float(e @ h.Q @ e + command @ h.P @ command)
    return total


def test_the_condensed_cost_is_the_cost() -> None:
    """1/2 u'Hu + f'u differs from J by what does not depend on u."""
    for integral in (False, True):
        h = problem("issue", 8, 1.0, integral)
        rng = np.random.default_rng(0)
        theta, form = drawn(h, rng), condensed(h)
        f = form.f @ theta
        offsets = []
        for _ in range(5):
            u = rng.normal(size=len(f))
            offsets.append(cost(h, u, theta) - float(0.5 * u @ form.H @ u + f @ u))
        np.testing.assert_allclose(offsets, offsets[0], rtol=1e-9)


@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize(("steps", "period_s"), [(10, 1.0), (10, 10.0), (40, 1.0)])
def test_without_limits_the_formulations_agree(name: str, steps: int, period_s: float) -> None:
    h = problem(name, steps, period_s)
    expected = unconstrained_gain(h, condensed(h))
    for form in (standard(h), reduced(h)):
        difference = np.max(np.abs(unconstrained_gain(h, form) - expected))
        assert difference <= 1e-8 * np.max(np.abs(expected))


@pytest.mark.parametrize("name", WEIGHTS)
def test_within_limits_the_formulations_agree(name: str) -> None:
    h = problem(name, 10, 1.0)
    forms = (standard(h), reduced(h), condensed(h))
    solvers = [Solver(form) for form in forms]
    rng, limited = np.random.default_rng(1), 0
    for size in (0.02, 0.3, 1.0, 1.0, 10.0, 30.0):
        theta = drawn(h, rng, size)
        found = [solver.solve(theta) for solver in solvers]
        u = [z[: 3 * h.steps] for z in found if z is not None]
        assert len(u) == 3
        np.testing.assert_allclose(u[0], u[2], atol=1e-6)
        np.testing.assert_allclose(u[1], u[2], atol=1e-6)
        np.testing.assert_allclose(u[2], oracle(h, forms[2], theta), atol=1e-6)
        assert np.max(np.abs(u[2])) <= 1.0 + 1e-8
        limited += bool(np.max(np.abs(u[2])) > 1.0 - 1e-8)
    assert limited >= 1  # the limits were met


@pytest.mark.parametrize("rate", [None, (0.05, 0.02, 0.1)])
def test_increments_agree_with_the_oracle(rate: tuple[float, ...] | None) -> None:
    h = problem("issue", 20, 1.0, integral=True)
    h = Horizon(h.A, h.B, h.C, h.Q, h.P, h.steps, None if rate is None else np.array(rate))
    form = increments(h)
    solver, rng = Solver(form), np.random.default_rng(2)
    for size in (0.1, 1.0, 1.0, 3.0):
        theta = drawn(h, rng, size)
        theta[h.parameters[3]] = rng.uniform(-0.9, 0.9, 3)
        found = solver.solve(theta)
        assert found is not None
        np.testing.assert_allclose(found, oracle(h, form, theta), atol=1e-6)
        u = theta[h.parameters[3]] + np.cumsum(found.reshape(-1, 3), axis=0)
        assert np.max(np.abs(u)) <= 1.0 + 1e-8
        if rate is not None:
            assert np.all(np.abs(found.reshape(-1, 3)) <= np.array(rate) + 1e-8)


def test_a_long_horizon_is_the_regulator() -> None:
    """As N grows the increments become those of LQ control with integral action."""
    model = design_model(ship(), LIMITS, 1.0).model
    h = problem("issue", 150, 1.0, integral=True)
    gain = unconstrained_gain(h, increments(h))[:, h.parameters[0]]
    np.testing.assert_allclose(gain, lqi_gain(model, h.Q, h.P), rtol=2e-3, atol=1e-5)
