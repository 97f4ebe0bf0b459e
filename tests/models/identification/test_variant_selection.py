"""The choice between the variants of DSR by the data, where the right one is known."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.identification.subspace import (
    FEEDBACK_P,
    Record,
    feedback_p_value,
    select_variant,
)
from seatrial.models.simulation.statespace import StateSpace
from tests.models.identification.test_subspace import (
    closed_loop,
    kalman_gain,
    open_loop,
    random_plant,
)


def noisy_plant(rng: np.random.Generator, direct: bool) -> StateSpace:
    """A random plant with the gain of unit noise, with or without a direct term."""
    plant = random_plant(rng)
    D = rng.standard_normal((3, 3)) if direct else np.zeros((3, 3))
    return replace(plant, K=kalman_gain(plant, np.eye(6), np.eye(3)), D=D)


def record_of(y: np.ndarray, u: np.ndarray) -> Record:
    return Record(y, u, np.zeros(len(y), dtype=np.int64), np.arange(len(y)))


@pytest.mark.parametrize("seed", range(6))
def test_feedback_is_found_and_takes_the_closed_variant(seed: int) -> None:
    y, u, _ = closed_loop(seed, 1000)
    selection = select_variant(y, u, 6, 20, 6)
    assert selection.p_value < FEEDBACK_P
    assert selection.alternative == ("closed", False)


@pytest.mark.parametrize("seed", range(6))
def test_a_direct_term_is_estimated_where_there_is_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    direct = bool(seed % 2)
    y, u, _ = open_loop(noisy_plant(rng, direct), 1000, 0.5, rng)
    selection = select_variant(y, u, 6, 20, 6)
    assert selection.p_value > FEEDBACK_P
    assert selection.alternative[1] == direct
    assert set(selection.errors) == {"closed", "open", "open with D"}


def test_files_are_left_out_whole() -> None:
    """Two files of unequal length: one error each, the same in whichever order they stand."""
    rng = np.random.default_rng(3)
    plant = noisy_plant(rng, direct=False)
    records = [open_loop(plant, n, 0.5, rng)[:2] for n in (400, 600)]
    errors = []
    for order in ((0, 1), (1, 0)):
        y, u = (np.vstack([records[k][i] for k in order]) for i in (0, 1))
        file = np.concatenate([np.full(len(records[k][0]), i) for i, k in enumerate(order)])
        selection = select_variant(y, u, 6, 20, 6, stretch=file, file=file)
        errors.append(selection.errors["open"].squares)
    assert [len(values) for values in errors] == [2, 2]
    np.testing.assert_allclose(errors[0], errors[1][::-1], rtol=1e-6)


def test_the_test_of_feedback_has_its_level() -> None:
    """Without feedback the p-value is below 0.1 in at most a tenth of the records, and some are."""
    rng = np.random.default_rng(1)
    values = []
    for _ in range(100):
        y, u, _ = open_loop(noisy_plant(rng, False), 600, 0.5, rng)
        values.append(feedback_p_value(record_of(y, u), 10))
    assert 1 <= np.count_nonzero(np.array(values) < 0.1) <= 18  # 99.5 % of binomial(100, 0.1)


def test_without_noise_there_is_no_feedback_to_find(rng) -> None:
    plant, u = random_plant(rng), rng.standard_normal((600, 3))
    assert feedback_p_value(record_of(plant.simulate(u), u), 10) == 1.0
    t = np.arange(600)[:, None]
    sines = np.sin(0.3 * t * [1.0, 1.7, 2.3]) + np.sin(0.9 * t * [1.0, 1.3, 0.7])
    y = plant.simulate(sines) + 0.1 * rng.standard_normal((600, 3))
    assert feedback_p_value(record_of(y, sines), 10) > FEEDBACK_P
