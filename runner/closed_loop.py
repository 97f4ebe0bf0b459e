"""A mission of a trial in closed loop: the plant, its weather, the controller, and adaptation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.control.controller import Controller
from seatrial.models.control.linear_design import largest_disturbance
from seatrial.models.excitation.missions import Mission
from seatrial.models.findings import Finding
from seatrial.models.identification.adaptive import Adapter
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.simulation.loop import Watch, sail
from seatrial.models.simulation.registry import Parameters, State
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import Log, Outlook, Voyage, outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather
from seatrial.runner.config import Trial


@dataclass(frozen=True, eq=False)
class Design:
    """What a controller says of itself on a model, known before it sails."""

    dofs: tuple[str, ...]
    needed: Array  # (n_dof,) largest force that standing still takes [N, Nm]
    limits: tuple[float, ...] | None = None  # [N, Nm]
    ahead: int = 0  # loop instants of its preview
    every: int = 1  # loop instants from one command to the next
    remarks: Sequence[Finding] = ()

    @property
    def infeasible(self) -> Array:
        """Whether an axis of the limits is below the largest disturbance, shape (n_dof,)."""
        if self.limits is None:
            return np.zeros(len(self.needed), dtype=bool)
        return np.asarray(self.needed > np.array(self.limits))


@dataclass(frozen=True, eq=False)
class Sailed:
    """A voyage, and the design that sailed it."""

    voyage: Voyage
    period_s: float
    design: Design
    failures: int = 0  # commands that the controller could not compute, and held
    adapter: Adapter | None = None  # what identified while sailing
    wind: Array | None = None  # (N, n_dof) force of the wind [N, Nm]


class Streams(NamedTuple):
    """Independent seeds of one trial; making a generator of one again repeats its numbers."""

    excitation: np.random.SeedSequence
    noise: np.random.SeedSequence
    disturbance: np.random.SeedSequence
    identifier: np.random.SeedSequence


def streams(seed: int) -> Streams:
    """The independent seeds of a trial."""
    return Streams(*np.random.SeedSequence(seed).spawn(len(Streams._fields)))


@dataclass(frozen=True, eq=False)
class Prepared:
    """A mission before it is sailed: the plant in its weather, and the controller as built."""

    trial: Trial
    seeds: Streams
    model: Vessel | StateSpace
    mission: Mission
    plant: Plant
    weather: Weather
    guidance: tuple[Parameters, State]
    reference: Parameters
    controller: Controller | None  # None: the mission steers in its place
    control: tuple[Parameters, State]
    start: Array
    added: Array | None  # by an excitation to the command
    ahead: Outlook
    design: Design

    def sail(self, adaptive: bool = False) -> Sailed:
        """Sail it; an adaptive one identifies meanwhile. Raises Diverged."""
        trial, adapter = self.trial, None
        if adaptive and self.controller is not None and isinstance(self.model, Vessel):
            adapter = adapter_of(
                trial, self.controller, self.model, self.weather, self.seeds, self.ahead
            )
        dofs, period = trial.vessel.dofs, trial.sample_time_s
        both = self.mission.accompany(dofs, period, self.control)
        voyage = sail(
            self.plant, self.weather, self.guidance, self.reference, both, self.start, period,
            trial.integration_step_s,
            watch=watch_of(adapter, alone=both[0] is self.control[0]), added=self.added,
        )  # fmt: skip
        controller, state = self.controller, self.control[1]
        return Sailed(
            voyage, period, self.design,
            failures=0 if controller is None else controller.failures(state),
            adapter=adapter,
            wind=wind_force(trial.disturbance.aerodynamics(dofs), voyage),
        )  # fmt: skip


def prepare(
    trial: Trial, seeds: Streams, model: Vessel | StateSpace, mission: Mission,
    deployed: bool = False,
) -> Prepared:  # fmt: skip
    """A mission from rest where it begins, with the controller built on `model`.

    A deployment meets the change of the plant.
    """
    vessel, period = trial.vessel, trial.sample_time_s
    t = period * np.arange(round(mission.duration_s / period), dtype=np.float64)
    start = np.zeros(len(vessel.dofs)) if mission.start is None else np.array(mission.start)
    weather, plant = weather_of(trial, seeds, len(t)), plant_of(trial, deployed)
    guidance, reference = mission.guidance(t, start), mission.reference_filter.table(period)
    added = mission.force(t, vessel.dofs, np.random.default_rng(seeds.excitation))
    ahead = outlook(plant, weather, guidance[0], reference, start, added)
    heading = ahead.reference[:, 2] if vessel.planar and len(ahead.reference) else np.zeros(0)
    design = Design(vessel.dofs, largest_disturbance(plant.vessel, weather, heading))
    control, controller = mission.steering(vessel.dofs, period), None
    if control is None:
        controller = controller_of(trial, deployed)
        parameters, state = controller.build(model, period)
        control = controller.foresee(parameters, ahead), state
        design = design_of(controller, model, period, design)
    return Prepared(
        trial, seeds, model, mission, plant, weather, guidance, reference, controller, control,
        start, added, ahead, design,
    )  # fmt: skip


def controller_of(trial: Trial, deployed: bool) -> Controller:
    """What sails a closed loop, in a deployment or before it."""
    assert trial.controller is not None
    return trial.controller.deployed() if deployed else trial.controller


def design_of(
    controller: Controller, model: Vessel | StateSpace, period: float, design: Design
) -> Design:
    """What a controller says of itself."""
    return replace(
        design,
        limits=controller.command_limits(),
        ahead=controller.preview_rows(period),
        every=controller.command_rows(period),
        remarks=controller.remarks(model, period),
    )


def sail_mission(
    trial: Trial,
    seeds: Streams,
    model: Vessel | StateSpace,
    mission: Mission,
    *,
    deployed: bool = False,
    adaptive: bool = False,
) -> Sailed:
    """Prepare a mission and sail it."""
    return prepare(trial, seeds, model, mission, deployed).sail(adaptive)


def watch_of(adapter: Adapter | None, alone: bool) -> Watch | None:
    """Who looks at the controller's parameters, also where a zig-zag stands beside it."""
    if adapter is None or alone:
        return None if adapter is None else adapter.watch

    def look(k: int, log: Log, both: Parameters, state: State) -> Parameters:
        return both._replace(controller=adapter.look(k, log, both.controller, state[0]))

    return Watch(adapter.watch.every, look)


