"""Subspace identification: what does not depend on the choice of states, against the truth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.models.errors import IdentificationError
from seatrial.models.identification import residual
from seatrial.models.identification.subspace import (
    identify_innovations,
    observer_gain,
    realise,
    with_gain,
)
from seatrial.models.simulation.statespace import StateSpace

LAGS = 20


def random_plant(rng: np.random.Generator) -> StateSpace:
    """A stable 3 x 3 plant of three modes of magnitude 0.5 to 0.95, without a direct term."""
    A = np.zeros((6, 6))
    for i, (radius, angle) in enumerate(rng.uniform([0.5, 0.0], [0.95, 0.5 * np.pi], (3, 2))):
        c, s = radius * np.cos(angle), radius * np.sin(angle)
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[c, s], [-s, c]]
    turn = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    B, C = rng.standard_normal((6, 3)), rng.standard_normal((3, 6))
    return StateSpace(turn @ A @ turn.T, B, C, np.zeros((3, 3)), 1.0)


def kalman_gain(model: StateSpace, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """The predictor's gain, from the Riccati equation."""
    from scipy.linalg import solve_discrete_are

    P = solve_discrete_are(model.A.T, model.C.T, Q, R)
    return np.linalg.solve(model.C @ P @ model.C.T + R, (model.A @ P @ model.C.T).T).T


