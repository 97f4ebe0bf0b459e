"""Free runs of one model, or of many candidates, under the force of a recording.

From the measured pose and velocity at the first sample the equation of motion (`dynamics.py`)
is integrated with the recorded force and the wind measured aboard, by Euler, Hoyer (2021),
eq. (6.2), or by RK4 at the sample time. All rates are limited at every stage, as in section 6.4, so
that no candidate overflows; the number of limited rates is counted.

`predict` stores the states of one model. `predict_many` and `prediction_errors` take candidates in
packs (`seatrial.models.packs`); the latter sums their errors without storing trajectories.
"""

from typing import Literal, NamedTuple

import numpy as np
from numba import types
from numba.extending import register_jitable
from numpy.typing import NDArray

from seatrial.models.bound import Bound, bound, entry
from seatrial.models.compiled import INNER, kernel, lean_kernel
from seatrial.models.elementary import where
from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import ACCELERATIONS, poses_of
from seatrial.models.packs import WIDTH, as_packs
from seatrial.models.recording.recording import Recording, following, held
from seatrial.models.simulation.dynamics import Scratch, scratch, step
from seatrial.models.vessel.basis import ANGLES, ATTITUDE, INPUTS, N_VARIABLES, VARIABLES, Array
from seatrial.models.vessel.kinematics import in_body
from seatrial.models.vessel.plant_table import Flags, Layout, PlantTable, bound_plant
from seatrial.models.vessel.pose import (
    Euler,
    Kinematics,
    Quaternion,
    deviation,
    displaced,
    kinematics_of,
    pose_of,
    state_of,
)
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.weather import Weather

METRICS = ("mae", "mse", "smape", "mean_error")
MAE, MSE, SMAPE, MEAN_ERROR = range(4)
Integrator = Literal["euler", "rk4"]


class Course(NamedTuple):
    """A recording of N samples in the form the kernels need; SI units.

    A state is the integrated pose (with a quaternion in six degrees of freedom) and the velocity:
    n_pose + n_dof numbers.
    """

    kinematics: Kinematics
    acting: Array  # (N, 3, n): forces or inputs at the start, middle and end of each sample
    weather: Weather  # the wind in body axes at the middle of each sample, where it was measured
    measured: Array  # (N, 2 n_dof) measured pose and velocity
    reached: Array  # (N, n_pose + n_dof) measured states
    start: Array  # (N, n_pose + n_dof) initial states, used where a prediction begins
    restart: Flags  # (N,) samples at which a prediction begins
    step_s: float
    limit: float  # of eta_dot [m/s, rad/s]
    acceleration: float  # limit of nu_dot [m/s^2, rad/s^2]

    def with_offset(self, offset: Array) -> "Course":
        """The course with an offset of the initial states from the measured ones.

        `offset` (n, 2 n_dof) is added to the initial states of the n predictions; attitudes are
        offset by a rotation vector.
        """
        start = self.reached.copy()
        start[self.restart] = self.starts(offset)
        return self._replace(start=start)

    def starts(self, offset: Array) -> Array:
        """The initial states (n, n_pose + n_dof) with an offset; see `with_offset`."""
        n_dof = offset.shape[1] // 2
        n_pose = self.reached.shape[1] - n_dof
        states = self.reached[self.restart]
        pose = displaced(self.kinematics, states[:, :n_pose], offset[:, :n_dof])
        return np.hstack([pose, states[:, n_pose:] + offset[:, n_dof:]])


