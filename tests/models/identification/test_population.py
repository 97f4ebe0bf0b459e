"""Many candidates in one call against one at a time; and unrealistic ones."""

import numpy as np
import pytest

from seatrial.models.identification.free_parameters import free_parameters
from seatrial.models.identification.free_run import (
    METRICS,
    course_of,
    deviations,
    predict,
    predicted_layout,
)
from seatrial.models.identification.objectives import Objectives
from seatrial.models.identification.predictor import Predictor
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.packs import WIDTH
from seatrial.models.vessel.basis import terms
from seatrial.models.vessel.table import Vessel


def predictor(model, recording, integrator, horizon=None, limit=10.0):
    free = free_parameters(model, None, "tied", model.dofs == PLANAR)
    plan = predicted_layout(free.nominal, free.support)
    course = course_of(recording, None, None, horizon, limit, model.attitude)
    return Predictor(free, plan, course, integrator)


def errors_of(measured, e, metric):
    if metric == "smape":
        size = 0.5 * (np.abs(measured) + np.abs(measured + e))
        share = np.divide(np.abs(e), size, out=np.zeros_like(e), where=size > 0.0)
        return 100.0 * share.mean(axis=0)
    mean = {"mae": np.abs(e), "mse": e**2, "mean_error": e}[metric].mean(axis=0)
    return np.abs(mean)


@pytest.fixture
def example(vessel, make):
    """example(name) -> a vessel and what it does under some force, with noise."""

    def chosen(name):
        t = 0.1 * np.arange(400)[:, None]
        if name == "surge":
            return vessel("surge_nonlinear"), make.forced(30.0 * np.sin(t), ("surge",))
        if name == "any drag":
            drag = np.linspace(20.0, 1.0, 7)[:, None]
            names = ["u_dot", "1", "u", "uu", "|u|", "|u|u", "u^3", "|u|uu"]
            model = Vessel("drag", ("surge",), terms(names), np.vstack([[[60.0]], drag]))
            return model, make.forced(30.0 * np.sin(t), ("surge",))
        if name == "tumbling beluga":
            tau = np.array([20.0, 20.0, 20.0, 8.0, 10.0, 6.0]) * np.sin(t * np.arange(1.0, 7.0))
            return vessel("beluga_diagonal"), make.driven(vessel("beluga_diagonal"), tau, "rk4")
        model = vessel("milliampere")
        if name == "blown ferry":
            areas = np.diag([40.0, 60.0, 30.0])
            model = model + Vessel("air", PLANAR, terms(["V_qu_q", "|v_q|v_q", "V_q"]), areas)
        return model, make.driven(
            vessel("milliampere"), 150.0 * np.sin(t * np.array([1.0, 0.7, 0.4])), noise=0.01
        )

    return chosen


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
@pytest.mark.parametrize("name", ["any drag", "blown ferry", "tumbling beluga"])
def test_population_equals_one_at_a_time(example, name, integrator):
    one = predictor(*example(name), integrator, horizon=150)
    rng = np.random.default_rng(1)
    factors = rng.uniform(0.8, 1.25, (2 * WIDTH + 9, len(one.free)))
    points = one.free.values * factors
    alone = [one.mismatch(point) for point in points]
    for metric in METRICS:
        errors, _, realistic = one.errors(points, metric)
        assert np.all(realistic)
        expected = [errors_of(one.course.measured, e, metric) for e in alone]
        np.testing.assert_allclose(errors, expected, rtol=1e-12, atol=1e-12, err_msg=metric)


