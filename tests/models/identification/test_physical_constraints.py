"""Constraints leave what is physical alone, and make the rest so: inertia, dissipation, origin."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from docs.vessels import parameters_of
from seatrial.models.identification import physical_constraints
from seatrial.models.identification.free_parameters import FreeParameters, free_parameters
from seatrial.models.identification.physical_constraints import (
    ROW_TOLERANCE,
    PhysicalConstraints,
    dissipated,
    sampled_velocities,
    solve,
    unphysical,
)
from seatrial.models.identification.problem import Problem
from seatrial.models.identification.structured import entries_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel

FACTOR = 5.0


def constraints_of(problem: Problem, tie: str = "tied") -> PhysicalConstraints:
    """The constraints on every coefficient of the nominal model."""
    free = free_parameters(problem.nominal, None, tie, False, symmetric=True)
    return constraints_on(free, problem.training.nu)


def constraints_on(
    free: FreeParameters, nu: np.ndarray, factor: float = FACTOR
) -> PhysicalConstraints:
    """The constraints on free parameters by recorded velocities (N, n_dof)."""
    return PhysicalConstraints(free, nu, factor, np.abs(free.values))


def hessian(constraints: PhysicalConstraints, rng: np.random.Generator) -> np.ndarray:
    """A positive definite one of a size that makes the parameters comparable."""
    m = len(constraints.free)
    root = rng.standard_normal((m, m))
    return (root @ root.T / m + 0.1 * np.eye(m)) / np.outer(constraints.scale, constraints.scale)


def model_of(constraints: PhysicalConstraints, change: np.ndarray) -> Vessel:
    free = constraints.free
    return free.nominal + free.residual(free.values + change)


def inertia_ratios(model: Vessel, nominal: Vessel) -> np.ndarray:
    """Eigenvalues of the symmetric inertia over the nominal one."""
    M, M_0 = (0.5 * (table.inertia + table.inertia.T) for table in (model, nominal))
    return np.asarray(scipy.linalg.eigvalsh(M, M_0))


def changed(table: Vessel, dof: str, term: str, value: float) -> Vessel:
    theta = table.theta.copy()
    theta[table.terms.index(basis.term(term)), table.dofs.index(dof)] = value
    return replace(table, theta=theta)


@pytest.mark.parametrize("tie", ["tied", "free"])
def test_where_nothing_binds_the_solution_is_the_unconstrained_one(calm, rng, tie: str) -> None:
    """Every coefficient within 5 % of the nominal one is far from any constraint."""
    constraints = constraints_of(calm.problem, tie)
    H = hessian(constraints, rng)
    target = 0.05 * rng.uniform(-1.0, 1.0, len(constraints.scale)) * constraints.scale
    at = np.zeros_like(target)
    change, active = solve(H, H @ target, constraints, at)
    assert active == ()
    np.testing.assert_allclose(change, target, rtol=0.0, atol=1e-7 * np.max(np.abs(target)))
    free, none = solve(H, H @ target, None, at)
    np.testing.assert_allclose(change, free, rtol=0.0, atol=1e-7 * np.max(np.abs(target)))
    assert none == ()


@pytest.mark.parametrize("tie", ["tied", "free"])
@pytest.mark.parametrize("seed", range(4))
def test_whatever_the_data_say_the_solution_is_physical(calm, tie: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    constraints, nominal = constraints_of(calm.problem, tie), calm.problem.nominal
    H, m = hessian(constraints, rng), len(constraints.free)
    target = 3.0 * rng.standard_normal(m) * constraints.scale
    assert constraints.violated(target)
    at = 0.1 * rng.uniform(-1.0, 1.0, m) * constraints.scale
    step, active = solve(H, H @ (target - at), constraints, at)
    assert active
    assert constraints.violated(at + step) == ()
    model = model_of(constraints, at + step)
    ratios = inertia_ratios(model, nominal)
    assert np.all(
        (ratios > 1.0 / FACTOR - 2.0 * ROW_TOLERANCE) & (ratios < FACTOR + 2.0 * ROW_TOLERANCE)
    )
    power, largest = (dissipated(table, constraints.velocities) for table in (model, nominal))
    assert np.all(power >= -1e-5 * largest)


@pytest.mark.parametrize("seed", range(2))
def test_a_solution_whose_cuts_are_not_all_found_is_physical(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """The part of it that is, counted from the nominal model."""
    monkeypatch.setattr(physical_constraints, "MAX_CUTS", 1)
    rng, nominal = np.random.default_rng(seed), parameters_of("milliampere").nominal()
    free = free_parameters(nominal, None, "tied", False, symmetric=True)
    constraints = constraints_on(free, 0.3 * rng.standard_normal((300, 3)))
    H, target = hessian(constraints, rng), rng.standard_normal(len(free)) * constraints.scale
    change, _ = solve(H, H @ target, constraints, np.zeros(len(free)))
    assert np.any(change != 0.0)
    assert constraints.violated(change) == ()


@pytest.mark.parametrize("size", [1e2, 1e6, 1e14])  # of what noise makes of unexcited terms
@pytest.mark.parametrize("name", ["milliampere", "beluga_diagonal", "beluga_full"])
def test_however_far_a_table_is_outside_the_nearest_one_is_physical(name: str, size: float) -> None:
    rng, nominal = np.random.default_rng(0), parameters_of(name).nominal()
    free = entries_of(nominal, nominal)
    constraints = constraints_on(free, 0.3 * rng.standard_normal((300, len(nominal.dofs))))
    table = size * rng.standard_normal(len(free)) * constraints.scale
    H = hessian(constraints, rng)
    step, _ = solve(H, np.zeros(len(free)), constraints, table)
    assert constraints.violated(table + step) == ()


def test_the_solution_is_optimal(calm, rng) -> None:
    """Karush, Kuhn and Tucker: the gradient is a sum of active rows with positive multipliers."""
    constraints = constraints_of(calm.problem)
    scale, m = constraints.scale, len(constraints.free)
    H, target = hessian(constraints, rng), rng.standard_normal(m) * scale
    change, active = solve(H, H @ target, constraints, np.zeros(m))
    assert active
    gradient = (H @ (change - target)) * scale
    binds = constraints.rows.A @ change < constraints.rows.b + 1e-6
    nearly = replace(constraints, factor=FACTOR * (1.0 - 1e-4)).cuts(change)  # at its bounds
    normals = [constraints.rows.A[binds], *([nearly.A] if nearly else [])]
    _, left = scipy.optimize.nnls((np.vstack(normals) * scale).T, gradient)
    assert left < 1e-3 * np.linalg.norm(gradient)


def test_the_nominal_model_is_always_feasible(calm, vessel) -> None:
    rng = np.random.default_rng(0)
    for name in ("milliampere", "beluga_linear", "beluga_diagonal", "beluga_full"):
        table = vessel(name)
        nu = rng.standard_normal((300, len(table.dofs)))
        for tie in ("tied", "free"):
            free = free_parameters(table, None, tie, False, symmetric=True)
            constraints = constraints_on(free, nu)
            assert np.all(constraints.rows.b <= 0.0)
            assert constraints.violated(np.zeros(len(free))) == ()
            assert constraints.cuts(np.zeros(len(free))) is None
            nearly, names = solve(np.eye(len(free)), np.zeros(len(free)), constraints, free.values)
            np.testing.assert_allclose(free.values + nearly, free.values, atol=10.0 * FACTOR * 1e4)
            assert set(names) <= {*constraints.rows.names, "inertia"}
            assert unphysical(table, table, nu) is None


def noise_for_force(problem: Problem, rng: np.random.Generator) -> Problem:
    """The problem with a force that has nothing to do with the motion."""
    force = 300.0 * rng.standard_normal(problem.training.tau.shape)
    return replace(problem, training=replace(problem.training, tau_filtered=force))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ls", "robust", "output_error"])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_a_table_fitted_to_noise_becomes_physical(calm, identifier, name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem, nominal = noise_for_force(calm.problem, rng), calm.problem.nominal
    options: dict[str, object] = {"basis": "physical", "refinement": "none"}
    options |= {"disturbance": "none", "prior": 1e3} if name == "robust" else {}
    if name == "output_error":
        options = {"horizons": [], "horizon": 20, "prior": 10.0}
    raw, fitted = (
        identifier(name, inertia_factor=factor, **options).identify(problem, rng)
        for factor in (None, FACTOR)
    )
    nu = problem.training.nu
    assert unphysical(raw.model, nominal, nu) is not None
    assert unphysical(fitted.model, nominal, nu) is None
    assert [one for one in raw.diagnostics if one.name == "active_constraint"] == []
    assert [one for one in fitted.diagnostics if one.name == "active_constraint"]
    ratios = inertia_ratios(fitted.model, nominal)
    assert np.all((ratios > 1.0 / FACTOR - 1e-5) & (ratios < FACTOR + 1e-5))
    sampled = sampled_velocities(nu, nominal.inertia)
    power, largest = dissipated(fitted.model, sampled), dissipated(nominal, sampled)
    assert np.all(power >= -1e-5 * largest)


def test_unphysical_names_what_cannot_be(calm) -> None:
    nominal, nu = calm.problem.nominal, calm.problem.training.nu
    assert unphysical(nominal, nominal, nu) is None
    assert unphysical(calm.truth, nominal, nu) is None
    drives = changed(nominal, "surge", "u", -500.0)
    assert "its damping creates energy at" in (unphysical(drives, nominal, nu) or "")
    share = 100.0 * np.mean(dissipated(drives, nu[:: max(len(nu) // 150, 1)]) < 0.0)
    assert f"at {share:.2g} %" in (unphysical(drives, nominal, nu) or "")
    light = changed(nominal, "sway", "v_dot", -1.0)
    assert unphysical(light, nominal, nu) == "its inertia is not positive definite"
    coupled = changed(changed(nominal, "sway", "r_dot", 9e3), "yaw", "v_dot", 9e3)
    assert unphysical(coupled, nominal, nu) == "its inertia is not positive definite"


@pytest.mark.parametrize("seed", range(2))
def test_between_the_sampled_velocities_nothing_creates_energy(lap, identifier, seed: int) -> None:
    """Nowhere in the recorded box, of 100,000 velocities, nor in one of twice its sides."""
    problem, rng = lap("noise", seed).problem, np.random.default_rng(seed)
    box = np.max(np.abs(problem.training.nu), axis=0)
    fresh = box * rng.uniform(-1.0, 1.0, (100_000, 3))
    shares = []
    for factor in (None, FACTOR):
        model = identifier("ls", inertia_factor=factor).identify(problem, rng).model
        shares.append([np.mean(dissipated(model, scale * fresh) < 0.0) for scale in (1.0, 2.0)])
    assert min(shares[0]) > 0.1
    assert shares[1] == [0.0, 0.0]
