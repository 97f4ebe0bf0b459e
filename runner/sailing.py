"""Sailing a mission of a trial: the plant, its weather, the controller, and who watches."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from models.basis import Array
from models.control.limits import largest_disturbance
from models.disturbance import Disturbance
from models.dynamics import Weather
from models.excitation.mission import Mission, accompanied, added_force, start_of, steering
from models.kinematics import in_body
from models.recording import attitude_of
from models.simulation import Log, Outlook, Plant, Voyage, Watch, outlook, sail
from models.statespace import StateSpace
from models.vessel import Vessel
from runner.adaptive import Adapter
from runner.config import Trial
from runner.control_rows import Sailed


class Streams(NamedTuple):
    """Independent seeds of one trial; making a generator of one again repeats its numbers."""

    excitation: np.random.SeedSequence
    noise: np.random.SeedSequence
    disturbance: np.random.SeedSequence
    identifier: np.random.SeedSequence


def streams(seed: int) -> Streams:
    """The independent seeds of a trial."""
    return Streams(*np.random.SeedSequence(seed).spawn(len(Streams._fields)))


def sail_mission(
    trial: Trial,
    seeds: Streams,
    model: Vessel | StateSpace,
    mission: Mission,
    *,
    deployed: bool = False,
    adaptive: bool = False,
) -> Sailed:
    """Sail a mission with the controller built on `model`, from rest where it begins.

    A deployment meets the change of the plant; an adaptive one identifies while it sails.
    """
    if deployed and hasattr(trial.controller, "deployed"):
        trial = replace(trial, controller=trial.controller.deployed())
    vessel, period = trial.vessel, trial.sample_time_s
    t = period * np.arange(round(mission.duration_s / period), dtype=np.float64)
    start = start_of(mission, vessel.dofs)
    weather, plant = weather_of(trial, seeds, len(t)), plant_of(trial, deployed)
    guidance, reference = mission.guidance(t, start), mission.reference_filter.table(period)
    added = added_force(mission, t, vessel.dofs, np.random.default_rng(seeds.excitation))
    ahead = outlook(plant, weather, guidance[0], reference, start, added)
    steered = steering(mission, vessel.dofs, period)
    parameters, state = steered or trial.controller.build(model, period)
    if steered is None and hasattr(trial.controller, "foresee"):
        parameters = trial.controller.foresee(parameters, ahead)
    adapter = None
    if adaptive and isinstance(model, Vessel):
        adapter = adapter_of(trial, model, weather, seeds, ahead)
    both = accompanied(mission, vessel.dofs, period, (parameters, state))
    voyage = sail(
        plant,
        weather,
        guidance,
        reference,
        both,
        start,
        period,
        trial.integration_step_s,
        watch=watch_of(adapter, alone=both[0] is parameters),
        added=added,
    )
    heading = ahead.reference[:, 2] if vessel.planar and len(ahead.reference) else np.zeros(0)
    needed = largest_disturbance(plant.vessel, weather, heading)
    return sailed(trial, voyage, model, state, needed, adapter)


def watch_of(adapter: Adapter | None, alone: bool) -> Watch | None:
    """Who looks at the controller's parameters, also where a zig-zag stands beside it."""
    if adapter is None or alone:
        return None if adapter is None else adapter.watch

    def look(k: int, log: Log, both: Any, state: Any) -> Any:
        return both._replace(controller=adapter.look(k, log, both.controller, state[0]))

    return Watch(adapter.watch.every, look)


def weather_of(trial: Trial, seeds: Streams, n: int) -> Weather:
    """The trial's one realisation of its disturbance, over n control instants."""
    disturbance, dofs = trial.disturbance, trial.vessel.dofs
    assert isinstance(disturbance, Disturbance)
    noise, weather = (np.random.default_rng(s) for s in (seeds.noise, seeds.disturbance))
    return disturbance.realise(n, dofs, noise, weather, trial.sample_time_s)


def plant_of(trial: Trial, deployed: bool) -> Plant:
    """The true vessel in its wind, and in a deployment what it changes to."""
    vessel = trial.vessel
    wind, change = trial.disturbance.aerodynamics(vessel.dofs), trial.plant_change
    plant: Plant = vessel.plant(trial.plant_scale * vessel.nominal() + wind)
    if not deployed or change is None:
        return plant
    return replace(plant, change=(change.at_s, change.scale * vessel.nominal() + wind))


def adapter_of(
    trial: Trial, model: Vessel, weather: Weather, seeds: Streams, ahead: Outlook
) -> Adapter:
    """What identifies while sailing; any controller can be built again, and keeps its memory."""
    controller, vessel, period = trial.controller, trial.vessel, trial.sample_time_s

    def build_again(parameters: Any, state: Any, model: Vessel, log: Log, k: int) -> Any:
        return controller.foresee(controller.build(model, period)[0], ahead)

    return Adapter(
        trial.update, trial.identifier, vessel.thruster, weather, vessel.dofs, period, model,
        np.random.default_rng(seeds.identifier), getattr(controller, "adapt", build_again),
    )  # fmt: skip


def sailed(
    trial: Trial,
    voyage: Voyage,
    model: Vessel | StateSpace,
    state: Any,
    needed: Array,
    adapter: Adapter | None = None,
) -> Sailed:
    """A voyage with what its controller says of itself, as far as it does."""
    controller, period = trial.controller, trial.sample_time_s
    wind = wind_force(trial.disturbance.aerodynamics(voyage.dofs), voyage)
    if controller is None:  # an open loop
        return Sailed(voyage, period, None, 0, 0, (), needed, wind=wind)
    ahead, every, remarks = (
        getattr(controller, name, None) for name in ("preview_rows", "command_rows", "remarks")
    )
    failures = getattr(state, "failures", None)
    return Sailed(
        voyage=voyage,
        period_s=period,
        limits=controller.limits if getattr(controller, "limited", False) else None,
        ahead=0 if ahead is None else ahead(period),
        every=1 if every is None else every(period),
        failures=0 if failures is None else int(failures[0]),
        remarks=() if remarks is None else remarks(model, period),
        needed=needed,
        adapter=adapter,
        wind=wind,
    )


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
