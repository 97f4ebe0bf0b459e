"""Predictions against an integration in plain Python, exact solutions and the simulated ferry."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from seatrial.models.errors import RecordingError
from seatrial.models.identification.free_parameters import free_parameters
from seatrial.models.identification.free_run import (
    course_of,
    deviations,
    free_run,
    held_force,
    predict,
    predicted_layout,
)
from seatrial.models.identification.validation import prediction
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel.basis import terms
from seatrial.models.vessel.kinematics import angle_rate, frame_of_angles, in_body
from seatrial.models.vessel.pose import Euler, Quaternion, displaced, state_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite
from tests.trials import composed, excited

FAR = 1e6
EXAMPLES = ("surge", "ferry", "blown ferry", "beluga in angles")


def wandering(dofs, amplitude, wind=None, n=300):
    """A recording of smooth forces on every axis; of its motion only the first state matters."""
    rng = np.random.default_rng(5)
    t = 0.1 * np.arange(n)
    phases = rng.uniform(0.0, 2.0 * np.pi, (4, len(dofs)))
    tau = sum(
        amplitude * np.sin(2.0 * np.pi * t[:, None] / period + phase)
        for period, phase in zip((2.0, 3.1, 7.0, 13.0), phases, strict=True)
    )
    eta, nu = 0.1 * rng.standard_normal((2, n, len(dofs)))
    blown = None if wind is None else wind + 0.1 * np.sin(t)[:, None]
    return Recording(dofs, t, eta, nu, np.zeros_like(nu), tau, attitude_of(dofs, eta), wind=blown)


@pytest.fixture
def example(vessel):
    """example(name) -> a vessel and a recording that excites it."""

    def chosen(name):
        if name == "surge":
            return vessel("surge_nonlinear"), wandering(("surge",), np.array([20.0]))
        if name == "beluga in angles":
            amplitude = np.array([20.0, 20.0, 20.0, 3.0, 4.0, 2.0])
            model = replace(vessel("beluga_diagonal"), attitude="euler")
            return model, wandering(DOFS, amplitude)
        amplitude, ferry = np.array([150.0, 150.0, 200.0]), vessel("milliampere")
        if name == "ferry":
            return ferry, wandering(PLANAR, amplitude)
        areas = np.diag([40.0, 60.0, 30.0])
        air = Vessel("air", PLANAR, terms(["V_qu_q", "|v_q|v_q", "V_q"]), areas)
        return ferry + air, wandering(PLANAR, amplitude, wind=np.array([4.0, -3.0]))

    return chosen


def pose_rate(eta, nu, dofs):
    if dofs == PLANAR:
        c, s = np.cos(eta[2]), np.sin(eta[2])
        return np.array([c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2]])
    if dofs != DOFS:
        return nu
    frame, turning = np.empty((3, 3)), np.empty(3)
    frame_of_angles(eta[3:], frame)
    angle_rate(eta[3:], *nu[3:], turning)
    return np.concatenate([frame @ nu[:3], turning])


def runge_kutta(rate, y, force, h):
    """One step of RK4 with the force at its start, middle and end."""
    start, middle, end = force
    k1 = rate(y, start)
    k2 = rate(y + 0.5 * h * k1, middle)
    k3 = rate(y + 0.5 * h * k2, middle)
    k4 = rate(y + h * k3, end)
    return y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def integrated(model, recording, integrator):
    """The prediction by Vessel.forward, one sample after the other."""
    force, n, h = held_force(recording, None, None), len(model.dofs), recording.period_s

    def rate(k, state, tau):
        eta, nu = state[:n], state[n:]
        turn = 0.5 * h * recording.nu[k, -1]  # in the plane; the wind of the middle of the sample
        wind = None if recording.wind is None else in_body(recording.wind[k], turn)[None]
        nu_dot = model.forward(tau[None], nu[None], attitude_of(model.dofs, eta[None]), wind)[0]
        return np.concatenate([pose_rate(eta, nu, model.dofs), nu_dot])

    states = [np.concatenate([recording.eta[0], recording.nu[0]])]
    for k in range(len(recording) - 1):
        y, own = states[-1], partial(rate, k)
        euler = integrator == "euler"
        states.append(y + h * own(y, force[k][0]) if euler else runge_kutta(own, y, force[k], h))
    return np.array(states)


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
@pytest.mark.parametrize("name", EXAMPLES)
def test_prediction_is_the_integrated_equation_of_motion(example, name, integrator):
    model, recording = example(name)
    course = course_of(recording, None, None, None, FAR, model.attitude)
    predicted = free_run(model, course, integrator)
    expected = integrated(model, recording, integrator)
    assert np.max(np.abs(expected[:, len(model.dofs) :])) > 0.1
    np.testing.assert_allclose(predicted, expected, rtol=1e-10, atol=1e-10)


def test_steady_wind_stays_where_it_is_while_the_vessel_turns_within_a_sample():
    """The true model's error falls with the square of the sample time, and is small."""
    errors = []
    for period_s in (0.1, 0.2):
        problem, truth = excited(
            "vessel=milliampere", "disturbance=wind", f"sample_time_s={period_s}"
        )
        run = prediction(truth, problem.training, problem.thruster)
        rest = run.free_run[0] - run.course.measured
        errors.append(np.sqrt(np.mean(rest[:, 3:] ** 2, axis=0)))
    assert np.max(errors[0] / np.std(problem.training.nu, axis=0)) < 5e-4
    assert np.min(np.log2(errors[1] / errors[0])) > 1.7


