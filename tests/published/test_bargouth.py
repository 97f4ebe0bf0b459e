"""Bargouth (2022): responses that are told, and the linearised model, against an exact solution."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from docs.published.linearised import Linearised, tangent
from docs.vessels import parameters_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.linearisation import linearise
from seatrial.models.vessel import basis
from seatrial.models.vessel.derivatives import derivative_table
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.wind import Windage
from seatrial.runner.record.rows import Results
from tests.published.conftest import Run, Values

CURRENT = ("identifier.velocity={surge:0.024,sway:0.009}", "identifier.operating_force=false")


@pytest.mark.slow
def test_lq_without_limits_takes_the_times_and_forces_that_are_told(
    run: Run, metric: Values
) -> None:
    """Section 4.6.1: 2.5 and 3 min in sway, 4.5e5 N, 6e6 Nm; other weather than the source's."""
    runs = [
        run("experiment=bargouth_section_4_6", "controller.limited=false", f"seed={seed}")
        for seed in range(10)
    ]

    def mean(name: str, dof: str) -> float:
        return float(np.mean([metric(one, name, "nominal")[dof] for one in runs]))

    assert 150.0 <= mean("settling_time", "sway") <= 180.0
    assert mean("tau_max_abs", "sway") == pytest.approx(4.5e5, rel=0.1)
    assert mean("tau_max_abs", "yaw") == pytest.approx(6e6, rel=0.2)


def test_with_the_printed_drag_the_linear_model_drifts_as_the_vessel_but_turns_not_so(
    run: Run,
) -> None:
    """Section 4.2: two double integrators in surge and sway; what is left goes with the step."""
    errors = {}
    for period in (1.0, 0.5):
        one = run(
            "experiment=bargouth_section_4_2", "vessel.parameters=as_printed",
            f"sample_time_s={period}", f"integration_step_s={period}",
        )  # fmt: skip
        errors[period] = diagnostic(one, "body_pose_rmse_free_run")
    for dof in ("surge", "sway"):
        assert errors[0.5][dof] == pytest.approx(0.5 * errors[1.0][dof], rel=0.05)
        assert diagnostic(one, "fit_free_run")[dof] > 99.0
    assert diagnostic(one, "fit_free_run")["yaw"] < 0.0


def diagnostic(results: Results, name: str) -> dict[str, float | None]:
    """Value by degree of freedom."""
    return {row.dof: row.value for row in results.diagnostics if row.name == name}


@pytest.mark.parametrize(
    ("parameters", "options", "at_one"),
    [("as_printed", (), 6), ("physical", (), 6), ("physical", CURRENT, 4)],
)
def test_the_linear_model_is_controllable_and_observable_but_not_stable(
    run: Run, parameters: str, options: tuple[str, ...], at_one: int
) -> None:
    """Section 4.3: ranks 6 and 6; eigenvalues of 0.999 belong to a current of some cm/s."""
    one = run("experiment=bargouth_section_4_3", f"vessel.parameters={parameters}", *options)
    assert diagnostic(one, "controllable_order") == diagnostic(one, "observable_order")
    assert diagnostic(one, "controllable_order")["all"] == 6.0
    assert diagnostic(one, "spectral_radius")["all"] == pytest.approx(1.0)
    assert diagnostic(one, "eigenvalues_at_one")["all"] == at_one
    values = [row.value for row in one.diagnostics if row.name == "eigenvalue_real"]
    assert sum(round(value or 0.0, 3) == 0.999 for value in values) == 6 - at_one


# The linearised model.

MASS, DRAG = (2.4e7, 4.0e7, 4.5e10), (5.0e4, 22.0e4, 1.2e10)  # of the supply vessel, physical
WINDAGE = Windage(500.0, 1100.0, 73.2, 0.6, 0.8, 0.1, 1.23)
SUPPLY = parameters_of("supply_vessel").nominal()


def linearised(problem: Problem, **changes: Any) -> Identified:
    options: dict[str, Any] = dict.fromkeys(("velocity", "wind", "force", "hold_s"))
    identifier = Linearised(**(options | {"operating_force": True} | changes))
    return identifier.identify(problem, np.random.default_rng(0))


def found(one: Identified, name: str) -> list[float]:
    return [diagnostic.value for diagnostic in one.diagnostics if diagnostic.name == name]


def matrix(one: Identified, name: str) -> np.ndarray:
    return np.asarray(getattr(one.state_space, name))


def drifting(nominal: Vessel, tau: np.ndarray, wind: np.ndarray | None = None) -> Problem:
    """A linear vessel under held forces, at its heading: the exact solution, by zero-order hold."""
    names = basis.terms(["u_dot", "v_dot", "r_dot", "u", "v"])
    slopes = [[2e4, 0.0, 0.0], [0.0, 5e4, 0.0]]
    linear = Vessel("linear", PLANAR, names, np.vstack([np.diag(MASS), slopes]))
    model = linearise(linear).discretised(1.0)
    eta, nu = model.simulate(tau), replace(model, C=np.eye(3, 6, 3)).simulate(tau)
    attitude = np.column_stack([np.zeros((len(eta), 2)), eta[:, 2]])
    t = np.arange(float(len(tau)))
    recording = Recording(PLANAR, t, eta, nu, np.zeros_like(nu), tau, attitude, wind=wind)
    return Problem(recording, recording, nominal if nominal.terms else linear, None)


PUSHED = np.tile([3e4, 1e4, 0.0], (400, 1))  # ahead and sideways, without turning
ITSELF = Vessel("none", PLANAR, (), np.zeros((0, 3)))  # the nominal model is the linear vessel


