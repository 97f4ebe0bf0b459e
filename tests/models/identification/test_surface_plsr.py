"""Surface PLSR against scikit-learn one by one, and against the thesis."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from sklearn.cross_decomposition import PLSRegression

from seatrial.models.identification.plsr import columns, output_moment
from seatrial.models.identification.problem import lack_of_fit
from seatrial.models.identification.surface_plsr import local_minima, whole_surface
from tests.models.identification.known_results import diagnostics

THESIS_MSE = (487.1, 825.1, 1372.2)  # Jervan (2020), Table 4.6: N^2, N^2, (Nm)^2
SELECTED_MSE = (634.7, 894.2, 1563.2)  # Table 4.7


@pytest.fixture(scope="module")
def of_thesis(estimator):
    """of_thesis(option=value, ...) -> the identifier of the thesis: chosen on the test part."""
    return partial(estimator, "surface_plsr", force="commanded", validation="test", bootstrap=None)


@pytest.fixture(scope="module")
def thesis(calm, of_thesis):
    return of_thesis().identify(calm.problem, np.random.default_rng(0))


def test_the_whole_surface_is_stored(thesis) -> None:
    for dof in ("surge", "sway", "yaw"):
        points = {(f.i, f.j) for f in diagnostics(thesis, "surface_mse") if f.dof == dof}
        assert len(points) == 464
        assert points == {(i, j) for i in range(1, 31) for j in range(max(2, i), 31)}


def test_reaches_the_thesis(calm, thesis) -> None:
    rest = lack_of_fit(calm.problem.validation, thesis.model, "commanded")
    mse = np.mean(rest**2, axis=0)
    assert np.all(mse <= THESIS_MSE)
    for k, dof in enumerate(("surge", "sway", "yaw")):
        surface = [f.value for f in diagnostics(thesis, "surface_mse") if f.dof == dof]
        assert min(surface) == pytest.approx(mse[k], rel=1e-9)


def test_parsimony_costs_at_most_a_tenth(calm, of_thesis, thesis, rng) -> None:
    sparing = of_thesis(selection="parsimonious").identify(calm.problem, rng)
    rest = lack_of_fit(calm.problem.validation, sparing.model, "commanded")
    assert np.all(np.mean(rest**2, axis=0) <= SELECTED_MSE)
    for dof in ("surge", "sway", "yaw"):
        on_terms = [f.value for f in diagnostics(sparing, "order_mse") if f.dof == dof]
        order = next(f.value for f in diagnostics(sparing, "selected_order") if f.dof == dof)
        least = next(f.value for f in diagnostics(thesis, "selected_order") if f.dof == dof)
        assert order <= least
        assert on_terms[int(order) - 1] <= 1.1 * min(on_terms)
        assert all(value > 1.1 * min(on_terms) for value in on_terms[: int(order) - 1])


def test_local_minima_are_lower_than_their_neighbours() -> None:
    valley = np.array([[3.0, 1.0, 3.0, 4.0], [3.0, 3.0, 2.5, 4.0], [4.0, 5.0, 4.0, 2.0]])
    valley[1, 0] = np.nan  # no model
    assert local_minima(valley) == [(0, 1), (2, 3)]
    assert local_minima(np.ones((3, 3))) == []


def test_a_local_minimum_of_lower_order_is_a_candidate(lap, of_thesis) -> None:
    """Jervan (2020), 4.5.1: a much lower order at almost the MSE of the minimum, as in sway."""
    problem = lap("noise", 0).problem
    found = {
        selection: of_thesis(selection=selection).identify(problem, np.random.default_rng(0))
        for selection in ("parsimonious", "local_minima")
    }
    orders: dict[str, list[int]] = {"parsimonious": [], "local_minima": []}
    for dof in ("surge", "sway", "yaw"):
        surface = np.full((30, 30), np.nan)
        for f in diagnostics(found["local_minima"], "surface_mse"):
            if f.dof == dof:
                surface[f.i - 1, f.j - 1] = f.value
        minimum = np.unravel_index(np.nanargmin(surface), surface.shape)
        for selection, result in found.items():
            order, count = (
                next(int(f.value) for f in diagnostics(result, name) if f.dof == dof)
                for name in ("selected_order", "selected_variables")
            )
            candidates = [minimum, *(local_minima(surface) if selection == "local_minima" else [])]
            assert count in {at[1] + 1 for at in candidates if at[0] <= minimum[0]}
            errors = [f.value for f in diagnostics(result, "order_mse") if f.dof == dof]
            of_minimum = [
                f.value for f in diagnostics(found["parsimonious"], "order_mse") if f.dof == dof
            ]
            assert errors[order - 1] <= 1.1 * min(of_minimum)
            orders[selection].append(order)
    assert np.all(np.subtract(orders["parsimonious"], orders["local_minima"]) >= 0)
    assert orders["local_minima"][1] <= 0.5 * orders["parsimonious"][1]


def one_by_one(x: np.ndarray, y: np.ndarray, orders: range) -> dict[tuple[int, int], np.ndarray]:
    """Theta_pre of every (order, number of terms) by scikit-learn."""
    found = {}
    for order in orders:
        kept = np.arange(x.shape[1])
        while len(kept) >= max(2, order):
            coefficients = PLSRegression(order, scale=False).fit(x[:, kept], y).coef_[0]
            theta = np.zeros(x.shape[1])
            theta[kept] = coefficients
            found[order, len(kept)] = theta
            kept = np.delete(kept, np.argmin(np.abs(coefficients)))
    return found


def standard(calm, estimator) -> tuple:
    surface = estimator("surface_plsr", force="commanded")
    problem = calm.problem
    z = columns(surface.samples(problem.training, problem.nominal, problem.thruster))
    return z, z.x[:, 1:] / z.beta


def test_equals_scikit_learn_one_by_one(calm, estimator) -> None:
    z, x = standard(calm, estimator)
    moment = z.z.T @ z.z
    for k in range(3):
        ours = whole_surface(output_moment(moment, z.n_x, k), z.beta)
        theirs = one_by_one(x, z.y[:, k], range(1, 6))
        for (order, count), theta in theirs.items():
            found = ours[order - 1, count - 1, 1:, 0] * z.beta
            np.testing.assert_allclose(found, theta, atol=1e-7)


def test_filtered_force_makes_the_fit_exact(calm, estimator, rng) -> None:
    # The force is identifiable to the last digits, single coefficients are not: while surge is
    # never backward ur and |u|r are one column, and the surface may keep either.
    found = estimator("surface_plsr", force="filtered", bootstrap=None).identify(calm.problem, rng)
    training = calm.problem.training
    left = np.mean(np.square(lack_of_fit(training, found.model, "filtered")), axis=0)
    before = np.mean(np.square(lack_of_fit(training, calm.problem.nominal, "filtered")), axis=0)
    assert np.all(left < 1e-12 * before)


def test_stages_add_up_and_never_make_it_worse(calm, of_thesis, thesis, rng) -> None:
    staged = of_thesis(stages=3).identify(calm.problem, rng)
    total = staged.stages[0] + staged.stages[1] + staged.stages[2]
    np.testing.assert_allclose(total.theta, staged.residual.theta, atol=1e-9)
    np.testing.assert_allclose(staged.stages[0].theta, thesis.residual.theta, rtol=1e-12)
    mse = [
        np.mean(lack_of_fit(calm.problem.validation, one.model, "commanded") ** 2, axis=0)
        for one in (thesis, staged)
    ]
    assert np.all(mse[1] <= mse[0] * (1.0 + 1e-9))
    stored = [f for f in diagnostics(staged, "stage_coefficient") if f.i == 1 and f.dof == "surge"]
    assert {f.label for f in stored} == {
        str(one)
        for one, row in zip(staged.stages[0].terms, staged.stages[0].theta, strict=True)
        if row[0]
    }


def test_nothing_to_learn_adds_nothing(lap, estimator, rng) -> None:
    sailed = lap("noise", 0)
    training = sailed.problem.training
    noise = rng.standard_normal(training.nu.shape)
    fitted = sailed.truth.inverse(training.nu_dot, training.nu, training.attitude)
    training = replace(training, tau_actual=fitted + noise)
    problem = replace(sailed.problem, training=training, nominal=sailed.truth, thruster=None)
    found = estimator("surface_plsr", force="actual", bootstrap=None).identify(problem, rng)
    assert [f.value for f in diagnostics(found, "selected_order")].count(0.0) >= 2


def test_bootstrap_errors_are_of_the_terms_that_stay(lap, estimator, rng) -> None:
    surface = estimator("surface_plsr", lowpass_hz=0.5, bootstrap=50)
    found = surface.identify(lap("noise", 0).problem, rng)
    assert np.all((found.std_error > 0.0) == (found.residual.theta != 0.0))
