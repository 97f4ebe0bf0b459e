"""DSR of a vessel: physical form, body axes, standard errors, and what is refused."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models import notation
from seatrial.models.diagnostics import nominal_equations
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.auto import WholeTraining, identified
from seatrial.models.identification.dsr import body_pose, forces_of, physical_form, sampled
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.linearisation import linearise
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite
from tests.data import DATA
from tests.models.identification.test_free_run import pose_rate
from tests.trials import composed

INERTIA = np.array([[1200.0, 0.0, 0.0], [0.0, 1300.0, 30.0], [0.0, 15.0, 2500.0]])
DAMPING = np.array([[40.0, 0.0, 0.0], [0.0, 90.0, -10.0], [0.0, 5.0, 250.0]])


def linear_vessel() -> Vessel:
    terms = basis.terms(["u_dot", "v_dot", "r_dot", "u", "v", "r"])
    return Vessel("linear", PLANAR, terms, np.vstack([INERTIA.T, DAMPING.T]))


def axis_recording(
    n: int, rng: np.random.Generator, noise: float = 0.0, held: int = 1
) -> Recording:
    """Surge, sway and heave of the same table: without a heading there is no rotation.

    The force changes every `held` samples.
    """
    axes = ("surge", "sway", "heave")
    vessel = Vessel("axes", axes, basis.terms(["u_dot", "v_dot", "w_dot", "u", "v", "w"]),
                    linear_vessel().theta)  # fmt: skip
    model = linearise(vessel).discretised(0.5)
    tau = np.repeat(rng.standard_normal((n // held, 3)) * [200.0, 200.0, 400.0], held, axis=0)
    eta = model.simulate(tau) + noise * rng.standard_normal((n, 3))
    nu = replace(model, C=np.eye(3, 6, 3)).simulate(tau)
    t = 0.5 * np.arange(n)
    return Recording(axes, t, eta, nu, np.zeros_like(nu), tau, np.zeros((n, 3)))


def problem_of(recording: Recording) -> Problem:
    half = np.arange(len(recording)) < len(recording) // 2
    terms = basis.terms([*(f"{v}_dot" for v in "uvw"), "|u|u"])
    theta = np.vstack([2.0 * np.diag(np.diag(INERTIA)), np.full((1, 3), 7.0)])
    nominal = Vessel("nominal", recording.dofs, terms, theta)
    return Problem(recording.part(half), recording.part(~half), nominal, None)


def value(found: Identified, name: str, dof: str = "all", **where: Any) -> float:
    (one,) = [
        f for f in found.diagnostics
        if (f.name, f.dof) == (name, dof) and all(getattr(f, k) == v for k, v in where.items())
    ]  # fmt: skip
    return one.value


def test_a_linear_vessel_is_identified_exactly(identifier, rng) -> None:
    """As a physical form, and as a state-space model in pose and velocity."""
    problem = problem_of(axis_recording(800, rng))
    found = identifier("dsr", bootstrap=None).identify(problem, rng)
    np.testing.assert_allclose(found.model.inertia, INERTIA, rtol=1e-6, atol=1e-3)
    damping = np.array([found.model.row(name) for name in ("u", "v", "w")]).T
    np.testing.assert_allclose(damping, DAMPING, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(found.residual.theta, (found.model - problem.nominal).theta)
    assert found.model.coefficient("surge", "|u|u") == 0.0  # the nominal quadratic term is gone
    assert value(found, "selected_order") == 6.0
    assert value(found, "physical_form") == 1.0
    assert abs(value(found, "stiffness", "surge", j=1)) < 1e-4
    assert abs(value(found, "delay", "sway")) < 1e-6
    for kind in ("one_step", "ten_step", "free_run"):
        assert value(found, f"fit_{kind}", "heave") > 99.999
    model = found.state_space
    np.testing.assert_allclose(model.C, np.eye(3, 6), atol=1e-9)
    np.testing.assert_allclose(model.A[:3, :3], np.eye(3), atol=1e-8)  # no stiffness
    assert model.inputs == ("tau_surge", "tau_sway", "tau_heave")
    assert model.outputs == ("x", "y", "z")
    assert all(part is not None for part in (model.K, model.F, model.x0))
    assert value(found, "markov", "sway", i=3, j=2) == pytest.approx(model.markov(4)[3, 1, 1])


@pytest.mark.slow
def test_the_ferry_is_found_through_its_turns(identifier, lap) -> None:
    """Closed loop, 180 degree turns, thruster lag, quadratic drag: inertia to 5 %."""
    for disturbance in ("calm", "noise"):
        sailed = lap(disturbance)
        found = identifier("dsr", bootstrap=None).identify(sailed.problem, np.random.default_rng(0))
        true = np.diag(sailed.truth.inertia)
        np.testing.assert_allclose(np.diag(found.model.inertia), true, rtol=0.06)
        assert value(found, "predictor_radius") < 1.0
        assert [f.label for f in found.diagnostics if f.name == "variant"] == ["closed"]
        assert all(value(found, "fit_one_step", dof) > 95.0 for dof in PLANAR)
        assert all(0.5 < value(found, "delay", dof) < 1.0 for dof in PLANAR)  # the lag's 0.8 s
        values = [f.value for f in found.diagnostics if f.name == "singular_value"]
        assert values[5] > 10.0 * values[6]


def test_known_terms_beside_the_force_are_identified_too(identifier, calm, rng) -> None:
    terms = ["ur", "vr", "uv", "|u|u", "|v|v", "|r|r", "|r|v"]
    dsr = identifier("dsr", bootstrap=None, extra_terms=terms, force="filtered")
    found = dsr.identify(calm.problem, rng)
    for dof, term in (("surge", "u_dot"), ("sway", "v_dot"), ("yaw", "r_dot")):
        true = calm.truth.coefficient(dof, term)
        assert found.model.coefficient(dof, term) == pytest.approx(true, rel=0.01)
    for dof, term in (("yaw", "|r|r"), ("yaw", "r"), ("sway", "ur"), ("surge", "vr")):
        true = calm.truth.coefficient(dof, term)
        assert found.model.coefficient(dof, term) == pytest.approx(true, rel=0.1)
    assert all(value(found, "fit_free_run", dof) > 75.0 for dof in PLANAR)
    assert found.state_space.inputs == ("tau_surge", "tau_sway", "tau_yaw", *terms)
    assert found.control_model.inputs == ("tau_surge", "tau_sway", "tau_yaw")


def test_the_nominal_model_can_say_which_terms_are_known(identifier, calm, rng) -> None:
    dsr = identifier("dsr", bootstrap=None, extra_terms="physical", force="filtered", J=10, L=6)
    found = dsr.identify(calm.problem, rng)
    assert set(found.model.terms) == set(calm.problem.nominal.terms)
    true = np.diag(calm.truth.inertia)
    np.testing.assert_allclose(np.diag(found.model.inertia), true, rtol=0.01)


def test_a_constant_force_in_ned_needs_its_terms(identifier, constant, rng) -> None:
    blind = identifier("dsr", bootstrap=None).identify(constant.problem, rng)
    terms = ["cos(psi)", "sin(psi)"]
    told = identifier("dsr", bootstrap=None, extra_terms=terms).identify(constant.problem, rng)
    true = np.diag(constant.truth.inertia)
    errors = [np.abs(np.diag(f.model.inertia) / true - 1.0) for f in (blind, told)]
    assert errors[0].max() > 0.5
    assert errors[1].max() < 0.08
    assert told.model.coefficient("surge", "cos(psi)") == pytest.approx(-200.0, rel=0.15)


@pytest.mark.parametrize("dofs", [PLANAR, notation.DOFS])
def test_the_rate_of_a_body_pose_is_the_body_velocity(dofs: tuple[str, ...]) -> None:
    t, n = np.linspace(0.0, 10.0, 4001), len(dofs)
    nu = 0.3 * np.sin(t[:, None] * np.arange(1, n + 1) + np.arange(n))
    eta = np.zeros((len(t), n))
    for k in range(len(t) - 1):  # mid-point rule
        half = eta[k] + 0.5 * (t[1] - t[0]) * pose_rate(eta[k], nu[k], dofs)
        eta[k + 1] = eta[k] + (t[1] - t[0]) * pose_rate(half, 0.5 * (nu[k] + nu[k + 1]), dofs)
    expected = np.gradient(body_pose(eta, dofs), t, axis=0)
    np.testing.assert_allclose(expected[1:-1], nu[1:-1], atol=1e-4)
    assert np.max(np.abs(eta[:, -1])) > 0.05


def test_roll_and_pitch_restore_themselves() -> None:
    axes = ("heave", "roll")
    A = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0, 0, -0.3, 0], [0, -4.0, 0, -0.5]])
    B = np.vstack([np.zeros((2, 2)), np.diag([1.0 / 60.0, 1.0 / 2.0])])
    model = StateSpace(A, B, np.eye(2, 4), np.zeros((2, 2)), None).discretised(0.1)
    vessel = physical_form(model).vessel("tilting", axes, ())
    assert vessel.coefficient("roll", "sin(phi)") == pytest.approx(8.0)
    assert vessel.coefficient("roll", "p") == pytest.approx(1.0)
    assert vessel.coefficient("heave", "w_dot") == pytest.approx(60.0)


def test_stretches_and_periods_of_a_recording(rng) -> None:
    recording = axis_recording(60, rng)
    kept = np.ones(60, dtype=bool)
    kept[20:31] = False
    inputs, outputs = forces_of(recording.dofs), notation.poses_of(recording.dofs)
    data = sampled(recording.part(kept), "commanded", inputs, outputs, 1.0)
    assert data.period_s == 1.0
    np.testing.assert_array_equal(np.bincount(data.stretch), [10, 14])
    np.testing.assert_allclose(data.u[0], recording.tau[:2].mean(axis=0))
    np.testing.assert_allclose(data.u[10], recording.tau[31:33].mean(axis=0))
    np.testing.assert_allclose(data.y[10], 0.0)  # each stretch begins at its own origin
    np.testing.assert_allclose(data.y[11], recording.eta[33] - recording.eta[31])


def test_a_period_that_is_no_multiple_of_the_sample_time_is_refused(identifier, rng) -> None:
    dsr, problem = identifier("dsr", bootstrap=None), problem_of(axis_recording(200, rng))
    for period_s, nearest in ((0.75, "0.5 or 1"), (1.3, "1 or 1.5"), (0.2, "0.5 or 1")):
        message = (
            f"identifier.period_s: got {period_s:g} s, expected a multiple of the recording's "
            f"sample time 0.5 s, such as {nearest}"
        )
        refused = replace(dsr, period_s=period_s)
        with pytest.raises(ConfigurationError, match=f"{re.escape(message)}$"):
            refused.model_period_s(0.5)
        with pytest.raises(ConfigurationError, match=f"{re.escape(message)}$"):
            refused.identify(problem, rng)
    assert replace(dsr, period_s=1.5).model_period_s(0.5) == 1.5
    assert replace(dsr, period_s=None).model_period_s(0.5) == 0.5


def test_the_velocity_alone_needs_one_state_an_axis(identifier, rng) -> None:
    problem = problem_of(axis_recording(800, rng))
    found = identifier("dsr", bootstrap=None, outputs=("u", "v", "w")).identify(problem, rng)
    model, truth = found.state_space, linearise(linear_vessel()).discretised(0.5)
    assert (model.order, model.outputs) == (3, ("u", "v", "w"))
    velocity = replace(truth, C=np.eye(3, 6, 3))
    np.testing.assert_allclose(model.markov(20), velocity.markov(20), atol=1e-9)
    np.testing.assert_array_equal(found.model.theta, problem.nominal.theta)
    assert found.control_model is None
    (reason,) = [f.label for f in found.diagnostics if f.name == "physical_form"]
    assert reason == (
        "no physical form: it needs all forces as the first inputs and the whole pose as output"
    )
    names = [f.label for f in found.diagnostics if f.name == "fit_free_run"]
    assert names == ["u", "v", "w"]
    assert value(found, "markov", "sway", i=1, label="v of tau_sway") == model.markov(2)[1, 1, 1]


def test_one_force_and_one_velocity_are_a_first_order_model(identifier, rng) -> None:
    """Surge is decoupled here: the pole is exp(-d h / m), the static gain 1 / d."""
    dsr = identifier("dsr", bootstrap=None, inputs=("tau_surge",), outputs=("u",))
    model = dsr.identify(problem_of(axis_recording(800, rng)), rng).state_space
    m, d = INERTIA[0, 0], DAMPING[0, 0]
    assert model.inputs == ("tau_surge",)
    np.testing.assert_allclose(model.A, np.exp(-0.5 * d / m), rtol=1e-9)
    np.testing.assert_allclose(model.C @ model.B / (1.0 - model.A), 1.0 / d, rtol=1e-6)


def test_the_acceleration_responds_directly_and_terms_can_be_inputs(identifier, rng) -> None:
    """D is 1 / M in surge; with the velocity as input the acceleration has no state of its own."""
    recording = axis_recording(800, rng)
    nu_dot = np.linalg.solve(INERTIA, (recording.tau - recording.nu @ DAMPING.T).T).T
    nu_dot += 1e-4 * rng.standard_normal(nu_dot.shape)
    problem = problem_of(replace(recording, nu_dot=nu_dot))
    dsr = identifier("dsr", bootstrap=None, outputs=("u_dot", "v_dot", "w_dot"))
    found = dsr.identify(problem, rng)
    assert value(found, "feedthrough") == 1.0
    np.testing.assert_allclose(found.state_space.D, np.linalg.inv(INERTIA), atol=3e-6)
    mixed = replace(dsr, inputs=("tau_surge", "|u|u"), outputs=("x", "u_dot"), order=2)
    model = mixed.identify(problem, rng).state_space
    assert (model.inputs, model.outputs) == (("tau_surge", "|u|u"), ("x", "u_dot"))
    assert model.D[1, 0] == pytest.approx(1.0 / INERTIA[0, 0], rel=0.02)


def test_the_nominal_model_is_kept_where_it_predicts_better(identifier, rng) -> None:
    """The truth as nominal model, and noise; then the other way round.

    Only what is estimated has a standard error.
    """
    problem = problem_of(axis_recording(800, rng, noise=0.02, held=5))
    terms = basis.terms(["u_dot", "v_dot", "w_dot", "u", "v", "w"])
    truth = Vessel("truth", problem.nominal.dofs, terms, linear_vessel().theta)
    dsr = identifier("dsr", bootstrap=20)
    kept = identified(dsr, replace(problem, nominal=truth), rng)
    np.testing.assert_array_equal(kept.model.theta, truth.theta)
    assert kept.control_model is None
    assert kept.state_space is not None
    assert np.all(np.isnan(kept.std_error))
    dofs = [f.dof for f in kept.diagnostics if f.name == "worse_than_nominal"]
    assert dofs == list(truth.dofs)
    assert f"nominal equations: {', '.join(dofs)}: " in str(nominal_equations(kept.diagnostics))
    better = identified(dsr, problem, rng)
    assert nominal_equations(better.diagnostics) is None
    np.testing.assert_allclose(np.diag(better.model.inertia), np.diag(INERTIA), rtol=0.1)
    assert better.control_model is not None
    dropped = better.residual.terms.index(basis.term("|u|u"))
    assert np.all(np.isnan(better.std_error[dropped]))
    assert np.all(np.isfinite(np.delete(better.std_error, dropped, axis=0)))
    unchecked = identified(
        replace(dsr, physical_form="optional"), replace(problem, nominal=truth), rng
    )
    assert np.any(unchecked.residual.theta != 0.0)
    assert unchecked.control_model is not None


@pytest.mark.data
@pytest.mark.parametrize(
    ("vessel", "name"),
    [
        ("beluga_linear", "random-1"), ("beluga_diagonal", "surge-1"), ("beluga_full", "sway-1"),
        ("beluga_full", "heave-1"),
    ],
)  # fmt: skip
def test_a_measured_recording_gives_a_stable_model_no_worse_than_the_nominal_one(
    vessel: str, name: str
) -> None:
    path = f"{DATA}/beluga/{name}.csv"
    trial = composed(
        f"vessel={vessel}", "excitation=recording", f"excitation.path={path}", "identifier=dsr",
        "identifier.bootstrap=null", "evaluation=none", "controller=none",
    )  # fmt: skip
    excited = excite(trial, Streams(1))
    training, held_out = (excited.recording.part(p) for p in (excited.training, excited.testing))
    problem = Problem(training, held_out, trial.vessel.nominal(), trial.vessel.thruster)
    found = identified(trial.identifier, problem, np.random.default_rng(0))
    assert value(found, "spectral_radius") < 1.0 + 1e-6
    assert value(found, "predictor_radius") < 1.0
    whole = WholeTraining(problem)
    assert not whole.errors([found.model]).worse(whole.nominal)
    (form,) = [f for f in found.diagnostics if f.name == "physical_form"]
    assert form.value == 1.0 or form.label
    assert form.value == 1.0 or found.control_model is None


@pytest.mark.nightly
def test_standard_errors_are_the_spread_over_replications(identifier) -> None:
    """Twenty noisy recordings of a linear vessel: bootstrap and spread within a factor of 2."""
    masses, reported = [], []
    dsr = identifier("dsr", bootstrap=50)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        problem = problem_of(axis_recording(1600, rng, noise=0.02))
        found = dsr.identify(problem, rng)
        masses.append(np.diag(found.model.inertia))
        rows = [found.residual.terms.index(one) for one in basis.terms(["u_dot", "v_dot", "w_dot"])]
        reported.append(np.diag(found.std_error[rows]))
    ratio = np.mean(reported, axis=0) / np.std(masses, axis=0, ddof=1)
    assert np.all((ratio > 0.5) & (ratio < 2.0)), ratio
    coverage = np.mean(np.abs(masses - np.diag(INERTIA)) < 1.96 * np.array(reported))
    assert coverage > 0.8


def test_why_there_is_no_physical_form() -> None:
    model = linearise(linear_vessel()).discretised(0.5)
    with pytest.raises(IdentificationError, match="got 6 states, 3 inputs and 2 outputs"):
        physical_form(replace(model, C=model.C[:2], D=model.D[:2], outputs=()))
    with pytest.raises(IdentificationError, match="ill-conditioned"):
        physical_form(replace(model, C=model.C[[0, 1, 1]]))
    with pytest.raises(IdentificationError, match=r"an eigenvalue at -0\.2"):
        physical_form(replace(model, A=np.diag([0.9, 0.8, 0.7, 0.6, 0.5, -0.2])))
    with pytest.raises(IdentificationError, match="no effect on the acceleration"):
        physical_form(replace(model, B=model.B * [1.0, 1.0, 0.0]))
    with pytest.raises(IdentificationError, match="must be positive definite"):
        physical_form(replace(model, B=-model.B))


def test_without_a_physical_form_the_state_space_model_can_be_kept(identifier, rng) -> None:
    problem = problem_of(axis_recording(800, rng))
    kept = identifier("dsr", bootstrap=None, order=7, physical_form="optional")
    found = kept.identify(problem, rng)
    np.testing.assert_array_equal(found.model.theta, problem.nominal.theta)
    assert np.all(found.residual.theta == 0.0)
    assert found.std_error is None
    assert found.state_space.order == 7
    (reason,) = [f.label for f in found.diagnostics if f.name == "physical_form"]
    assert reason.startswith("no physical form: got 7 states")


def test_the_order_by_the_gap_is_the_physical_one(identifier, rng) -> None:
    problem = problem_of(axis_recording(800, rng, noise=0.001))
    found = identifier("dsr", bootstrap=None, order="gap").identify(problem, rng)
    assert value(found, "selected_order") == 6.0