def tumbling(vessel, n=300):
    """The Beluga turned about every axis by strong moments, far through 90 degrees of pitch."""
    recording = wandering(DOFS, np.array([20.0, 20.0, 20.0, 8.0, 10.0, 6.0]), n=n)
    return vessel("beluga_diagonal"), recording


def rates_by_scipy(model, state, tau):
    """Rates of position, quaternion (scalar last) and velocity, by SciPy's rotations."""
    turned, nu = Rotation.from_quat(state[3:7]), state[7:]
    attitude = turned.as_euler("ZYX")[::-1]
    nu_dot = model.forward(tau[None], nu[None], attitude[None])[0]
    spin = np.array([*nu[3:], 0.0])
    x, y, z, w = state[3:7]
    product = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]]) @ spin
    return np.concatenate([turned.apply(nu[:3]), 0.5 * product, nu_dot])


def as_state(eta, nu):
    turned = Rotation.from_euler("ZYX", eta[5:2:-1])
    return np.concatenate([eta[:3], turned.as_quat(), nu])


def predicted_states(model, course):
    """Position, quaternion (scalar last) and velocity of a free run by RK4."""
    plan = predicted_layout(model, model.theta != 0.0)
    plant = plan.plant(model.theta, plan.inverse_inertia(model.theta[None])[0][..., 0])
    states = np.empty_like(course.reached)
    predict(plant, course, False, states)
    return states[:, [0, 1, 2, 4, 5, 6, 3, *range(7, 13)]]


def test_a_tumbling_vessel_is_predicted_as_by_quaternions_and_scipy(vessel):
    """Through straight up and down; Euler angles are far off there, and the step is not."""
    model, recording = tumbling(vessel)
    course = course_of(recording, None, None, None, FAR)
    predicted = predicted_states(model, course)
    expected = [as_state(recording.eta[0], recording.nu[0])]
    for force in course.acting[:-1]:
        after = runge_kutta(partial(rates_by_scipy, model), expected[-1], force, course.step_s)
        after[3:7] /= np.linalg.norm(after[3:7])
        expected.append(after)
    expected = np.array(expected)
    pitch = Rotation.from_quat(expected[:, 3:7]).as_euler("ZYX")[:, 1]
    assert np.max(np.abs(pitch)) > np.radians(85.0)
    angle = (
        Rotation.from_quat(expected[:, 3:7]).inv() * Rotation.from_quat(predicted[:, 3:7])
    ).magnitude()
    assert np.max(angle) < 1e-3
    for columns in (slice(0, 3), slice(7, 13)):
        size = np.max(np.abs(expected[:, columns]))
        assert np.max(np.abs(predicted - expected)[:, columns]) < 1e-3 * size
    by_angles = free_run(
        replace(model, attitude="euler"), course_of(recording, None, None, None, FAR, "euler"),
        "rk4",
    )  # fmt: skip
    size = np.max(np.abs(expected[:, :3]))
    assert np.max(np.abs(by_angles[:, :3] - expected[:, :3])) > 0.01 * size