def course_of(
    recording: Recording,
    thruster: SecondOrderLag | None,
    force: str | None,
    horizon: int | None,
    limit: float,
    attitude: str = "quaternion",
    acceleration: float | None = None,
) -> Course:
    """The recording for the kernels, with a new prediction every `horizon` samples.

    A new prediction also begins after missing samples. `attitude` (quaternion, euler) is the
    integrated attitude in six degrees of freedom. `limit` bounds the rates of the pose
    [m/s, rad/s], `acceleration` those of the velocity (None: the same number, per second). Raises
    RecordingError when the recorded velocity exceeds the limit.
    """
    fastest = float(np.max(np.abs(recording.nu)))
    if not fastest < limit:
        raise RecordingError(
            f"recorded velocity: got {fastest:.3g}, expected below "
            f"identifier.derivative_limit = {limit:g}"
        )
    restart = recording.piece_starts.copy()
    if horizon is not None:
        restart |= since(restart) % horizon == 0
    kinematics = kinematics_of(recording.dofs, attitude)
    measured = np.ascontiguousarray(np.hstack([recording.eta, recording.nu]))
    reached = np.ascontiguousarray(np.hstack([state_of(kinematics, recording.eta), recording.nu]))
    acting = np.ascontiguousarray(held_force(recording, thruster, force))
    empty = np.zeros((0, len(recording.dofs)))
    weather = Weather(empty, empty, empty, empty)
    if recording.wind is not None:
        turn = np.zeros(len(measured))  # to the middle: what blows stays where it is over a sample
        if "yaw" in recording.dofs:
            turn = 0.5 * recording.period_s * recording.nu[:, recording.dofs.index("yaw")]
        weather = weather._replace(wind_body=np.ascontiguousarray(in_body(recording.wind, turn)))
    return Course(
        kinematics, acting, weather, measured, reached, reached, restart, recording.period_s, limit,
        limit if acceleration is None else acceleration,
    )  # fmt: skip


def since(restart: Flags) -> NDArray[np.int64]:
    """Samples since the last restart, shape (N,)."""
    index = np.arange(len(restart))
    return index - np.maximum.accumulate(np.where(restart, index, 0))


def held_force(recording: Recording, thruster: SecondOrderLag | None, kind: str | None) -> Array:
    """Force [N, Nm] at the start, middle and end of each sample, shape (N, 3, n_dof).

    For a steered vessel these are the inputs, (N, 3, n_inputs). By default (`kind` None) it is the
    command filtered by the thruster lag if that is known, else the command if the thrusters are
    known to have no lag, else the recorded acting force, else the command. An acting force is
    constant after the last sample. An input that follows its command immediately is recorded before
    it does, and then has its next value throughout the sample.
    """
    if thruster is None and recording.immediate and kind is None:
        kind = "commanded"
    if recording.inputs is not None:
        inputs = held(recording.inputs, following(recording.inputs))
        jumps = np.isin(recording.input_names, recording.immediate)
        inputs[..., jumps] = inputs[:, 2:, jumps]
        return inputs
    force = recording.held_force(kind)
    if thruster is not None and recording.force(kind) is recording.tau_filtered:
        start, end = force[:, 0], force[:, 2]
        force[:, 1] = _middle_of_lag(thruster, recording.period_s, start, end, recording.tau)
    return force


def _middle_of_lag(
    thruster: SecondOrderLag, step_s: float, start: Array, end: Array, command: Array
) -> Array:
    """Force in the middle of each sample, from the rate that leads to the force at its end."""
    (a, b), (half_a, half_b) = thruster.exact(step_s), thruster.exact(0.5 * step_s)
    by_rate = a[0, 1] or 1.0  # a first-order lag has no rate, and the numerator is zero
    rate = (end - a[0, 0] * start - b[0] * command) / by_rate
    return np.asarray(half_a[0, 0] * start + half_a[0, 1] * rate + half_b[0] * command)


def predicted_layout(table: Vessel, support: Flags) -> Layout:
    """Layout of tables like this; support (n_terms, n_dof) marks entries that can be non-zero.

    Raises ConfigurationError for a term that a free run cannot evaluate: a product with an
    acceleration, an angle that is not part of the vessel's pose, or an input it does not have.
    """
    poses = poses_of(table.dofs)
    known = {name for name in ATTITUDE if name[4:-1] in poses} | {*poses, *table.inputs}
    if isinstance(kinematics_of(table.dofs, table.attitude), Quaternion):
        known -= set(ANGLES)
    unknown = {*ACCELERATIONS, *ATTITUDE, *ANGLES, *INPUTS} - known
    for term, row in zip(table.terms, support, strict=True):
        names = {VARIABLES[code % N_VARIABLES] for code in term.codes}
        if term.name not in ACCELERATIONS and np.any(row) and names & unknown:
            raise ConfigurationError(f"term {term} cannot be predicted in {', '.join(table.dofs)}")
    return table.layout(support)


