"""Free runs over segments return the truth, without the bias of measured initial velocities."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.identification.cross_validation import CrossValidation
from seatrial.models.identification.free_parameters import FreeParameters, free_parameters
from seatrial.models.identification.free_run_fit import Fit, FreeRuns, Stage, fit, segments
from seatrial.models.identification.physical_constraints import PhysicalConstraints
from seatrial.models.identification.predictor import Predictor
from seatrial.models.identification.structured import Structure
from tests.trials import excited

SEGMENT_S = 30.0
DIAGONAL = ("surge.u_dot", "sway.v_dot", "heave.w_dot", "roll.p_dot", "pitch.q_dot", "yaw.r_dot")
WIDE = 100.0  # standard deviation of the prior, over the nominal size: hardly any prior


def parameters(problem) -> FreeParameters:
    return free_parameters(problem.nominal, None, "tied", False, symmetric=True)


def refine(
    predictor: Predictor,
    change: np.ndarray,
    deviation: np.ndarray,
    constraints: PhysicalConstraints | None,
) -> Fit:
    """The fit of the segments of a predictor, from a change or from the nominal parameters."""
    stage = Stage(FreeRuns(predictor, deviation))
    return fit(stage, [change, np.zeros_like(change)], deviation, constraints)


def true_change(free: FreeParameters) -> np.ndarray:
    """The plant is half the nominal one."""
    return -0.5 * free.values


@pytest.mark.parametrize("seed", range(2))
def test_without_noise_the_truth_returns_from_a_perturbed_table(calm, seed: int) -> None:
    problem, rng = calm.problem, np.random.default_rng(seed)
    free = parameters(problem)
    size, truth = np.abs(free.values), true_change(free)
    start = truth + 0.1 * size * rng.uniform(-1.0, 1.0, len(free))
    predictor = segments(problem.training, free, problem.thruster, None, SEGMENT_S)
    refined = refine(predictor, start, WIDE * size, None)
    np.testing.assert_allclose(refined.change / size, truth / size, rtol=0.0, atol=5e-4)
    assert refined.active == ()
    inertia = [label.endswith("_dot") for label in free.labels]
    np.testing.assert_allclose(refined.change[inertia], truth[inertia], rtol=1e-3)


def test_constraints_hold_after_every_step(calm) -> None:
    """The truth has half the nominal inertia; a factor of 1.5 does not let it pass."""
    problem = calm.problem
    free = parameters(problem)
    size = np.abs(free.values)
    constraints = PhysicalConstraints(free, problem.training.nu, 1.5, size)
    predictor = segments(problem.training, free, problem.thruster, None, SEGMENT_S)
    refined = refine(predictor, np.zeros(len(free)), size, constraints)
    assert "inertia" in refined.active
    assert constraints.violated(refined.change) == ()
    ratio = 1.0 + refined.change[0] / free.values[0]
    assert ratio == pytest.approx(1.0 / 1.5, rel=1e-4)


def test_a_wrong_initial_velocity_does_not_matter(calm) -> None:
    """Offsets of the velocity at the first sample of each segment are estimated."""
    problem = calm.problem
    free = parameters(problem)
    size, training = np.abs(free.values), problem.training
    nu = training.nu.copy()
    nu[:: round(SEGMENT_S / training.period_s)] += np.array([0.05, -0.05, 0.02])
    shifted = replace(training, nu=nu)
    predictor = segments(shifted, free, problem.thruster, None, SEGMENT_S)
    refined = refine(predictor, true_change(free), WIDE * size, None)
    inertia = [label in ("surge.u_dot", "sway.v_dot", "yaw.r_dot") for label in free.labels]
    np.testing.assert_allclose(refined.change[inertia], true_change(free)[inertia], rtol=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_least_squares_is_better_in_free_runs_after_refinement(lap, identifier, seed: int) -> None:
    problem = lap("noise", seed).problem
    plain, refined = (
        identifier("ls", basis="physical", lowpass_hz=None, refinement=choice)
        .identify(problem, None)
        .model
        for choice in ("none", "free_run")
    )
    blocks = CrossValidation(problem)
    runs = [np.mean(blocks.runs(m, problem.validation).nrmse ** 2) for m in (plain, refined)]
    assert runs[1] < 0.8 * runs[0]


@pytest.mark.slow
def test_short_segments_first_avoid_a_minimum_of_long_ones(identifier) -> None:
    """Beluga, 30 s from rest with a noisy attitude: from here whole segments end in a minimum."""
    problem, truth = excited(
        "vessel=beluga_diagonal", "disturbance=[constant,noise]", "excitation=multisine",
        "controller=none", "plant.scale=0.8",
    )  # fmt: skip
    option = identifier("robust", disturbance="ned_force")
    free, training = option.free(problem.nominal), problem.training
    samples = option.samples(training, free.nominal, None, terms=free.nominal.terms)
    model = Structure(free, samples, training.nu, option.inertia_factor)
    change, _ = model.regress(1.0)
    predictor = segments(training, free, None, None, SEGMENT_S)
    direct = refine(predictor, change, model.size, model.constraints).change
    found = option.identify(problem, np.random.default_rng(0)).residual
    grown = free.change(found.on(free.nominal.terms).theta)
    inertia = [label in DIAGONAL for label in free.labels]
    assert sum(inertia) == 6
    true = free.change(truth.on(free.nominal.terms).theta - free.nominal.theta)
    errors = [
        np.max(np.abs((change - true)[inertia] / (free.values + true)[inertia]))
        for change in (direct, grown)
    ]
    assert errors[0] > 0.02
    assert errors[1] < 0.003


@pytest.mark.slow
def test_noisy_velocities_do_not_bias_the_inertia(lap, identifier) -> None:
    """Twelve seeds; a start at measured or smoothed velocities is off by one to two percent."""
    option = identifier("robust", disturbance="none")
    ratios = []
    for seed in range(12):
        noisy = lap("noise", seed)
        model = option.identify(noisy.problem, np.random.default_rng(0)).model
        ratios.append(np.diag(model.inertia) / np.diag(noisy.truth.inertia))
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, atol=0.005)
