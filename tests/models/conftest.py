"""The milliAmpere lap, sailed once a test session: calm, with noise, with a constant force."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.voyage import Voyage, recording_of
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import build_as
from seatrial.runner.configuration.vessel_options import filled

CONF = Path(__file__).parents[2] / "conf"
PERIOD_S = 0.1


@dataclass(frozen=True, eq=False)
class Lap:
    """A sailed lap with the truth behind it."""

    recording: Recording
    problem: Problem
    truth: Vessel  # the true plant's table with the disturbance's share
    thruster: Any

    @property
    def residual(self) -> Vessel:
        return self.truth - self.problem.nominal


option = cache(lambda group, name: OmegaConf.load(CONF / group / f"{name}.yaml"))


def configured(group: str, name: str, **changes: Any) -> Any:
    """The object of a configuration file, sailing the ferry, with some options changed."""
    node = OmegaConf.merge(option(group, name), changes)
    config = {"vessel": option("vessel", "milliampere"), group: node}
    nodes: Any = OmegaConf.to_container(OmegaConf.create(config), resolve=True)
    return build_as(object, filled(nodes)[group], group)


@cache
def ferry() -> Any:
    return configured("vessel", "milliampere")


def voyage(disturbance: str, seed: int, model: Vessel | None = None, step_s: float = 0.025) -> Any:
    """The identification lap with the controller built on `model` (the nominal one)."""
    vessel, mission = ferry(), configured("excitation", "waypoints")
    t = PERIOD_S * np.arange(round(mission.duration_s / PERIOD_S))
    weather = configured("disturbance", disturbance).realise(
        len(t), vessel.dofs, np.random.default_rng(seed)
    )
    truth = vessel.plant_scale * vessel.nominal()
    plant = Plant(truth, vessel.thruster, vessel.velocity_limits)
    return weather, sail(
        plant,
        weather,
        mission.guidance(t, np.zeros(3)),
        mission.reference_filter.table(PERIOD_S),
        configured("controller", "pid_ff").build(model or vessel.nominal(), PERIOD_S),
        np.zeros(3),
        PERIOD_S,
        step_s,
    )


@cache
def sailed(disturbance: str, seed: int = 0) -> Lap:
    """The lap as a trial would see it: first half for training, second for testing."""
    vessel = ferry()
    weather, log = voyage(disturbance, seed)
    recording = recording_of(log, weather).with_thruster(vessel.thruster)
    half = recording.t < 0.5 * len(recording) * PERIOD_S - 1e-9
    problem = Problem(
        recording.part(half), recording.part(~half), vessel.nominal(), vessel.thruster
    )
    truth = vessel.plant_scale * vessel.nominal()
    truth = truth + configured("disturbance", disturbance).table(vessel.dofs)
    return Lap(recording, problem, truth, vessel.thruster)


@pytest.fixture(scope="session")
def lap() -> Callable[..., Lap]:
    """lap(disturbance, seed) -> Lap, each sailed once."""
    return sailed


@pytest.fixture(scope="session")
def calm() -> Lap:
    return sailed("calm")


@pytest.fixture(scope="session")
def constant() -> Lap:
    return sailed("constant")


@pytest.fixture(scope="session")
def identifier() -> Callable[..., Any]:
    """identifier(name, option=value, ...) -> the identifier of conf/identifier/<name>.yaml."""
    return lambda name, **changes: configured("identifier", name, **changes)


@pytest.fixture(scope="session")
def replay() -> Callable[[Vessel], Voyage]:
    """replay(model) -> the calm lap, sailed with the controller built on `model`."""
    return lambda model: voyage("calm", 0, model)[1]


@pytest.fixture(scope="session")
def milliampere() -> Vessel:
    """The nominal model of the ferry, Jervan (2020), Table A.1."""
    return ferry().nominal()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