@lean_kernel
def _follow(
    plant: PlantTable, course: Course, k: int, euler: bool, eta: Array, nu: Array, work: Scratch
) -> None:
    """Integrate from sample k - 1 to sample k, or set the initial state of a new prediction."""
    if course.restart[k]:
        for i in range(eta.shape[0]):
            eta[i] = course.start[k, i]
        for i in range(nu.shape[0]):
            nu[i] = course.start[k, eta.shape[0] + i]
        return
    step(
        course.kinematics, plant, course.acting[k - 1], eta, nu, course.weather, k - 1,
        course.step_s, euler, course.limit, course.acceleration, work,
    )  # fmt: skip


def predict(plant: PlantTable, course: Course, euler: bool, states: Array) -> float:
    """Write the states (N, n_pose + n_dof) that one model predicts; return the limited rates."""
    n_dof = len(plant.axes)
    work = scratch(len(plant.codes), n_dof, states.shape[1] - n_dof)
    return _predict(bound_plant(plant), course, euler, states, work)


@kernel
def _predict(plant: PlantTable, course: Course, euler: bool, states: Array, work: Scratch) -> float:
    n_dof = plant.axes.shape[0]
    n_pose = states.shape[1] - n_dof
    eta, nu = np.empty(n_pose), np.empty(n_dof)
    for k in range(states.shape[0]):
        _follow(plant, course, k, euler, eta, nu, work)
        for i in range(n_pose):
            states[k, i] = eta[i]
        for i in range(n_dof):
            states[k, n_pose + i] = nu[i]
    limited: float = work.limited[0]
    return limited


@kernel
def _deviations(kinematics: Kinematics, first: Array, second: Array, errors: Array) -> None:
    n_dof = errors.shape[1] // 2
    n_pose = first.shape[1] - n_dof
    for k in range(first.shape[0]):
        deviation(kinematics, first[k, :n_pose], second[k, :n_pose], errors[k, :n_dof])
        for i in range(n_dof):
            errors[k, n_dof + i] = second[k, n_pose + i] - first[k, n_pose + i]


