"""A simulated voyage: its log, its recording, and the preview available to a controller."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.simulation.registry import Parameters, Timetable, reference_step
from seatrial.models.vessel.allocation import DeviceAllocation
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body
from seatrial.models.vessel.parameters import Plant
from seatrial.models.weather.weather import Weather


class Log(NamedTuple):
    """Log of the loop, one row per control instant, shape (N, n_dof) each; SI units.

    What is commanded has shape (N, n_inputs) for a vessel with inputs: tau, tau_actual, tau_fb,
    held and applied; if forces are allocated to its devices, only tau_actual and applied have.
    """

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
    held: Array  # 1 where the command was not finite and the previous one was held
    applied: Array  # command after the thrust allocation


ALLOTTED = ("tau_actual", "applied")
COMMANDED = ("tau", "tau_actual", "tau_fb", "held", "applied")


class Outlook(NamedTuple):
    """Preview of the mission and the weather for a controller; SI units.

    Rows are control instants; unknown signals have no rows. `obstacles` and `hull` are those of a
    mission in a harbour.
    """

    reference: Array  # (N, n_dof) reference pose
    wind_ned: Array  # (N, 2) velocity of the air
    wind_noise: Array  # (N, 2) error of the anemometer, body axes; not for future instants
    added: Array  # (N, n_dof) force that is added to the controller's commands
    obstacles: tuple[Array, ...] | None = None  # convex polygons, (n, 2) each [m, NED]
    hull: Array | None = None  # convex polygon, (m, 2) [m, body axes]


NO_OUTLOOK = Outlook(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0)))


@dataclass(frozen=True)
class Voyage:
    """A simulated voyage: time [s], shape (N,), its log and its weather.

    `step_times` [s] are CPU times of one iteration of the loop: for every instant if the controller
    runs in Python, else means over blocks of the compiled loop. `immediate` are the
    axes or inputs that follow their command at once.
    """

    t: Array
    log: Log
    dofs: tuple[str, ...]
    weather: Weather
    immediate: tuple[str, ...] = ()
    step_times: Array = field(default_factory=lambda: np.zeros(0))
    inputs: tuple[str, ...] = ()  # of the vessel; empty: it is commanded by forces on the axes
    allocation: DeviceAllocation | None = None  # of commanded forces to the inputs

    @property
    def positioned(self) -> bool:
        """Whether forces were commanded, and allocated to the inputs."""
        return self.allocation is not None

    @property
    def by_force(self) -> bool:
        """Whether the controller commanded forces."""
        return not self.inputs or self.positioned


def recording_of(voyage: Voyage, weather: Weather) -> Recording:
    """The recording of a voyage: measured motion, command and acting force, or inputs.

    The command is taken after the thrust allocation.
    """
    log = voyage.log
    recording = Recording(
        dofs=voyage.dofs,
        t=voyage.t,
        eta=log.eta_measured,
        nu=log.nu_measured,
        nu_dot=log.nu_dot + weather.acceleration_noise,
        tau=np.zeros_like(log.nu) if voyage.inputs else log.applied,
        attitude=attitude_of(voyage.dofs, log.eta_measured),
        wind=measured_wind(voyage, weather),
        immediate=voyage.immediate,
    )
    if voyage.inputs:
        return replace(
            recording, inputs=log.tau_actual, commands=log.applied, input_names=voyage.inputs
        )
    return replace(recording, tau_actual=log.tau_actual)


def measured_wind(voyage: Voyage, weather: Weather) -> Array | None:
    """Wind measured on board: the velocity of the air in body axes [m/s], shape (N, 2).

    None if there is no wind.
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
        reference_step(table, state, setpoints[k], planar, eta_d[k], nu_d, nu_dot_d)


def outlook(
    plant: Plant, weather: Weather, guidance: NamedTuple, reference_filter: NamedTuple,
    start: Array, added: Array | None = None,
) -> Outlook:  # fmt: skip
    """The preview of a mission: the reference of set-points on a timetable, and the wind.

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
