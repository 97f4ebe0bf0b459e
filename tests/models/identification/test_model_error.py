"""The model error: calibrated on what was left out, and drawn with the parameters."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.identification import calibration
from seatrial.models.identification.auto import identified
from seatrial.models.identification.calibration import (
    NO_MODEL_ERROR,
    NearbyRuns,
    bands,
    calibrated,
    folded,
    nearby_runs,
    squared_accelerations,
)
from seatrial.models.identification.cross_validation import FOLDS
from seatrial.models.identification.free_parameters import free_parameters
from seatrial.models.identification.free_run import Course
from seatrial.models.identification.model_error import CORRELATION_S, ModelError, gauss_markov
from seatrial.models.identification.problem import Identified, NoIdentifier, Problem
from seatrial.models.identification.uncertainty import ParameterSpread
from seatrial.models.identification.validation import Prediction, prediction
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_sheet import DEVIATION_SHARE
from seatrial.models.vessel.basis import Array
from tests.models.identification.conftest import surge
from tests.models.identification.known_results import Failing, labels
from tests.trials import asked_for, excited

SURGE = ("vessel=surge_nonlinear", "excitation=multisine", "controller=none", "evaluation=none")
SHIP = ("vessel=modulus_ship", "excitation=prbs", "controller=none", "evaluation=none")


@pytest.fixture(scope="module")
def noisy() -> Problem:
    return excited(*SURGE, "disturbance=noise")[0]


@pytest.fixture(scope="module")
def ship() -> Problem:
    return excited(*SHIP, "disturbance=calm")[0]


def under(runs: NearbyRuns, accelerations: Array) -> Course:
    """The course of the runs with accelerations (N, n_dof)."""
    course = runs.own.course
    return course._replace(weather=course.weather._replace(process=accelerations))


def under_accelerations(own: Problem, force: Array, seed: int) -> Recording:
    """The training part as the nominal model would sail it under accelerations of known size."""
    training = own.training
    runs = nearby_runs(own.nominal, training, own.thruster)
    n = len(training.dofs)
    mean_square = np.mean(runs.rho2, axis=0)
    error = ModelError(1.0, force, 1.0, mean_square, np.zeros(2 * n))
    drawn = error.accelerations(runs.rho2, training.period_s, np.random.default_rng(seed))
    motion = Prediction(runs.own.plant, under(runs, drawn)).motion()
    return replace(training, eta=motion[:, :n], nu=motion[:, n:])


def known(own: Problem) -> Identified:
    """The nominal model, of which nothing is left open, as the result on each fold."""
    result = NoIdentifier().identify(own, np.random.default_rng(0))
    return replace(result, fold_models=(own.nominal,) * 5)


def share_inside(result: Identified, recording: Recording) -> Array:
    """Share (2 n_dof,) of measured states in the band of 90 %."""
    deviation = bands(result, recording, None)
    run = prediction(result.model, recording, None)
    inside = np.abs(run.deviations()[0]) <= 1.645 * deviation
    return np.asarray(np.mean(inside[~recording.piece_starts], axis=0))


def test_paths_have_unit_variance_and_forget_in_their_correlation_time() -> None:
    paths = gauss_markov((400, 5000), 0.1, np.random.default_rng(0))
    np.testing.assert_allclose(np.var(paths, axis=1), 1.0, atol=0.12)
    later = round(CORRELATION_S / 0.1)
    found = np.mean(paths[:-later] * paths[later:])
    assert found == pytest.approx(np.exp(-1.0), abs=0.02)


def test_accelerations_have_the_size_that_the_formulas_say() -> None:
    """k lambda sqrt((m^2 + rho^2) / 2), rho^2 = (M^-1 tau)^2 + (M^-1 F)^2; far apart in time."""
    nu, force = np.array([[2.0]]), np.array([[30.0]])
    rho2 = squared_accelerations(surge(60.0, 20.0), nu, np.zeros((1, 3)), force, None)
    assert rho2[0, 0] == pytest.approx((30.0 / 60.0) ** 2 + (40.0 / 60.0) ** 2)
    error = ModelError(1.0, np.array([0.3]), 2.0, np.array([4.0]), np.array([0.1, 0.2]))
    drawn = error.accelerations(np.full((40_000, 1), 12.0), 100.0, np.random.default_rng(0))
    assert np.std(drawn) == pytest.approx(2.0 * 0.3 * np.sqrt(8.0), rel=0.02)
    numbers = {row.name: row.value for row in error.diagnostics(("surge",))}
    assert (numbers["noise_pose"], numbers["noise_velocity"]) == (0.1, 0.2)


@pytest.mark.parametrize("force", [(0.05, 0.05, 0.05), (0.3, 0.3, 0.3), (0.0, 0.3, 0.0)])
def test_an_acceleration_of_known_size_is_recovered(
    ship: Problem, force: tuple[float, ...]
) -> None:
    """Nothing else moves the vessel away from the model: lambda is that size and k is one."""
    sizes = []
    for seed in range(3):
        recording = under_accelerations(ship, np.array(force), seed)
        given = replace(ship, training=recording)
        error = calibrated(NoIdentifier(), given, known(given)).model_error
        sizes.append(error.force * error.scale)
    assert np.exp(np.mean(np.log(sizes), axis=0)) == pytest.approx(force, rel=0.3, abs=0.02)


@pytest.mark.parametrize("axes", [3, 1])
def test_without_a_model_error_there_is_none(ship: Problem, axes: int) -> None:
    """The model is the vessel and nothing is measured wrongly, be it that it only goes ahead."""
    n, moved = len(ship.training.dofs), np.arange(3) < axes
    begun = replace(
        ship.training, tau=ship.training.tau * moved, tau_actual=None, tau_filtered=None,
        eta=ship.training.eta * moved, nu=ship.training.nu * moved,
    )  # fmt: skip
    motion = prediction(ship.nominal, begun, ship.thruster).motion()
    exact = replace(ship, training=replace(begun, eta=motion[:, :n], nu=motion[:, n:]))
    result = calibrated(NoIdentifier(), exact, known(exact))
    deviation = bands(result, exact.training, ship.thruster)
    assert np.all(result.model_error.force * result.model_error.scale < 1e-3)
    assert np.all(deviation[:, n:] < 2e-3 * np.std(exact.training.nu, axis=0) + 1e-9)


@pytest.mark.slow
def test_bands_hold_a_vessel_of_another_structure() -> None:
    """Its damping is quadratic, the model's linear: what the data leave open is far too little."""
    options = (*SURGE, "excitation.amplitude={surge: 150.0}", "disturbance=noise")
    own, _ = excited(*options)
    identifier = asked_for(*options, "identifier=ls", "identifier.basis=linear").identifier
    alone = identifier.identify(own, np.random.default_rng(0))
    both = calibrated(identifier, own, alone)
    without, with_ = ([], [])
    for seed in range(5):
        held_out = excited(*options, seed=seed)[0].validation
        without.append(share_inside(alone, held_out))
        with_.append(share_inside(both, held_out))
    assert np.mean(without) < 0.6
    assert 0.8 <= np.mean(with_) <= 1.0
    assert both.std_error is alone.std_error  # the share of the data stands for itself