def deviations(kinematics: Kinematics, first: Array, second: Array) -> Array:
    """Difference second - first of states in pose and velocity, shape (N, 2 n_dof).

    Attitudes differ by a rotation vector, see `pose.deviation`; a single angle is wrapped.
    """
    n_dof = first.shape[1] - (7 if isinstance(kinematics, Quaternion) else first.shape[1] // 2)
    errors = np.empty((len(first), 2 * n_dof))
    _deviations(kinematics, first, second, errors)
    return errors


def spread(course: Course) -> Array:
    """Standard deviation of each measured state, shape (2 n_dof,).

    For an attitude of three angles it is that of the rotation vector from the mean attitude.
    """
    deviation = np.std(course.measured, axis=0)
    if isinstance(course.kinematics, Quaternion | Euler):
        states = state_of(Quaternion(), course.measured[:, :6])
        _, vectors = np.linalg.eigh(states[:, 3:].T @ states[:, 3:])
        mean = np.hstack([states[:, :3], np.tile(vectors[:, -1], (len(states), 1))])
        still = np.zeros((len(states), 6))
        turned = deviations(Quaternion(), np.hstack([mean, still]), np.hstack([states, still]))
        deviation[3:6] = np.std(turned[:, 3:6], axis=0)
    return np.asarray(deviation)


@kernel
def _poses(kinematics: Kinematics, states: Array, poses: Array) -> None:
    frame = np.zeros((3, 3))
    for k in range(states.shape[0]):
        for i in range(poses.shape[1] if k > 0 else 0):
            poses[k, i] = poses[k - 1, i]
        pose_of(kinematics, states[k], frame, poses[k])


def free_run(model: Vessel, course: Course, integrator: Integrator) -> Array:
    """Pose and velocity that a model predicts, shape (N, 2 n_dof)."""
    plan = predicted_layout(model, model.theta != 0.0)
    inverse, _ = plan.inverse_inertia(model.theta[None])
    states = np.empty_like(course.reached)
    predict(plan.plant(model.theta, inverse[..., 0]), course, integrator == "euler", states)
    n = len(model.dofs)
    poses = course.measured[:, :n].copy()  # the first pose sets the turn of the angles
    _poses(course.kinematics, states[:, :-n].copy(), poses)
    return np.hstack([poses, states[:, -n:]])


@lean_kernel
def _error(measured: float, e: float, metric: int) -> float:
    """Contribution of an error e = y_hat - y to the metric. Hoyer (2021), eqs. (3.5)-(3.7)."""
    if metric == MAE:
        return abs(e)
    if metric == MSE:
        return e * e
    if metric == MEAN_ERROR:
        return e
    scale = 0.5 * (abs(measured) + abs(measured + e))
    share = 100.0 * abs(e) / where(scale > 0.0, scale, 1.0)
    return where(scale > 0.0, share, 0.0)  # type: ignore[no-any-return]


def _aligned(shape: tuple[int, ...]) -> Array:
    """Zeros of shape (..., WIDTH) with every row aligned to a cache line of 64 bytes."""
    size = int(np.prod(shape)) * WIDTH
    buffer = np.zeros(size + 8)
    first = (-buffer.ctypes.data // 8) % 8
    return buffer[first : first + size].reshape((*shape, WIDTH))


class _Lanes(NamedTuple):
    """The numbers of WIDTH candidates side by side, which kernels see as packs."""

    entries: Array  # (n_entries, WIDTH)
    inverse: Array  # (n_dof, n_dof, WIDTH)
    parameters: Array  # (n_parameters, WIDTH)
    states: Array  # (n_pose + n_dof, WIDTH)
    work: Scratch


def _lanes(structure: PlantTable, entries: Array, parameters: Array, n_state: int) -> _Lanes:
    """Buffers for the candidates of a structure."""
    n_dof = len(structure.axes)
    work = scratch(len(structure.codes), n_dof, n_state - n_dof, _aligned)
    return _Lanes(
        _aligned((len(entries),)), _aligned((n_dof, n_dof)), _aligned((len(parameters),)),
        _aligned((n_state,)), work,
    )  # fmt: skip


class _Packed(NamedTuple):
    """Candidates in packs: their tables, states and work space."""

    plant: PlantTable
    eta: Array
    nu: Array
    work: Scratch


@register_jitable(**INNER)
def _packed(structure: PlantTable, lanes: _Lanes) -> _Packed:
    """The candidates whose numbers are in the lanes."""
    entries, inverse, parameters, state, work = as_packs(lanes)
    plant = PlantTable(
        structure.codes, structure.term, structure.first, entries, inverse, structure.coupled,
        structure.velocity_index, structure.magnitudes, structure.aerodynamic, structure.turning,
        structure.speed, structure.sideslip, structure.inputs, structure.axes, structure.devices,
        parameters,
    )  # fmt: skip
    n_pose = state.shape[0] - structure.axes.shape[0]
    return _Packed(plant, state[:n_pose], state[n_pose:], work)


@register_jitable(**INNER)
def _load(lanes: _Lanes, entries: Array, inverse: Array, parameters: Array, begin: int) -> int:
    """Take the candidates from number `begin` on; return how many there are."""
    size: int = min(WIDTH, inverse.shape[2] - begin)
    for m in range(size):  # assignments of slices would make numba compile the text of its error
        for i in range(entries.shape[0]):
            lanes.entries[i, m] = entries[i, begin + m]
        for i in range(inverse.shape[0]):
            for j in range(inverse.shape[1]):
                lanes.inverse[i, j, m] = inverse[i, j, begin + m]
        for i in range(parameters.shape[0]):
            lanes.parameters[i, m] = parameters[i, begin + m]
    return size


@lean_kernel
def _follow_packed(packed: _Packed, course: Course, euler: bool, k: int) -> None:
    _follow(packed.plant, course, k, euler, packed.eta, packed.nu, packed.work)


_put_packed, _call_packed = entry(_follow_packed, types.int64)


@kernel
def _bind_packed(memory: Array, parts: tuple[PlantTable, _Lanes, Course, bool]) -> int:
    structure, lanes, course, euler = parts
    return _put_packed(memory, (_packed(structure, lanes), course, euler))  # type: ignore[no-any-return]


def predict_many(
    structure: PlantTable, entries: Array, inverse: Array, parameters: Array, course: Course,
    starts: Array, euler: bool, states: Array,
) -> None:  # fmt: skip
    """Write the states (n, N, n_pose + n_dof) that n candidates predict.

    entries, inverse and parameters are those of `prediction_errors`; starts
    (n_starts, n_pose + n_dof, n) are the initial states of each prediction.
    """
    lanes = _lanes(structure, entries, parameters, states.shape[2])
    step = bound(_bind_packed, structure, lanes, course, euler)
    _predict_many(step, lanes, entries, inverse, parameters, course.restart, starts, states)


@kernel
def _predict_many(
    step: Bound, lanes: _Lanes, entries: Array, inverse: Array, parameters: Array, restart: Flags,
    starts: Array, states: Array,
) -> None:  # fmt: skip
    for begin in range(0, inverse.shape[2], WIDTH):
        size = _load(lanes, entries, inverse, parameters, begin)
        piece = -1
        for k in range(states.shape[1]):
            if restart[k]:
                piece += 1
                for m in range(size):
                    for i in range(states.shape[2]):
                        lanes.states[i, m] = starts[piece, i, begin + m]
            else:
                _call_packed(step.address, step.memory, (k,))
            for m in range(size):
                for i in range(states.shape[2]):
                    states[begin + m, k, i] = lanes.states[i, m]


def prediction_errors(
    structure: PlantTable, entries: Array, inverse: Array, parameters: Array, course: Course,
    euler: bool, metric: int, errors: Array, limited: Array,
) -> None:  # fmt: skip
    """Write errors (n, 2 n_dof) and limited (n,), the number of limited rates, of n candidates.

    entries (n_entries, n) and inverse (n_dof, n_dof, n) are the candidates' tables, parameters
    (n_parameters, n) those of their devices. The metric `mean_error` is the magnitude of the mean.
    """
    lanes = _lanes(structure, entries, parameters, course.reached.shape[1])
    n_dof = len(inverse)
    sums, differences = _aligned((2 * n_dof + 1,)), _aligned((n_dof,))
    _prediction_errors(
        structure, lanes, entries, inverse, parameters, course, euler, metric, sums, differences,
        errors, limited,
    )  # fmt: skip


@kernel
def _prediction_errors(
    structure: PlantTable, lanes: _Lanes, entries: Array, inverse: Array, parameters: Array,
    course: Course, euler: bool, metric: int, sums: Array, differences: Array, errors: Array,
    limited: Array,
) -> None:  # fmt: skip
    n_dof, n = inverse.shape[0], inverse.shape[2]
    plant, eta, nu, work = _packed(structure, lanes)
    total, e = as_packs(sums), as_packs(differences)
    for begin in range(0, n, WIDTH):
        size = _load(lanes, entries, inverse, parameters, begin)
        sums[:] = 0.0
        work.limited[0] = 0.0
        for k in range(course.measured.shape[0]):
            _follow(plant, course, k, euler, eta, nu, work)
            deviation(course.kinematics, course.reached[k], eta, e)
            for i in range(n_dof):
                total[i] += _error(course.measured[k, i], e[i], metric)
                y = course.measured[k, n_dof + i]
                total[n_dof + i] += _error(y, nu[i] - y, metric)
        total[2 * n_dof] = work.limited[0]
        for m in range(size):
            limited[begin + m] = sums[2 * n_dof, m]
            for i in range(2 * n_dof):
                errors[begin + m, i] = abs(sums[i, m]) / course.measured.shape[0]