def test_attitude_errors_are_the_rotation_vectors_of_scipy():
    rng = np.random.default_rng(3)
    first, second = rng.uniform(-np.pi, np.pi, (2, 500, 3)) * [1.0, 0.5, 1.0]
    expected = (
        Rotation.from_euler("ZYX", first[:, ::-1]).inv()
        * Rotation.from_euler("ZYX", second[:, ::-1])
    ).as_rotvec()
    for kinematics in (Quaternion(), Euler()):
        states = [
            np.hstack([state_of(kinematics, np.hstack([np.zeros((500, 3)), one])),
                       np.zeros((500, 6))])
            for one in (first, second)
        ]  # fmt: skip
        errors = deviations(kinematics, *states)
        np.testing.assert_allclose(errors[:, 3:6], expected, atol=1e-12)
        moved = displaced(kinematics, states[0][:, :-6], errors[:, :6])
        if isinstance(kinematics, Quaternion):
            same = np.abs(np.sum(moved[:, 3:] * states[1][:, 3:7], axis=1))
            np.testing.assert_allclose(same, 1.0, atol=1e-14)


def test_truth_predicts_the_simulated_lap_through_the_thrusters(calm):
    """360 s ahead of the first sample, by steps of 0.1 s where the plant took 0.025 s."""
    training = calm.problem.training
    course = course_of(training, calm.thruster, None, None, 10.0)
    predicted = free_run(calm.truth, course, "rk4")
    np.testing.assert_allclose(predicted, course.measured, atol=2e-5)
    late = free_run(calm.truth, course_of(training, None, "commanded", None, 10.0), "rk4")
    assert np.max(np.abs(late - course.measured)) > 0.1


def test_force_in_the_middle_of_a_sample_is_that_of_the_lag():
    lag = SecondOrderLag(2.0, 0.8)
    recording = wandering(("surge",), np.array([10.0])).with_thruster(lag)
    fine = Recording(
        ("surge",), 0.05 * np.arange(600), *(np.zeros((600, 1)) for _ in range(3)),
        np.repeat(recording.tau, 2, axis=0), np.zeros((600, 3)),
    ).with_thruster(lag)  # fmt: skip
    force = held_force(recording, lag, None)[:-1]
    np.testing.assert_allclose(force[:, 0], fine.tau_filtered[:-2:2], atol=1e-12)
    np.testing.assert_allclose(force[:, 1], fine.tau_filtered[1:-2:2], atol=1e-11)
    np.testing.assert_allclose(force[:, 2], fine.tau_filtered[2::2], atol=1e-12)


def test_a_thruster_without_lag_acts_as_commanded(make, signal):
    """The simulation records the force before the new command: last sample's command."""
    recording = make.forced(signal("triple_ramp"), ("surge",))
    before = np.vstack([np.zeros((1, 1)), recording.tau[:-1]])
    direct = replace(recording, tau_actual=before, immediate=("surge",))
    np.testing.assert_array_equal(held_force(direct, None, None)[:, 1], recording.tau)
    parted = direct.part(np.delete(np.arange(len(direct)), slice(300, 500)))
    np.testing.assert_array_equal(held_force(parted, None, None)[:, 1], parted.tau)
    measured = replace(direct, immediate=())  # whether the thrusters lag is not known
    np.testing.assert_array_equal(held_force(measured, None, None)[:, 0], before)
    np.testing.assert_array_equal(held_force(direct, None, "actual")[:, 0], before)


