"""Whether the limits can hold the vessel against the weather at all."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_discrete_are

from seatrial.models.errors import ConfigurationError
from seatrial.models.findings import Finding
from seatrial.models.notation import ACCELERATIONS, DOFS, PLANAR, VELOCITIES
from seatrial.models.simulation.linearisation import linearise
from seatrial.models.simulation.statespace import StateSpace, spectral_radius
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import INDEX, N_VARIABLES, Array
from seatrial.models.vessel.kinematics import in_body
from seatrial.models.vessel.table import ForceTable, Vessel
from seatrial.models.weather.weather import Weather
from seatrial.models.weather.wind import WindForce

# What a linear controller is designed on: a sampled model whose input is a share of its limits.
#
# Any model serves. A vessel is linearised at rest and sampled with a zero-order hold; its pose and
# velocity are seen from the present body axes, in which the linear model holds at every heading
# (vessel-parallel coordinates, Fossen (2011), section 7.5.3). A state-space model is taken as it
# was identified, in the axes of its data.
#
#     x_{k+1} = A x_k + B (u_k + d_k),    y_k = C x_k
#
# with the pose y, u the commanded force over its limit, and d the disturbance that is known: what
# the model's table asks for at rest, such as the wind's force.


MOVING = tuple(INDEX[name] for name in (*ACCELERATIONS, *VELOCITIES))
ATTITUDE = tuple(INDEX[name] for name in basis.ATTITUDE)
START_WEIGHT = 1e3  # of showing the first pose, against standing still


@dataclass(frozen=True, eq=False)
class DesignModel:
    """A discrete model with n states, r inputs and m outputs, its input in shares of the limits."""

    model: StateSpace
    limits: Array  # (r,) [N, Nm]: inputs of one
    turning: bool  # the pose is (x, y, psi), and the state is seen from the present axes
    still: Vessel  # the terms without motion: the force that is needed at rest, less the known
    dofs: tuple[str, ...]
    physical: bool  # the state is (pose, velocity)

    @property
    def period_s(self) -> float:
        """Sample time [s]."""
        return float(self.model.period_s or 0.0)

    def static_table(self) -> ForceTable:
        """The force at rest, for the kernels."""
        return self.still.force_table()

    def start(self) -> Array:
        """The state at rest with a given pose, x_0 = S y_0; shape (n, m)."""
        model = self.model
        drift = model.A - np.eye(model.order)
        drift /= max(float(np.linalg.norm(drift)), 1e-300)
        rows = np.vstack([START_WEIGHT * model.C, drift])
        return np.asarray(np.linalg.pinv(rows)[:, : len(model.C)] * START_WEIGHT)

    def remarks(self) -> list[Finding]:
        """Order, controllability, observability and stability of the model."""
        model = self.model
        return [
            Finding("model_order", "all", float(model.order)),
            Finding("controllable_order", "all", float(model.controllable_order)),
            Finding("observable_order", "all", float(model.observable_order)),
            Finding("open_loop_radius", "all", model.spectral_radius),
        ]


def design_model(
    model: Vessel | StateSpace,
    limits: tuple[float, ...],
    period_s: float,
    wind: WindForce | None = None,
) -> DesignModel:
    """The sampled model of a vessel or an identified model, per share of the input `limits`.

    `wind` is the wind's force on the vessel, where the controller knows it; it is not added to a
    model that has its own. Raises ConfigurationError when the limits or the period do not fit.
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
            f"controller: a linear controller holds a vessel in {', '.join(PLANAR)}, or in some "
            f"of {', '.join(DOFS[:3])}, got one in {', '.join(model.dofs)}"
        )
    motion, still = _parts(model)
    if wind is not None and not still.force_table().aerodynamic:
        still = still + wind.table(model.dofs)
    sampled = linearise(motion).discretised(period_s).scaled(1.0 / scale, np.ones(len(scale)))
    return DesignModel(sampled, scale, model.dofs == PLANAR, still, model.dofs, True)


