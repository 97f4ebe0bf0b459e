"""The linearised model: against Bargouth's matrices, an exact solution, and the vessel itself."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.linearised import Linearised
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.linearisation import linearise
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.wind import Windage

MASS, DRAG = (2.4e7, 4.0e7, 4.5e10), (5.0e4, 22.0e4, 1.2e10)  # of the supply vessel, physical
RNG = np.random.default_rng(0)
WINDAGE = Windage(500.0, 1100.0, 73.2, 0.6, 0.8, 0.1, 1.23)


def linearised(**changes: Any) -> Linearised:
    options: dict[str, Any] = dict.fromkeys(("velocity", "wind", "force", "hold_s"))
    return Linearised(**(options | {"operating_force": True} | changes))


def found(one: Identified, name: str) -> list[float]:
    return [finding.value for finding in one.findings if finding.name == name]


def matrix(one: Identified, name: str) -> np.ndarray:
    return np.asarray(getattr(one.state_space, name))


def moved_by(vessel: Vessel, tau: np.ndarray, period_s: float, wind=None) -> Recording:
    """A linear vessel under held forces, at its heading: the exact solution, by zero-order hold."""
    model = linearise(vessel).discretised(period_s)
    eta = model.simulate(tau)
    nu = replace(model, C=np.eye(3, 6, 3)).simulate(tau)
    attitude = np.column_stack([np.zeros((len(eta), 2)), eta[:, 2]])
    t = period_s * np.arange(len(tau))
    still = np.zeros_like(nu)
    return Recording(PLANAR, t, eta, nu, still, tau, attitude, wind=wind)


def linear_vessel() -> Vessel:
    names = basis.terms(["u_dot", "v_dot", "r_dot", "u", "v"])
    slopes = [[2e4, 0.0, 0.0], [0.0, 5e4, 0.0]]
    return Vessel("linear", PLANAR, names, np.vstack([np.diag(MASS), slopes]))


def drifting(tau: np.ndarray | None = None, wind: np.ndarray | None = None) -> Problem:
    """Straight ahead and sideways, without turning."""
    pushed = np.tile([3e4, 1e4, 0.0], (400, 1)) if tau is None else tau
    recording = moved_by(linear_vessel(), pushed, 1.0, wind)
    return Problem(recording, recording, linear_vessel(), None)


@pytest.mark.parametrize(("hold_s", "speed"), [(10.0, 0.5), (1.0, 5.0)])
def test_the_matrices_are_those_of_the_source_sampled_exactly(vessel, hold_s, speed) -> None:
    """(4.1), with -2 d |v_c| / m on its diagonal, and the zero-order hold of one axis by hand."""
    problem = Problem(*[drifting().training] * 2, vessel("supply_vessel"), None)
    options = {"velocity": {"surge": speed, "sway": -speed}, "operating_force": False}
    one = linearised(hold_s=hold_s, **options).identify(problem, RNG)
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


def test_at_rest_a_quadratic_drag_leaves_three_double_integrators(vessel) -> None:
    """Bargouth (2022), section 4.3: ranks 6 and 6; not stable, other than it says."""
    problem = Problem(*[drifting().training] * 2, vessel("supply_vessel"), None)
    one = linearised(hold_s=10.0).identify(problem, RNG)
    expected = np.eye(6) + 10.0 * np.eye(6, k=3)
    np.testing.assert_allclose(matrix(one, "A"), expected, atol=1e-12)
    assert found(one, "controllable_order") == found(one, "observable_order") == [6.0]
    assert found(one, "spectral_radius") == pytest.approx([1.0])
    assert found(one, "eigenvalues_at_one") == [6.0]


def test_the_free_run_of_a_linear_vessel_is_exact() -> None:
    one = linearised().identify(drifting(), RNG)
    assert found(one, "body_pose_rmse_free_run") == pytest.approx([0.0] * 3, abs=1e-6)
    assert found(one, "fit_free_run")[:2] == pytest.approx([100.0, 100.0], abs=1e-6)
    drift = drifting().validation.eta[-1]
    assert found(one, "body_drift") == pytest.approx(list(np.abs(drift)))


def test_parts_of_a_recording_each_begin_where_they_were_measured() -> None:
    whole = drifting().validation
    cut = whole.part((whole.t < 100.0) | (whole.t >= 250.0))
    problem = Problem(whole, cut, linear_vessel(), None)
    one = linearised().identify(problem, RNG)
    assert found(one, "body_pose_rmse_free_run") == pytest.approx([0.0] * 3, abs=1e-6)


def test_a_tangent_at_a_velocity_knows_the_force_there(vessel) -> None:
    """At 1 m/s ahead the drag is d1, its slope 2 d1: -d1 are left at rest."""
    problem = Problem(*[drifting().training] * 2, vessel("supply_vessel"), None)
    one = linearised(velocity={"surge": 1.0}).identify(problem, RNG).model
    assert one.coefficient("surge", "u") == pytest.approx(2.0 * DRAG[0])
    assert one.coefficient("surge", "1") == pytest.approx(-DRAG[0])
    with_slopes = linearised(velocity={"surge": 1.0}, operating_force=False)
    assert with_slopes.identify(problem, RNG).model.coefficient("surge", "1") == 0.0


def test_the_constant_of_a_tangent_is_an_input(vessel) -> None:
    """A steady motion at the point itself: the tangent keeps it, its slopes alone do not."""
    steady = np.tile([DRAG[0], 0.0, 0.0], (300, 1))
    t = np.arange(300.0)
    nu = np.tile([1.0, 0.0, 0.0], (300, 1))
    eta = np.column_stack([t, 0.0 * t, 0.0 * t])
    recording = Recording(PLANAR, t, eta, nu, 0.0 * nu, steady, 0.0 * nu)
    problem = Problem(recording, recording, vessel("supply_vessel"), None)
    one, without = (
        linearised(velocity={"surge": 1.0}, operating_force=flag).identify(problem, RNG)
        for flag in (True, False)
    )
    assert found(one, "body_pose_rmse_free_run") == pytest.approx([0.0] * 3, abs=1e-6)
    assert found(without, "body_pose_rmse_free_run")[0] > 10.0


def test_measured_wind_is_a_known_input_and_otherwise_there_is_none() -> None:
    """B F_w of (3.30), with the B of the forces; calm weather is measured without one."""
    model, blown = linear_vessel(), drifting(np.zeros((400, 3)), np.tile([0.0, 30.0], (400, 1)))
    one = linearised(wind=WINDAGE).identify(blown, RNG)
    assert {t.name for t in one.model.terms} >= {"V_qu_q", "V_qv_q", "u_qv_q"}
    B, names = matrix(one, "B"), [t.name for t in one.model.terms if "_q" in t.name]
    own = matrix(linearised().identify(blown, RNG), "B")
    expected = -own @ one.model.on(basis.terms(names)).theta.T
    np.testing.assert_allclose(B[:, 3:], expected, rtol=1e-12)
    calm = linearised(wind=WINDAGE).identify(drifting(), RNG).model
    np.testing.assert_array_equal(calm.on(model.terms).theta, model.theta)
    assert not calm.force_table().aerodynamic


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hold_s": 0.0}, "hold_s must be positive or null, got 0"),
        ({"force": "wanted"}, "force: got 'wanted', expected one of"),
    ],
)
def test_impossible_options_are_refused(changes, message) -> None:
    with pytest.raises(ConfigurationError, match=message):
        linearised(**changes)


def test_a_velocity_that_the_vessel_has_not_is_refused(vessel) -> None:
    with pytest.raises(ConfigurationError, match=r"identifier.velocity: got heave, but supply_v"):
        linearised(velocity={"heave": 1.0}).check(vessel("supply_vessel"), None, False)


def test_a_hold_longer_than_what_is_held_out_is_refused() -> None:
    with pytest.raises(IdentificationError, match=r"hold_s: got 1000 s, expected at most the 400"):
        linearised(hold_s=1000.0).identify(drifting(), RNG)