@pytest.mark.parametrize(("name", "without"), [("modulus_ship", True), ("milliampere", False)])
def test_a_simulation_records_whether_its_thrusters_lag(name, without):
    trial = composed(f"vessel={name}", "excitation=prbs")
    assert (trial.vessel.thruster is None) == without
    recording = excite(trial, Streams(0)).recording
    assert bool(recording.immediate) == without
    assert all(
        bool(piece.immediate) == without for piece in (recording.lowpass(1.0), *recording.pieces())
    )


def test_the_free_run_of_the_true_vessel_is_its_simulation():
    """Its shafts jump with their command, which is recorded a sample later."""
    trial = composed("vessel=otter", "identifier=none", "evaluation=none")
    recording = excite(trial, Streams(0)).recording
    assert recording.immediate == recording.input_names
    assert np.ptp(recording.inputs, axis=0).max() > 0.0
    truth = trial.vessel.plant_scale * trial.vessel.nominal()
    errors, _ = prediction(truth, recording, None).deviations()
    assert np.max(np.abs(errors[:, 3:])) < 1e-4
    assumed = replace(recording, immediate=())  # that they change linearly
    errors, _ = prediction(truth, assumed, None).deviations()
    assert np.max(np.abs(errors[:, 3:])) > 1e-2


def test_predictions_begin_anew_at_the_horizon_and_where_samples_are_missing(make, signal):
    truth = make.surge(60.0, 20.0)
    recording = make.driven(truth, signal("many_sine"))
    kept = recording.part(np.delete(np.arange(1000), slice(250, 300)))
    course = course_of(kept, None, None, 100, 10.0)
    assert np.flatnonzero(course.restart).tolist() == [0, 100, 200, *range(250, 950, 100)]
    predicted = free_run(truth, course, "euler")
    np.testing.assert_allclose(predicted, course.measured, atol=1e-12)


def test_recorded_velocity_beyond_the_limit_is_refused(make, signal):
    recording = make.driven(make.surge(60.0, 20.0), signal("triple_ramp"))
    with pytest.raises(RecordingError, match="derivative_limit = 2"):
        course_of(recording, None, None, None, 2.0)


def test_milliampere_has_its_own_coefficients_and_its_coriolis_force_follows(milliampere):
    """5 of inertia, 16 of drag; without the tie C(nu) nu adds 8 entries."""
    tied = free_parameters(milliampere, None, "tied", False)
    loose = free_parameters(milliampere, None, "free", False)
    assert (len(tied), len(loose)) == (21, int(np.count_nonzero(milliampere.theta)))
    heavier = tied.values.copy()
    heavier[tied.labels.index("surge.u_dot")] *= 2.0
    twice = milliampere + tied.residual(heavier)
    assert twice.coefficient("sway", "ur") == pytest.approx(2.0 * 2389.657)
    np.testing.assert_allclose(tied.tables(tied.values[None])[0], milliampere.theta)
    nu = np.random.default_rng(0).standard_normal((50, 3))
    drag = free_parameters(milliampere, None, "tied", False).residual(heavier)
    work = np.sum(nu * drag.inverse(np.zeros_like(nu), nu), axis=1)
    np.testing.assert_allclose(work, 0.0, atol=1e-9)


def test_parameters_can_be_named_and_new(milliampere):
    free = free_parameters(milliampere, ["surge.u", "surge.u^2"], "tied", True)
    assert free.labels == ("surge.u", "surge.u^2", "north", "east")
    assert free.units == ("kg/s", "kg/m", "N", "N")
    np.testing.assert_array_equal(free.values, [27.632, 0.0, 0.0, 0.0])
    pushed = free.residual(free.values + np.array([0.0, 0.0, 200.0, 100.0]))
    force = -pushed.inverse(np.zeros((1, 3)), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.3]]))[0]
    c, s = np.cos(0.3), np.sin(0.3)
    np.testing.assert_allclose(force, [c * 200 + s * 100, c * 100 - s * 200, 0.0])