def test_draws_are_the_same_every_time(noisy: Problem) -> None:
    identifier = asked_for(*SURGE, "identifier=ls").identifier
    result = identifier.identify(noisy, np.random.default_rng(0))
    first, second = (calibrated(identifier, noisy, result) for _ in range(2))
    np.testing.assert_array_equal(first.model_error.force, second.model_error.force)
    np.testing.assert_array_equal(*(bands(r, noisy.validation, None) for r in (first, second)))


def test_the_data_count_less_and_the_prior_in_full(ship: Problem) -> None:
    """B B' is ((inv(C) - P) / kappa2 + P)^-1, and for data that say nothing the prior's."""
    free = free_parameters(ship.nominal, None, "tied", False)
    m = len(free)
    A = np.random.default_rng(0).standard_normal((3 * m, m))
    data, prior = A.T @ A, np.linspace(0.1, 3.0, m)
    prior[0] = 0.0  # a parameter without a prior
    covariance = np.linalg.inv(data + np.diag(prior))
    spread = ParameterSpread(ship.nominal, free, free.values, covariance, prior)
    for kappa2 in (1.0, 10.0, 300.0):
        B = spread.factor(kappa2)
        expected = np.linalg.inv(data / kappa2 + np.diag(prior))
        np.testing.assert_allclose(B @ B.T, expected, rtol=1e-8, atol=1e-10 * expected.max())
    B = ParameterSpread(ship.nominal, free, free.values, covariance).factor(9.0)
    np.testing.assert_allclose(B @ B.T, 9.0 * covariance, rtol=1e-8, atol=1e-14)