@pytest.mark.parametrize(("hold_s", "speed"), [(10.0, 0.5), (1.0, 5.0)])
def test_the_matrices_are_those_of_the_source_sampled_exactly(hold_s: float, speed: float) -> None:
    """(4.1), with -2 d |v_c| / m on its diagonal, and the zero-order hold of one axis by hand."""
    options = {"velocity": {"surge": speed, "sway": -speed}, "operating_force": False}
    one = linearised(drifting(SUPPLY, PUSHED), hold_s=hold_s, **options)
    A, B = matrix(one, "A"), matrix(one, "B")
    for i in (0, 1):
        rate = 2.0 * DRAG[i] * speed / MASS[i]
        held = np.exp(-rate * hold_s)
        assert A[3 + i, 3 + i] == pytest.approx(held)
        assert A[i, 3 + i] == pytest.approx((1.0 - held) / rate)
        assert B[3 + i, i] == pytest.approx((1.0 - held) / (rate * MASS[i]))
        assert B[i, i] == pytest.approx((hold_s - (1.0 - held) / rate) / (rate * MASS[i]))
    assert A[5, 5] == 1.0
    assert found(one, "eigenvalues_at_one") == [4.0]


def test_the_free_run_of_a_linear_vessel_is_exact_in_every_part() -> None:
    """Parts of a recording each begin where they were measured."""
    problem = drifting(ITSELF, PUSHED)
    whole = problem.validation
    cut = whole.part((whole.t < 100.0) | (whole.t >= 250.0))
    for one in (linearised(problem), linearised(replace(problem, validation=cut))):
        assert found(one, "body_pose_rmse_free_run") == pytest.approx([0.0] * 3, abs=1e-6)
    one = linearised(problem)
    assert found(one, "fit_free_run")[:2] == pytest.approx([100.0, 100.0], abs=1e-6)
    assert found(one, "body_drift") == pytest.approx(list(np.abs(whole.eta[-1])))


def test_the_constant_of_a_tangent_is_an_input() -> None:
    """A steady motion at the point itself: the tangent keeps it, its slopes alone do not."""
    steady = np.tile([DRAG[0], 0.0, 0.0], (300, 1))
    t = np.arange(300.0)
    nu = np.tile([1.0, 0.0, 0.0], (300, 1))
    eta = np.column_stack([t, 0.0 * t, 0.0 * t])
    recording = Recording(PLANAR, t, eta, nu, 0.0 * nu, steady, 0.0 * nu)
    one, without = (
        linearised(
            Problem(recording, recording, SUPPLY, None),
            velocity={"surge": 1.0}, operating_force=flag,
        )
        for flag in (True, False)
    )  # fmt: skip
    assert found(one, "body_pose_rmse_free_run") == pytest.approx([0.0] * 3, abs=1e-6)
    assert found(without, "body_pose_rmse_free_run")[0] > 10.0


def test_measured_wind_is_a_known_input_and_otherwise_there_is_none() -> None:
    """B F_w of (3.30), with the B of the forces; calm weather is measured without one."""
    blown = drifting(ITSELF, 0.0 * PUSHED, np.tile([0.0, 30.0], (400, 1)))
    one = linearised(blown, wind=WINDAGE)
    names = [t.name for t in one.model.terms if "_q" in t.name]
    assert set(names) >= {"V_qu_q", "V_qv_q", "u_qv_q"}
    expected = -matrix(linearised(blown), "B") @ one.model.on(basis.terms(names)).theta.T
    np.testing.assert_allclose(matrix(one, "B")[:, 3:], expected, rtol=1e-12)
    calm = linearised(drifting(ITSELF, PUSHED), wind=WINDAGE).model
    assert not calm.force_table().aerodynamic


def test_a_tangent_has_the_force_and_the_finite_differences_of_the_table() -> None:
    """Its slopes do without the offset, it is its own tangent, and it leaves the air alone."""
    windage = {"X_|u_q|u_q": -9.0, "Y_|v_q|v_q": -30.0, "N_V_qv_q": -4.0}
    ferry = parameters_of("milliampere").nominal()
    nu, still, h = np.array([0.5, -0.2, 0.1]), np.zeros((1, 3)), 1e-5
    flat, slopes = tangent(ferry, nu), tangent(ferry, nu, offset=False)
    force = ferry.inverse(still, nu[None, :])
    np.testing.assert_allclose(flat.inverse(still, nu[None, :]), force, rtol=1e-9, atol=1e-6)
    for step, name in zip(h * np.eye(3), ("u", "v", "r"), strict=True):
        up, down = (ferry.inverse(still, (nu + s * step)[None, :])[0] for s in (1.0, -1.0))
        np.testing.assert_allclose(flat.row(name), (up - down) / (2.0 * h), rtol=1e-5, atol=1e-4)
        np.testing.assert_array_equal(slopes.row(name), flat.row(name))
    assert {one.name for one in flat.terms} <= {"u_dot", "v_dot", "r_dot", "u", "v", "r", "1"}
    assert "1" not in {one.name for one in slopes.terms}
    np.testing.assert_array_equal(flat.inertia, ferry.inertia)
    windy = ferry + derivative_table("wind", PLANAR, windage)
    once = tangent(windy, nu)
    again = tangent(once, np.array([-1.0, 2.0, 0.3]))
    np.testing.assert_allclose((again - once).theta, 0.0, atol=1e-9)
    air = [one for one in windy.terms if "_q" in one.name]
    np.testing.assert_array_equal(once.on(air).theta, windy.on(air).theta)


def test_a_velocity_that_the_vessel_has_not_is_refused() -> None:
    identifier = Linearised({"heave": 1.0}, True, None, None, None)
    with pytest.raises(ConfigurationError, match=r"identifier.velocity: got heave, but supply_v"):
        identifier.check(SUPPLY, None, False)
