"""Design models of the linear controllers, and the force needed to hold a vessel in the weather.

A linear controller is designed on a sampled model with inputs as fractions of their limits,

    x_{k+1} = A x_k + B (u_k + d_k),    y_k = C x_k

with the pose y, the commanded force u and the known disturbance d: the force of the model's table
at rest, such as the wind force. A vessel is linearised at rest and sampled with a zero-order hold.
Its pose and velocity are given in the present body axes, in which the linear model holds at every
heading (vessel-parallel coordinates, Fossen (2011), section 7.5.3). An identified state-space
model is used in the axes of its data.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS, DOFS, PLANAR, VELOCITIES
from seatrial.models.simulation.linearisation import linearise
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import INDEX, N_VARIABLES, Array
from seatrial.models.vessel.kinematics import in_body
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather
from seatrial.models.weather.wind import WindForce

MOVING = tuple(INDEX[name] for name in (*ACCELERATIONS, *VELOCITIES))
ATTITUDE = tuple(INDEX[name] for name in basis.ATTITUDE)
START_WEIGHT = 1e3  # of the first pose relative to the drift, in the initial state


@dataclass(frozen=True, eq=False)
class DesignModel:
    """A discrete model with n states, r inputs (as fractions of the limits) and m outputs."""

    model: StateSpace
    limits: Array  # (r,) [N, Nm], the force of an input of 1
    turning: bool  # the pose is (x, y, psi), and the state is given in the present body axes
    still: Vessel  # the terms without motion: the force that is needed at rest
    dofs: tuple[str, ...]
    physical: bool  # the state is (pose, velocity)

    @property
    def period_s(self) -> float:
        """Sample time [s]."""
        return float(self.model.period_s or 0.0)

    def start(self) -> Array:
        """The state at rest with a given pose, x_0 = S y_0; shape (n, m)."""
        model = self.model
        drift = model.A - np.eye(model.order)
        drift /= max(float(np.linalg.norm(drift)), 1e-300)
        rows = np.vstack([START_WEIGHT * model.C, drift])
        return np.asarray(np.linalg.pinv(rows)[:, : len(model.C)] * START_WEIGHT)

    def diagnostics(self) -> list[Diagnostic]:
        """Order, controllability, observability and stability of the model."""
        model = self.model
        return [
            Diagnostic("model_order", "all", float(model.order)),
            Diagnostic("controllable_order", "all", float(model.controllable_order)),
            Diagnostic("observable_order", "all", float(model.observable_order)),
            Diagnostic("open_loop_radius", "all", model.spectral_radius),
        ]


def design_model(
    model: Vessel | StateSpace,
    limits: tuple[float, ...],
    period_s: float,
    wind: WindForce | None = None,
) -> DesignModel:
    """The sampled design model of a vessel or of an identified state-space model.

    `limits` [N, Nm] scale the inputs. `wind` is the wind force on the vessel if the controller
    knows it; it is not added to a model that already has wind terms. Raises ConfigurationError
    when the limits or the period do not fit the model.
    """
    scale = np.array(limits, dtype=np.float64)
    names = model.dofs if isinstance(model, Vessel) else model.inputs
    if len(limits) != len(names):
        raise ConfigurationError(
            f"controller.limits: got {len(limits)} numbers, expected {len(names)} "
            f"for {', '.join(names)}"
        )
    if isinstance(model, StateSpace):
        return _identified(model, scale, period_s)
    if model.dofs != PLANAR and set(model.dofs) & set(DOFS[3:]):
        raise ConfigurationError(
            f"controller: got a vessel in {', '.join(model.dofs)}, expected one in "
            f"{', '.join(PLANAR)}, or in some of {', '.join(DOFS[:3])}, for a linear controller"
        )
    motion, still = _parts(model)
    if wind is not None and not still.force_table().aerodynamic:
        still = still + wind.table(model.dofs)
    sampled = linearise(motion).discretised(period_s).scaled(1.0 / scale, np.ones(len(scale)))
    return DesignModel(sampled, scale, model.dofs == PLANAR, still, model.dofs, True)


def _identified(model: StateSpace, scale: Array, period_s: float) -> DesignModel:
    """Design model of a state-space model; the control period is a multiple of the model's.

    A model of the pose summed in body axes, with the state (pose, rate), holds at every heading.
    """
    if model.period_s is None:
        model = model.discretised(period_s)
    if np.any(model.D != 0.0):
        raise ConfigurationError("controller: the model has a direct term D, expected none")
    m = len(model.C)
    if m != len(scale):
        raise ConfigurationError(f"controller: the model has {m} outputs, expected {len(scale)}")
    own = float(model.period_s or period_s)
    times = round(period_s / own)
    if times < 1 or abs(times * own - period_s) > 1e-9 * period_s:
        raise ConfigurationError(
            f"controller.period_s: the model was identified at {own:g} s, got {period_s:g} s, "
            f"expected a multiple"
        )
    dofs = tuple(name.removeprefix("tau_") for name in model.inputs)
    dofs = dofs if set(dofs) <= set(DOFS) else DOFS[: len(scale)]
    still = Vessel("none", dofs, (), np.zeros((0, len(dofs))))
    sampled = every(model, times).scaled(1.0 / scale, np.ones(len(scale)))
    physical = model.order == 2 * m and np.allclose(model.C, np.eye(m, 2 * m), atol=1e-9)
    body = all(name.startswith("body ") for name in model.outputs)
    turning = physical and body and dofs == PLANAR
    return DesignModel(sampled, scale, turning, still, dofs, physical)


def every(model: StateSpace, times: int) -> StateSpace:
    """The model sampled every `times` of its periods with held input, with its Kalman gain.

    The innovations e of the model are the noise of the result: over `times` periods the state
    receives sum A^i K e. The innovation of the first period is also the measurement noise.
    Raises ConfigurationError when there is no steady-state gain.
    """
    if times == 1:
        return model
    powers = [np.linalg.matrix_power(model.A, i) for i in range(times + 1)]
    A, gain = powers[-1], None
    if model.K is not None:
        R = np.eye(len(model.C)) if model.F is None else model.F @ model.F.T
        received = [power @ model.K for power in powers[:-1]]
        Q, S = np.sum([gain_i @ R @ gain_i.T for gain_i in received], axis=0), received[-1] @ R
        reason = f"controller: the model has no steady-state gain at {times} periods"
        P = riccati(A.T, model.C.T, Q, R, reason, S)
        gain = np.linalg.solve(model.C @ P @ model.C.T + R, model.C @ P @ A.T + S.T).T
    B = sum(powers[:-1], np.zeros_like(A)) @ model.B
    return replace(model, A=A, B=B, K=gain, period_s=times * float(model.period_s or 1.0))


def _parts(model: Vessel) -> tuple[Vessel, Vessel]:
    """Split a table into the terms of the motion and the terms that act at rest.

    In surge, sway and yaw an attitude term is a force that is constant in NED, such as the mean
    of the weather. In other degrees of freedom it is a restoring force, part of the motion.
    """
    of_motion = {*MOVING, *(() if model.dofs == PLANAR else ATTITUDE)}
    moves = [any(code % N_VARIABLES in of_motion for code in term.codes) for term in model.terms]

    def part(kept: bool) -> Vessel:
        rows = [i for i, each in enumerate(moves) if each == kept]
        terms = tuple(model.terms[i] for i in rows)
        return Vessel(model.name, model.dofs, terms, model.theta[rows])

    return part(True), part(False)


def riccati(A: Array, B: Array, Q: Array, R: Array, reason: str, S: Array | None = None) -> Array:
    """The stabilising solution of the discrete algebraic Riccati equation, shape (n, n).

    A is (n, n), B (n, r), Q (n, n), R (r, r), S (n, r) the cross weight. Raises ConfigurationError
    with the reason where there is none.
    """
    try:
        return np.asarray(scipy.linalg.solve_discrete_are(A, B, Q, R, s=S), dtype=np.float64)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ConfigurationError(f"{reason}: {error}") from error


def check_weights(name: str, values: tuple[float, ...], count: int, *, positive: bool) -> None:
    """Raise ConfigurationError unless there are `count` weights, positive or not negative."""
    low = min(values, default=0.0)
    if len(values) != count or low < 0.0 or (positive and low == 0.0):
        kind = "positive" if positive else "not negative"
        raise ConfigurationError(f"{name} must be {count} numbers, {kind}, got {list(values)}")


CHECKED_HEADINGS = 72  # number of headings checked if the heading is not known in advance


def largest_disturbance(plant: Vessel, weather: Weather, heading: Array) -> Array:
    """The largest force needed to hold the vessel at rest in the weather [N, Nm], shape (n_dof,).

    `heading` (N,) [rad] is the planned heading if it is known in advance; if it is empty, the
    largest force over all headings is returned. Noise and waves are not included.
    """
    n = len(weather.force_ned)
    if plant.dofs == PLANAR and len(heading) < n:
        turns = 2.0 * np.pi * np.arange(CHECKED_HEADINGS) / CHECKED_HEADINGS
        forces = [largest_disturbance(plant, weather, np.full(n, psi)) for psi in turns]
        return np.asarray(np.max(forces, axis=0))
    psi = heading[:n] if plant.dofs == PLANAR else np.zeros(n)
    streams = (weather.current_ned, weather.wind_ned)
    through, air = (in_body(rows, psi) if len(rows) else np.zeros((n, 2)) for rows in streams)
    nu, attitude = np.zeros((n, len(plant.dofs))), np.zeros((n, 3))
    attitude[:, 2] = psi
    for column, dof in enumerate(("surge", "sway")):
        if dof in plant.dofs:
            nu[:, plant.dofs.index(dof)] = -through[:, column]
    # The table computes the air velocity as nu - wind, and its nu is the velocity through water.
    force = plant.inverse(np.zeros_like(nu), nu, attitude, air - through)
    given = weather.force_ned.copy()
    if plant.dofs == PLANAR:
        given[:, :2] = in_body(given[:, :2], psi)
    return np.asarray(np.max(np.abs(force - given), axis=0))