def test_accelerations_move_a_run_in_proportion(ship: Problem) -> None:
    """Runs are drawn at a share of their deviation and scaled back."""
    runs = nearby_runs(ship.nominal, ship.training, ship.thruster)
    n = len(ship.training.dofs)
    error = ModelError(1.0, np.full(n, 0.01), 1.0, np.mean(runs.rho2, axis=0), np.zeros(2 * n))
    drawn = error.accelerations(runs.rho2, ship.training.period_s, np.random.default_rng(0))
    found = [
        runs.variance([Prediction(runs.own.plant, under(runs, share * drawn))])
        for share in (DEVIATION_SHARE, 0.5 * DEVIATION_SHARE)
    ]
    np.testing.assert_allclose(found[1], 0.25 * found[0], atol=0.05 * np.max(found[0]))
    apart = Prediction(runs.own.plant, under(runs, drawn)).motion() - runs.own.motion()
    np.testing.assert_allclose(found[0], apart**2, atol=0.05 * np.max(found[0]))


def test_the_reason_is_said_where_folds_cannot_be_identified(noisy: Problem) -> None:
    identifier = asked_for(*SURGE, "identifier=ls").identifier
    result = calibrated(Failing(), noisy, identifier.identify(noisy, np.random.default_rng(0)))
    assert result.model_error is None
    assert labels(result, NO_MODEL_ERROR) == ["always"]


def test_a_model_without_a_distribution_stays_as_it_is(noisy: Problem) -> None:
    result = NoIdentifier().identify(noisy, np.random.default_rng(0))
    assert calibrated(NoIdentifier(), noisy, result) is result
    assert bands(result, noisy.validation, None) is None


def test_files_of_a_series_are_left_out_by_turns_and_models_at_hand_by_folds(noisy) -> None:
    n = len(noisy.training) // 12 * 12
    file = np.repeat(np.arange(12), n // 12)
    series = replace(noisy.training.part(slice(0, n)), file=file, file_names=tuple("abcdefghijkl"))
    training, fold = folded(series)
    assert [set(fold[file == k]) for k in range(12)] == [{k % FOLDS} for k in range(12)]
    assert len(training) == n
    for k, split in enumerate(series.folds(3)):
        assert set(folded(series, 3)[1][split.test]) == {k}
    long = replace(series, file=np.zeros(n, dtype=np.int64))
    assert list(np.unique(folded(long)[1])) == list(range(FOLDS))


def test_of_a_long_recording_the_beginning_of_each_block_is_used(
    noisy: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration, "MOST_SAMPLES", 500)
    whole, (training, fold) = noisy.training, folded(noisy.training)
    assert list(np.bincount(fold)) == [100] * FOLDS
    begins = [float(whole.t[split.test][0]) for split in whole.folds(FOLDS)]
    assert [float(training.t[fold == k][0]) for k in range(FOLDS)] == begins


@pytest.mark.slow
def test_the_model_error_is_that_of_the_equations_that_are_kept() -> None:
    """The force has the wrong sign: the nominal model is the result, and it is what is judged."""
    problem = excited(*SURGE, "disturbance=noise")[0]
    turned = replace(problem.training, tau=-3.0 * problem.training.tau)
    problem = replace(problem, training=turned)
    ls = asked_for(*SURGE, "identifier=ls").identifier
    found = identified(ls, problem, np.random.default_rng(0))
    np.testing.assert_array_equal(found.residual.theta, 0.0)
    error = calibrated(ls, problem, found).model_error
    nominal = replace(found, fold_models=(problem.nominal,) * FOLDS)
    expected = calibrated(ls, problem, nominal).model_error
    assert error is not None
    assert expected is not None
    np.testing.assert_allclose(error.force, expected.force)