def weather_of(trial: Trial, seeds: Streams, n: int) -> Weather:
    """The trial's one realisation of its disturbance, over n control instants."""
    disturbance, dofs = trial.disturbance, trial.vessel.dofs
    noise, weather = (np.random.default_rng(s) for s in (seeds.noise, seeds.disturbance))
    return disturbance.realise(n, dofs, noise, weather, trial.sample_time_s)


def plant_of(trial: Trial, deployed: bool) -> Plant:
    """The true vessel in its wind, and in a deployment what it changes to."""
    vessel = trial.vessel
    wind, change = trial.disturbance.aerodynamics(vessel.dofs), trial.plant_change
    plant = vessel.plant(trial.plant_scale * vessel.nominal() + wind)
    if not deployed or change is None:
        return plant
    return replace(plant, change=(change.at_s, change.scale * vessel.nominal() + wind))


def adapter_of(
    trial: Trial, controller: Controller, model: Vessel, weather: Weather, seeds: Streams,
    ahead: Outlook,
) -> Adapter:  # fmt: skip
    """What identifies while sailing."""
    vessel, period = trial.vessel, trial.sample_time_s
    assert trial.update is not None

    def adapt(parameters: Parameters, state: State, model: Vessel, log: Log, k: int) -> Parameters:
        return controller.adapt(parameters, state, model, period, ahead, log, k)

    return Adapter(
        trial.update, trial.identifier, vessel.thruster, weather, vessel.dofs, period, model,
        np.random.default_rng(seeds.identifier), adapt,
    )  # fmt: skip


def wind_force(table: Vessel, voyage: Voyage) -> Array | None:
    """The force of the wind on the vessel [N, Nm], shape (N, n_dof); None where there is none."""
    wind = wind_in_body(voyage)
    if wind is None or not table.terms:
        return None
    still = np.zeros_like(voyage.log.nu)
    attitude = attitude_of(voyage.dofs, voyage.log.eta)
    return -table.inverse(still, voyage.log.nu, attitude, wind)


def wind_in_body(voyage: Voyage) -> Array | None:
    """The air's velocity seen from the vessel [m/s], shape (N, 2); None where there is none."""
    ned = voyage.weather.wind_ned
    return in_body(ned, attitude_of(voyage.dofs, voyage.log.eta)[:, 2]) if len(ned) else None


@dataclass(frozen=True, eq=False)
class Excited:
    """A recording with its training part, and the truth behind it where it is known."""

    recording: Recording
    training: NDArray[np.bool_]  # mask of the training samples, shape (N,)
    testing: NDArray[np.bool_]
    truth: Vessel | None  # the plant's table with the disturbance's share
    sailed: Sailed | None = None  # the voyage that was recorded, where it was a simulation
