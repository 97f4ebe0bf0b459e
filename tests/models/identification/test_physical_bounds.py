"""Default bounds of free parameters: what physics says, before any data."""

import numpy as np
import pytest

from seatrial.models.identification.free_parameters import free_parameters
from seatrial.models.identification.physical_constraints import POWER_MARGIN

EULER = {"integrator": "euler"}


def bounds_of(option, free, recording):
    return dict(zip(free.labels, np.transpose(option.box(free, recording)), strict=True))


@pytest.mark.parametrize("name", ["output_error", "nsga2"])
def test_inertia_within_a_factor_and_damping_of_one_sign(identifier, calm, name) -> None:
    option, recording = identifier(name), calm.problem.training
    free = option.unknowns(calm.problem.nominal)
    bounds = bounds_of(option, free, recording)
    nominal = dict(zip(free.labels, free.values, strict=True))
    for label in ("surge.u_dot", "sway.v_dot", "yaw.r_dot"):
        np.testing.assert_allclose(bounds[label], np.array([0.2, 5.0]) * nominal[label])
    M = calm.problem.nominal.inertia
    np.testing.assert_allclose(bounds["sway.r_dot"], np.array([-1, 1]) * np.sqrt(M[1, 1] * M[2, 2]))
    for label in ("surge.u", "surge.|u|u", "surge.u^3", "sway.v", "yaw.r", "yaw.|r|r"):
        np.testing.assert_allclose(bounds[label], [0.0, 5.0 * nominal[label]])
    assert bounds["yaw.v"][0] < 0.0 < bounds["yaw.v"][1]  # of another axis: either sign
    assert bounds["yaw.|v|v"][0] < 0.0 < bounds["yaw.|v|v"][1]
    assert np.all(np.isfinite(list(bounds.values())))


def test_off_diagonal_inertia_leaves_every_two_axes_positive_definite(identifier, vessel) -> None:
    nominal = vessel("beluga_full")
    free = free_parameters(nominal, None, "tied", False)
    lower, upper = identifier("output_error").box(free)
    M = nominal.inertia
    for label, low, high in zip(free.labels, lower, upper, strict=True):
        dof, _, term = label.partition(".")
        if term not in nominal.accelerations:
            continue
        i, j = nominal.dofs.index(dof), nominal.accelerations.index(term)
        if i != j:
            for value in (low, high):
                pair = np.array([[M[i, i], value], [value, M[j, j]]])
                assert np.linalg.eigvalsh(pair)[0] > -1e-9 * np.max(pair)


def test_a_parameter_nominal_zero_is_bounded_by_the_force_it_would_explain(
    identifier, make, signal
) -> None:
    truth = make.surge(60.0, 20.0)
    problem = make.problem(truth, truth, signal("many_sine"))
    option = identifier("output_error", parameters=["surge.u", "surge.u^2"], **EULER)
    free = option.unknowns(truth)
    training = problem.training
    size = np.std(training.tau) / np.sqrt(np.mean(training.nu**4))
    bounds = bounds_of(option, free, training)
    np.testing.assert_allclose(bounds["surge.u^2"], [-5.0 * size, 5.0 * size])


def test_a_drag_that_creates_energy_stops_above_zero_and_no_bounds_let_it_pass(
    identifier, make, signal
) -> None:
    """A plant whose drag pushes: it keeps a little of the nominal drag; unbounded, the truth."""
    truth, nominal = make.surge(60.0, -1.0), make.surge(50.0, 20.0)
    problem = make.problem(truth, nominal, signal("many_sine"))
    far = EULER | {"derivative_limit": 1e3}
    bounded = identifier("output_error", **far).identify(problem, None)
    assert 0.0 <= bounded.model.coefficient("surge", "u") <= POWER_MARGIN * 20.0 + 1e-6
    active = [one.label for one in bounded.diagnostics if one.name == "active_constraint"]
    assert active == ["dissipation"]
    free = identifier("output_error", inertia_factor=None, **far).identify(problem, None)
    assert free.model.coefficient("surge", "u") == pytest.approx(-1.0, rel=1e-6)
    assert not [one for one in free.diagnostics if one.name.startswith("active_")]
