"""A simulated voyage: its log, what was measured of it, and what can be known of it ahead."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.simulation.registry import (
    Parameters,
    Timetable,
    reference_step,
)
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, reference_in_body_kernel
from seatrial.models.vessel.parameters import Plant
from seatrial.models.weather.weather import Weather


class Log(NamedTuple):
    """What the loop writes, one row a control instant, shape (N, n_dof) each; SI units."""

    eta: Array  # true pose
    nu: Array  # true body velocity
    nu_dot: Array  # true acceleration under the force acting before the new command
    eta_measured: Array
    nu_measured: Array
    tau: Array  # command
    tau_actual: Array  # acting force, before the new command
    tau_fb: Array  # feedback share of the command
    eta_d: Array  # filtered reference
    nu_d: Array
    nu_dot_d: Array
    setpoint: Array
    held: Array  # 1 where the command was not a number, and the last one was held
    applied: Array  # what the thrusters' allocation makes of the command


class Outlook(NamedTuple):
    """What a controller may know of the mission and the weather, now and ahead; SI units.

    Rows are control instants; what is not known has no rows.
    """

    reference: Array  # (N, n_dof) pose that will be asked for
    wind_ned: Array  # (N, 2) velocity of the air
    wind_noise: Array  # (N, 2) error of the anemometer, body axes; ahead, nobody has measured
    added: Array  # (N, n_dof) force that is added to the controller's commands


NO_OUTLOOK = Outlook(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0)))


@dataclass(frozen=True)
class Voyage:
    """A sailed simulation: time [s], shape (N,), its log, and the weather it met.

    `step_times` [s] are wall-clock times of one turn of the loop: of every instant where the
    controller ran in Python, else means over blocks of the compiled loop.
    """

    t: Array
    log: Log
    dofs: tuple[str, ...]
    weather: Weather
    step_times: Array = field(default_factory=lambda: np.zeros(0))


def recording_of(voyage: Voyage, weather: Weather) -> Recording:
    """What the instruments saw of a voyage: the measured motion, the command, the acting force.

    The command is the one after the allocation, which the vessel knows.
    """
    log = voyage.log
    return Recording(
        dofs=voyage.dofs,
        t=voyage.t,
        eta=log.eta_measured,
        nu=log.nu_measured,
        nu_dot=log.nu_dot + weather.acceleration_noise,
        tau=log.applied,
        attitude=attitude_of(voyage.dofs, log.eta_measured),
        tau_actual=log.tau_actual,
        wind=measured_wind(voyage, weather),
    )


def measured_wind(voyage: Voyage, weather: Weather) -> Array | None:
    """What an anemometer aboard sees: the air's velocity in body axes [m/s], shape (N, 2).

    None where there is no wind.
    """
    if not len(weather.wind_ned):
        return None
    psi = attitude_of(voyage.dofs, voyage.log.eta)[:, 2]
    noise = weather.wind_noise if len(weather.wind_noise) else 0.0
    return in_body(weather.wind_ned, psi) + noise


@lean_kernel
def _foresee(
    planar: bool, table: Parameters, state: Array, setpoints: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array,
) -> None:  # fmt: skip
    for k in range(setpoints.shape[0]):
        reference_in_body_kernel(planar, state, eta_d[k], nu_d, nu_dot_d)
        reference_step(table, state, setpoints[k])


def outlook(
    plant: Plant, weather: Weather, guidance: NamedTuple, reference_filter: NamedTuple,
    start: Array, added: Array | None = None,
) -> Outlook:  # fmt: skip
    """What can be known ahead: the reference of set-points on a timetable, and the weather's wind.

    Only a guidance law whose parameters are a `Timetable` knows its set-points in advance.
    """
    setpoints = guidance.setpoints if isinstance(guidance, Timetable) else np.zeros((0, 0))
    eta_d = np.zeros_like(setpoints)
    state = np.zeros((len(start), 3))
    state[:, 0] = start
    work = np.zeros((2, len(start)))
    _foresee(plant.planar, reference_filter, state, setpoints, eta_d, *work)
    force = np.zeros((0, 0)) if added is None else np.ascontiguousarray(added, dtype=np.float64)
    return Outlook(eta_d, weather.wind_ned, weather.wind_noise, force)