def _identified(model: StateSpace, scale: Array, period_s: float) -> DesignModel:
    """A state-space model in shares of the limits; several of its periods make one of ours.

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
    """The model over several of its own periods, its input held, with the gain that then is best.

    The innovations e of the model are the noise of the new one: over `times` periods the state
    receives sum A^i K e, the first of which is the measurement's own.
    """
    if times == 1:
        return model
    powers = [np.linalg.matrix_power(model.A, i) for i in range(times + 1)]
    A, gain = powers[-1], None
    if model.K is not None:
        R = np.eye(len(model.C)) if model.F is None else model.F @ model.F.T
        received = [power @ model.K for power in powers[:-1]]
        Q, S = sum(one @ R @ one.T for one in received), received[-1] @ R
        try:
            P = solve_discrete_are(A.T, model.C.T, Q, R, s=S)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ConfigurationError(f"controller: no gain at {times} periods, {error}") from error
        gain = np.linalg.solve(model.C @ P @ model.C.T + R, model.C @ P @ A.T + S.T).T
    B = sum(powers[:-1], np.zeros_like(A)) @ model.B
    return replace(model, A=A, B=B, K=gain, period_s=times * float(model.period_s or 1.0))


def _parts(model: Vessel) -> tuple[Vessel, Vessel]:
    """The terms of the motion, for the linear model, and those that act at rest.

    Attitude in the plane is a force that is fixed in NED, such as the weather's mean; elsewhere it
    is a restoring force, part of the motion.
    """
    moving: list[int] = []
    still: list[int] = []
    for i, one in enumerate(model.terms):
        variables = {code % N_VARIABLES for code in one.codes if code % N_VARIABLES}
        restoring = bool(variables & set(ATTITUDE)) and model.dofs != PLANAR
        (moving if restoring or variables & set(MOVING) else still).append(i)

    def part(rows: list[int]) -> Vessel:
        terms = tuple(model.terms[i] for i in rows)
        return Vessel(model.name, model.dofs, terms, model.theta[rows])

    return part(moving), part(still)


def check_weights(name: str, values: tuple[float, ...], count: int, *, positive: bool) -> None:
    """Refuse weights that are negative, or zero where they must not be, or of a wrong number."""
    low = min(values, default=0.0)
    if len(values) != count or low < 0.0 or (positive and low == 0.0):
        kind = "positive" if positive else "not negative"
        raise ConfigurationError(f"{name} must be {count} numbers, {kind}, got {list(values)}")


def closed_loop_radius(A: Array, B: Array, gain: Array) -> float:
    """Spectral radius of A + B G; 1 or more: the design does not settle on its own model."""
    return spectral_radius(A + B @ gain)


HEADINGS = 72  # tried where the heading is not known in advance


def largest_disturbance(plant: Vessel, weather: Weather, heading: Array) -> Array:
    """The largest force that standing still in the weather needs [N, Nm], shape (n_dof,).

    `heading` (N,) [rad] is the one that will be sailed, where it is known in advance; else, with
    no rows, the worst of all headings counts. Noise and waves are not held against.
    """
    n = len(weather.force_ned)
    if plant.dofs == PLANAR and len(heading) < n:
        turns = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
        worst = [largest_disturbance(plant, weather, np.full(n, psi)) for psi in turns]
        return np.asarray(np.max(worst, axis=0))
    psi = heading[:n] if plant.dofs == PLANAR else np.zeros(n)
    current, wind = _whole(weather.current_ned, n), _whole(weather.wind_ned, n)
    through, air = in_body(current, psi), in_body(wind, psi)
    nu, attitude = np.zeros((n, len(plant.dofs))), np.zeros((n, 3))
    attitude[:, 2] = psi
    for column, dof in enumerate(("surge", "sway")):
        if dof in plant.dofs:
            nu[:, plant.dofs.index(dof)] = -through[:, column]
    # The table's air velocity is nu - wind with the nu it is given: that through the water.
    force = plant.inverse(np.zeros_like(nu), nu, attitude, air - through)
    given = weather.force_ned.copy()
    if plant.dofs == PLANAR:
        given[:, :2] = in_body(given[:, :2], psi)
    return np.asarray(np.max(np.abs(force - given), axis=0))


def _whole(values: Array, n: int) -> Array:
    return values if len(values) else np.zeros((n, 2))
