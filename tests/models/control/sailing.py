"""Vessels and voyages for the tests of controllers and of motion."""

from typing import Any

import numpy as np

from seatrial.models.control.estimator import Kalman
from seatrial.models.control.linear_controller import Lqi
from seatrial.models.control.mpc import Mpc
from seatrial.models.control.pid import PidFeedforward
from seatrial.models.excitation.guidance import ReferenceFilter
from seatrial.models.excitation.setpoints import Step
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.loop import Watch, sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Voyage, outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.weather import Weather
from seatrial.models.weather.wind import Windage

LIMITS = (2e5, 4e5, 1e7)
ERROR_WEIGHT = (1e2, 1e2, 1e5)
INCREMENT_WEIGHT = (4e3, 1.6e4, 1e4)
INPUT_WEIGHT = (70.0, 100.0, 50.0)
WINDAGE = Windage(500.0, 1100.0, 73.2, 0.6, 0.8, 0.1, 1.23)
KALMAN = Kalman((2e-3, 2e-3, 2e-5), (0.05, 0.05, 5e-4), (1e3, 1e3, 1e5), estimate_bias=False)


def ship(drag: float = 1.0) -> Vessel:
    """The supply vessel; its drag times a factor."""
    derivatives = {"X_|u|u": -5e4, "Y_|v|v": -22e4, "N_|r|r": -1.2e10, "N_|v|v": -6.6e5}
    scaled = {name: drag * value for name, value in derivatives.items()}
    return from_derivatives("ship", PLANAR, np.diag([2.4e7, 4e7, 4.5e10]), scaled, False)


def double_integrators() -> Vessel:
    """The same without drag: its linear model is exact while the heading does not move."""
    return ship(drag=0.0)


def lqi(**changes: Any) -> Lqi:
    options: dict[str, Any] = {
        "error_weight": ERROR_WEIGHT, "input_weight": INCREMENT_WEIGHT, "limits": LIMITS,
        "limited": True, "period_s": None, "estimator": "kalman", "kalman": KALMAN, "wind": WINDAGE,
    }  # fmt: skip
    return Lqi(**{**options, **changes})


def mpc(kind: str, **changes: Any) -> Mpc:
    options: dict[str, Any] = {
        "formulation": kind,
        "horizon": 10, "preview": "setpoint_and_wind", "error_weight": ERROR_WEIGHT,
        "input_weight": INPUT_WEIGHT, "limits": LIMITS, "limited": True, "period_s": None,
        "estimator": "kalman", "kalman": KALMAN, "wind": WINDAGE,
    }  # fmt: skip
    if kind == "integral":
        integral = {"input_weight": INCREMENT_WEIGHT, "horizon": 40, "rate_limits": None}
        return Mpc(**{**options, **integral, **changes})
    return Mpc(**{**options, **changes})


def weather(n: int, n_dof: int = 3, **parts: Array) -> Weather:
    """Calm, or with some parts: pose_noise, force_ned, wind_ned, current_ned."""
    calm = [np.zeros((n, n_dof)) for _ in range(4)]
    return Weather(*calm)._replace(**parts)


def voyage(
    controller: Any,
    setpoints: Array,
    *,
    model: Any = None,
    plant: Vessel | None = None,
    met: Weather | None = None,
    period_s: float = 1.0,
    start: Array | None = None,
    change: tuple[float, Vessel] | None = None,
    watch: Watch | None = None,
    limits: tuple[float, ...] = (20.0, 20.0, 1.0),
) -> tuple[Voyage, Any]:
    """Sail set-points as steps; the voyage and the controller's memory after it."""
    n, n_dof = setpoints.shape
    true = ship() + WINDAGE.table(PLANAR) if plant is None else plant
    met = weather(n, n_dof) if met is None else met
    guidance, reference = Timetable(np.ascontiguousarray(setpoints)), Step().table(period_s)
    craft = Plant(true, None, limits[:n_dof], change)
    start = np.zeros(n_dof) if start is None else start
    parameters, state = controller.build(ship() if model is None else model, period_s)
    ahead = outlook(craft, met, guidance, reference, start)
    parameters = controller.foresee(parameters, ahead)
    sailed = sail(
        craft, met, (guidance, np.zeros(1)), reference, (parameters, state), start, period_s,
        period_s, watch=watch,
    )  # fmt: skip
    return sailed, state


def drift(
    vessel: Vessel, met: Weather, *, goal: Array | None = None, gain: float = 0.0,
    lag: SecondOrderLag | None = None, start: Array | None = None, step_s: float = 0.05,
    integrator: Any = "rk4", **options: Any,
) -> Voyage:  # fmt: skip
    """A vessel that nothing steers, at 10 Hz; or one that is steered to a goal, by equal gains."""
    n, n_dof = met.force_ned.shape
    gains, here = (gain,) * n_dof, np.zeros(n_dof)
    pid = PidFeedforward(gains, gains, gains, feedforward=goal is not None)
    setpoints = np.tile(here if goal is None else goal, (n, 1))
    return sail(
        Plant(vessel, lag, (50.0,) * n_dof, integrator=integrator), met,
        (Timetable(setpoints), np.zeros(1)), ReferenceFilter(0.5, 0.7).table(0.1),
        pid.build(vessel, 0.1), here if start is None else start, 0.1, step_s, **options,
    )  # fmt: skip


def appendix_k(n: int = 1200) -> Array:
    """(0, 0, 0) -> (15, 20, 14 deg) -> (8, 6, 6 deg), Bargouth (2022), appendix K."""
    share = np.arange(1, n + 1) / n
    poses = np.array([[0.0, 0.0, 0.0], [15.0, 20.0, 14.0], [8.0, 6.0, 6.0]])
    poses[:, 2] = np.radians(poses[:, 2])
    return poses[1 * (share > 0.25) + 1 * (share > 0.5)]


def steady(n: int, speed: float, direction: float) -> Array:
    """Wind of one speed [m/s] and direction [rad], shape (n, 2)."""
    return np.tile([speed * np.cos(direction), speed * np.sin(direction)], (n, 1))


def note(controller: Any, name: str, model: Any = None, period_s: float = 1.0) -> float:
    """One number that a controller says of itself."""
    found = controller.diagnostics(ship() if model is None else model, period_s)
    return float(next(one.value for one in found if one.name == name))