def open_loop(
    model: StateSpace, n: int, noise: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outputs, inputs and innovations of a model on innovations form, under white inputs."""
    u, e = rng.standard_normal((n, model.B.shape[1])), rng.standard_normal((n, len(model.C)))
    B = np.hstack([model.B, noise * model.K])
    D = np.hstack([model.D, noise * np.eye(len(model.C))])
    joint = replace(model, B=B, D=D, inputs=())
    return joint.simulate(np.hstack([u, e])), u, noise * e


@cache
def closed_loop(seed: int, n: int) -> tuple[np.ndarray, np.ndarray, StateSpace]:
    """LQ feedback from a Kalman filter, a random binary signal on the input, strong noise.

    Process and measurement noise of covariance 3; the plant returned has the true K.
    """
    from scipy.linalg import solve_discrete_are

    rng = np.random.default_rng(seed)
    plant = random_plant(rng)
    Q, R, weight = 3.0 * np.eye(6), 3.0 * np.eye(3), 0.1 * np.eye(3)
    P = solve_discrete_are(plant.A, plant.B, plant.C.T @ plant.C, weight)
    feedback = np.linalg.solve(weight + plant.B.T @ P @ plant.B, plant.B.T @ P @ plant.A)
    K = kalman_gain(plant, Q, R)
    process = np.sqrt(3.0) * rng.standard_normal((n, 6))
    noise = np.sqrt(3.0) * rng.standard_normal((n, 3))
    binary = np.sign(rng.standard_normal((n, 3)))
    x, estimate = np.zeros(6), np.zeros(6)
    y, u = np.empty((n, 3)), np.empty((n, 3))
    for k in range(n):
        y[k] = plant.C @ x + noise[k]
        u[k] = binary[k] - feedback @ estimate
        estimate = plant.A @ estimate + plant.B @ u[k] + K @ (y[k] - plant.C @ estimate)
        x = plant.A @ x + plant.B @ u[k] + process[k]
    return y, u, replace(plant, K=K)


def markov_error(found: StateSpace, truth: StateSpace) -> float:
    expected = truth.markov(LAGS + 1)[1:]
    return float(np.linalg.norm(found.markov(LAGS + 1)[1:] - expected) / np.linalg.norm(expected))


def by_size(model: StateSpace) -> np.ndarray:
    return np.sort_complex(model.eigenvalues)


@pytest.mark.parametrize("variant", ["open", "closed"])
@pytest.mark.parametrize("order", [6, None])
@settings(max_examples=10)
@given(seed=st.integers(0, 10_000))
def test_without_noise_both_variants_are_exact(variant: str, order: int | None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_plant(rng)
    u, start = rng.standard_normal((600, 3)), rng.standard_normal(6)
    y = truth.simulate(u, start)
    found = identify_innovations(y, u, 8, 10, order, variant, period_s=0.5)  # type: ignore[arg-type]
    model = found.model
    assert model.order == 6
    np.testing.assert_allclose(by_size(model), by_size(truth), atol=1e-8)
    np.testing.assert_allclose(model.markov(40), truth.markov(40), atol=1e-8)
    np.testing.assert_allclose(model.simulate(u), y, atol=1e-7)  # and so x0 is right
    assert found.gain_recomputed  # without noise there is nothing to take K from
    assert model.predictor_radius < 1.0
    assert model.period_s == 0.5


def test_without_noise_a_direct_term_is_found(rng) -> None:
    truth = replace(random_plant(rng), D=rng.standard_normal((3, 3)))
    u = rng.standard_normal((600, 3))
    found = identify_innovations(truth.simulate(u), u, 8, 10, None, "open", feedthrough=True)
    np.testing.assert_allclose(found.model.markov(40), truth.markov(40), atol=1e-8)


@pytest.mark.parametrize("variant", ["open", "closed"])
def test_inputs_and_outputs_of_any_size_and_an_integrator(variant: str, rng) -> None:
    """A ship: forces of 1e5 N and 1e7 Nm, metres and radians, poles at 1."""
    A = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.99, 0.0, 0.0], [0, 0, 1, 1], [0, 0.001, 0, 0.98]])
    B = np.array([[0.5, 0.0], [1.0, 0.0], [0.0, 0.5], [0.0, 1.0]]) @ np.diag([1e-7, 1e-11])
    truth = StateSpace(A, B, np.eye(4)[[0, 2]], np.zeros((2, 2)), 1.0)
    u = rng.standard_normal((800, 2)) * [1e5, 1e7]
    found = identify_innovations(truth.simulate(u), u, 8, 10, 4, variant)  # type: ignore[arg-type]
    expected = truth.markov(20)
    np.testing.assert_allclose(found.model.markov(20), expected, rtol=1e-6, atol=1e-18)
    assert found.model.predictor_radius < 1.0


@pytest.mark.parametrize("variant", ["open", "closed"])
def test_gaps_in_the_data_are_not_bridged(variant: str, rng) -> None:
    truth = random_plant(rng)
    parts = [rng.standard_normal((n, 3)) for n in (300, 25, 400)]
    y = np.vstack([truth.simulate(u, rng.standard_normal(6)) for u in parts])
    stretch = np.repeat([0, 1, 2], [300, 25, 400])
    u = np.vstack(parts)
    found = identify_innovations(y, u, 8, 10, 6, variant, stretch=stretch)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.model.markov(40), truth.markov(40), atol=1e-8)
    bridged = identify_innovations(y, u, 8, 10, 6, variant)  # type: ignore[arg-type]
    assert markov_error(bridged.model, truth) > 1e-3


def test_the_noise_model_is_found_in_open_loop(rng) -> None:
    plant = random_plant(rng)
    truth = replace(plant, K=kalman_gain(plant, np.eye(6), np.eye(3)))
    y, u, e = open_loop(truth, 8000, 0.5, rng)
    for variant in ("open", "closed"):
        found = identify_innovations(y, u, 6, 20, 6, variant)  # type: ignore[arg-type]
        model = found.model
        assert markov_error(model, truth) < 0.05
        noise = [replace(m, B=m.K, D=np.eye(3), inputs=()) for m in (model, truth)]
        assert markov_error(*noise) < 0.15
        np.testing.assert_allclose(model.F @ model.F.T, np.cov(e.T), atol=0.02)
        assert np.all(np.triu(model.F, 1) == 0.0)
        assert not found.gain_recomputed


def errors_of(n: int, variant: str) -> list[float]:
    """Markov errors on closed-loop data of six random plants."""
    errors = []
    for seed in range(6):
        y, u, plant = closed_loop(seed, n)
        found = identify_innovations(y, u, 6, 20, 6, variant)  # type: ignore[arg-type]
        assert found.model.predictor_radius < 1.0
        errors.append(markov_error(found.model, plant))
    return errors


def test_feedback_biases_the_open_variant_and_not_the_closed_one() -> None:
    """The bias stays however long the record: open is no better with four times the samples."""
    closed, opened = (
        {n: float(np.median(errors_of(n, variant))) for n in (1000, 4000)}
        for variant in ("closed", "open")
    )
    assert closed[4000] < 0.7 * closed[1000]
    assert closed[4000] < 0.5 * opened[4000]
    assert opened[4000] > 0.7 * opened[1000]


def test_a_gain_without_a_stable_predictor_is_recomputed(rng) -> None:
    """Innovations that K over-corrects have the spectrum of a stable predictor's."""
    plant = random_plant(rng)
    truth = replace(plant, K=kalman_gain(plant, np.eye(6), np.eye(3)))
    loud = replace(truth, K=-6.0 * truth.K)
    assert loud.predictor_radius > 1.0
    y, u, _ = open_loop(loud, 8000, 0.3, rng)
    for variant in ("open", "closed"):
        found = identify_innovations(y, u, 6, 20, 6, variant)  # type: ignore[arg-type]
        assert found.model.predictor_radius < 1.0
        assert markov_error(found.model, truth) < 0.1


def test_a_state_that_no_output_shows_has_no_stable_predictor() -> None:
    hidden = StateSpace(np.diag([0.5, 1.1]), np.eye(2), np.eye(1, 2), np.zeros((1, 2)), 1.0)
    with pytest.raises(IdentificationError, match=r"no stable predictor: .* radius 1\.1"):
        observer_gain(hidden.A, hidden.C)


def random_matrices(seed: int, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (5, 5) of a spectral radius, C (2, 5) and a K (5, 2) that is nothing in particular."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5))
    A *= radius / np.max(np.abs(np.linalg.eigvals(A)))
    return A, rng.standard_normal((2, 5)), 3.0 * rng.standard_normal((5, 2))


@given(seed=st.integers(0, 10_000))
def test_the_stable_gain_has_the_spectrum_of_the_noise(seed: int) -> None:
    """H R H* = H' R' H'* on the unit circle, so H'^-1 H R (H'^-1 H)* does not vary along it."""
    A, C, K = random_matrices(seed, 0.9)
    model = StateSpace(A, np.ones((5, 1)), C, np.zeros((2, 1)), 1.0)
    e = np.random.default_rng(seed).standard_normal((50, 2))
    found, recomputed = with_gain(model, K, e)
    R = e.T @ e / len(e)
    products = []
    for z in np.exp(1j * np.linspace(0.0, np.pi, 7)):
        inner = np.linalg.inv(z * np.eye(5) - A)
        old, new = np.eye(2) + C @ inner @ K, np.eye(2) + C @ inner @ found.K
        ratio = np.linalg.solve(new, old)
        products.append(ratio @ R @ ratio.conj().T)
    assert recomputed == (np.max(np.abs(np.linalg.eigvals(A - K @ C))) >= 1.0)
    np.testing.assert_allclose(products, [products[0]] * 7, rtol=1e-3, atol=1e-3 * np.trace(R))


def test_a_stable_model_of_an_integrator_under_noise(rng) -> None:
    """Too high an order gives poles outside the unit circle, and a simulation that explodes."""
    truth = StateSpace(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), 1.0)
    u = rng.standard_normal((300, 1))
    y = truth.simulate(u) + 0.5 * rng.standard_normal((300, 1))
    moved = 0
    for variant in ("open", "closed"):
        free = identify_innovations(y, u, 8, 10, 8, variant)  # type: ignore[arg-type]
        kept = identify_innovations(y, u, 8, 10, 8, variant, stable=True)  # type: ignore[arg-type]
        assert free.poles_moved == 0
        assert kept.poles_moved == np.count_nonzero(np.abs(free.model.eigenvalues) > 1.0)
        assert kept.model.spectral_radius < 1.0 + 1e-9
        assert kept.model.predictor_radius < 1.0
        far = np.abs(kept.model.simulate(np.zeros((20_000, 1))))
        assert np.max(far) < 1e6
        moved += kept.poles_moved
    assert moved > 0


def test_the_order_is_the_largest_gap() -> None:
    for values, order in (
        ([69.9, 15.0, 3.7, 2.0, 0.30, 0.21, 0.17], 4),
        ([5.0, 2.0, 1e-14, 1e-19], 2),  # rounding has no gaps
    ):
        future = np.vstack([np.diag(values), np.zeros((1, len(values)))])
        assert len(realise(future, 1, None, stable=False)[0]) == order


def test_a_resampled_record_gives_the_same_model_without_noise(rng) -> None:
    truth = random_plant(rng)
    u = rng.standard_normal((600, 3))
    y = truth.simulate(u)
    blocks = np.array_split(np.arange(600), 20)
    times = np.concatenate([blocks[i] for i in rng.integers(20, size=20)])
    found = identify_innovations(y, u, 8, 10, 6, "closed", times=times)
    np.testing.assert_allclose(found.model.markov(40), truth.markov(40), atol=1e-8)


@pytest.mark.parametrize("variant", ["open", "closed"])
def test_a_record_in_pieces_is_the_record_at_once(
    variant: str, monkeypatch: pytest.MonkeyPatch, rng
) -> None:
    """Gaps, rows that a bootstrap repeats, and pieces shorter than a window are wide."""
    plant = random_plant(rng)
    truth = replace(plant, K=kalman_gain(plant, np.eye(6), np.eye(3)))
    y, u, _ = open_loop(truth, 1500, 0.3, rng)
    stretch = np.repeat([0, 1], [600, 900])
    times = np.concatenate([np.arange(300), np.arange(200, 1500), np.arange(700, 900)])
    found = []
    for together in (10**6, 97, 20):
        monkeypatch.setattr(residual, "BLOCK_ROWS", together)
        model = identify_innovations(y, u, 8, 10, 6, variant, stretch=stretch, times=times).model  # type: ignore[arg-type]
        noise = replace(model, B=model.K, D=np.eye(3), inputs=())
        found.append(np.concatenate([model.markov(20), noise.markov(20)]))
    np.testing.assert_allclose(found[1:], [found[0]] * 2, atol=1e-9)


def test_data_that_do_not_determine_a_model_are_refused(rng) -> None:
    truth = random_plant(rng)
    u = rng.standard_normal((600, 3))
    y = truth.simulate(u)
    idle, constant = u * [1.0, 0.0, 1.0], np.ones_like(u) + 1e-14 * u
    lost = y.copy()
    lost[5, 1] = np.nan
    for message, data in (
        ("got 12 windows", (y[:40], u[:40], 8, 20, 6, "open")),
        ("windows of data, expected at least", (y[:60], u[:60], 8, 20, 6, "closed")),
        ("input 2 does not vary: got 0", (y, idle, 8, 10, 6, "closed")),
        ("do not excite", (y, np.sin(np.arange(600))[:, None] * constant, 8, 10, 6, "open")),
        ("output 2 does not vary: got 0", (y * [1.0, 0.0, 1.0], u, 8, 10, 6, "closed")),
        ("not finite", (lost, u, 8, 10, 6, "closed")),
    ):
        with pytest.raises(IdentificationError, match=message):
            identify_innovations(*data)