@pytest.mark.parametrize("name", ["surge", "ferry", "tumbling beluga"])
def test_states_of_many_equal_one_at_a_time(example, name):
    """Models and initial states of their own; one whose inertia is impossible touches no other."""
    one = predictor(*example(name), "rk4", horizon=150)
    rng = np.random.default_rng(2)
    points = one.free.values * rng.uniform(0.8, 1.25, (WIDTH + 3, len(one.free)))
    points[4] *= -1.0
    begin = np.count_nonzero(one.course.restart)
    offsets = 0.01 * rng.standard_normal((len(points), begin, 2 * len(one.free.nominal.dofs)))
    states = one.predict_many(points, offsets)
    expected = [one.predict(point, own) for point, own in zip(points, offsets, strict=True)]
    np.testing.assert_allclose(states, expected, rtol=1e-12, atol=1e-12)
    assert np.all(np.isnan(states[4]))


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
@pytest.mark.parametrize("drag", ["linear", "square"])
def test_those_that_reach_a_limit_equal_one_at_a_time(make, signal, drag, integrator, metric):
    """Some candidates of a pack reach the limits and run away; the others are not touched."""
    truth = make.surge(60.0, 20.0, *(("uu", 2.0) if drag == "square" else ()))
    recording = make.forced(signal("many_sine"), ("surge",))
    one = predictor(truth, recording, integrator, horizon=150, limit=2.0)
    m = len(one.free)
    box = np.array([[10.0, 1.0, 0.0], [120.0, 40.0, 10.0]])[:, :m]
    points = np.random.default_rng(3).uniform(*box, (2 * WIDTH + 9, m))
    points[5, 0] = 1e-300  # overflows without limits
    errors, limited, _ = one.errors(points, metric)
    assert 0.1 < np.mean(limited > 0.0) < 0.9
    course, stages = one.course, 4 if integrator == "rk4" else 1
    states = np.empty_like(course.reached)
    for i, point in enumerate(points):
        table = one.free.tables(point[None])
        plant = one.plan.plant(table[0], one.plan.inverse_inertia(table)[0][..., 0])
        count = predict(plant, course, integrator == "euler", states)
        assert limited[i] == count / (stages * states.size)
        e = deviations(course.kinematics, course.reached, states)
        expected = errors_of(course.measured, e, metric)
        np.testing.assert_allclose(errors[i], expected, rtol=1e-12, atol=1e-12)


def test_square_drag_runs_away_in_44_percent_of_the_box_and_is_penalised(make, signal):
    """u^2 drag pushes a vehicle that goes backward; |u|u brakes it."""
    box = np.random.default_rng(0).uniform([10.0, 1.0, 0.0], [120.0, 40.0, 10.0], (5000, 3))
    truth = make.surge(60.0, 20.0, "uu", 2.0)
    recording = make.driven(truth, signal("many_sine"))
    one = predictor(truth, recording, "euler")
    for metric in METRICS:
        objectives = Objectives(one, metric, grouped=False)
        values = objectives(box)
        assert np.all(np.isfinite(values))
        _, limited, _ = one.errors(box, metric)
        away = limited > 0.0
        assert np.mean(away) == pytest.approx(0.44, abs=0.02)
        assert np.min(values[away]) >= objectives.penalty
    brakes = predictor(make.surge(60.0, 20.0, "|u|u", 2.0), recording, "euler")
    assert np.mean(brakes.errors(box, "mae")[1] > 0.0) < 0.01


@pytest.mark.parametrize("metric", METRICS)
def test_no_candidate_gives_nan(vessel, make, metric):
    """Inertia that is zero, negative or not positive definite, and huge drag of both signs."""
    model = vessel("milliampere")
    recording = make.forced(np.full((200, 3), 300.0), PLANAR)
    one = predictor(model, recording, "rk4")
    rng = np.random.default_rng(2)
    wild = one.free.values * rng.choice([-1e6, -1.0, 0.0, 1.0, 1e6], (300, len(one.free)))
    objectives = Objectives(one, metric, grouped=False)
    values = objectives(wild)
    assert np.all(np.isfinite(values))
    _, limited, realistic = one.errors(wild, metric)
    worse = (limited > 0.0) | ~realistic
    assert np.sum(~realistic) > 100
    assert np.any(worse & realistic)
    assert np.min(values[worse]) >= objectives.penalty
    assert np.all(Objectives(one, metric, grouped=True)(wild).shape == np.array([300, 2]))


def test_grouped_objectives_are_means_over_the_spread(make):
    t = 0.1 * np.arange(300)[:, None]
    tau = np.array([20.0, 20.0, 20.0, 2.0, 2.0, 2.0]) * np.sin(t * np.arange(1.0, 7.0))
    diagonal = np.diag([60.0, 70.0, 80.0, 4.0, 5.0, 6.0])
    model = Vessel("d", DOFS, terms(["u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot"]),
                   diagonal)  # fmt: skip
    one = predictor(model, make.driven(model, tau), "euler")
    points = one.free.values * np.array([[1.1], [0.9]])
    errors = one.errors(points, "mae")[0] / one.spread
    expected = np.column_stack([errors[:, :6].mean(axis=1), errors[:, 6:].mean(axis=1)])
    np.testing.assert_allclose(Objectives(one, "mae", grouped=True)(points), expected)
