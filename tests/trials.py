"""Trials composed from the configuration, as the command line composes them."""

from functools import cache
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from seatrial.models.identification.problem import Problem
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.configuration.vessel_options import filled
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.sweeps.composition import order_of
from seatrial.runner.sweeps.job import Order
from seatrial.runner.trials.closed_loop import SimulatedMission, Streams, prepare
from seatrial.runner.trials.trial import excite

CONF = Path(__file__).parents[1] / "conf"


def options(group: str) -> list[str]:
    """The names of all options of a group."""
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


# Vessels that are commanded by inputs and those by force, known without composing any.
STEERED = tuple(
    name for name in options("vessel")
    if "\ninputs:" in (CONF / "vessel" / f"{name}.yaml").read_text()
)  # fmt: skip
FORCED = tuple(name for name in options("vessel") if name not in STEERED)


@cache
def composed(*overrides: str) -> Trial:
    """The trial that `python -m runner OVERRIDES` would run."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("trial", list(overrides), return_hydra_config=True)
        choices = dict(config.hydra.runtime.choices)
        OmegaConf.set_struct(config, False)
        del config["hydra"]
        resolved = OmegaConf.to_container(config, resolve=True)
    assert isinstance(resolved, dict)
    nodes = filled({str(key): node for key, node in resolved.items()})
    return build_trial(nodes, {group: choices[group] for group in GROUPS})


def ordered(*overrides: str) -> Order:
    """The order that `python -m runner OVERRIDES` makes; disturbance cases may be added up."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("trial", list(overrides), return_hydra_config=True)
        OmegaConf.set_struct(config, False)
        hydra = config.pop("hydra")
        return order_of(config, hydra, list(overrides))


def asked_for(*overrides: str) -> Trial:
    """The trial of that order."""
    order = ordered(*overrides)
    return build_trial(order.config, order.names)


def excited(*overrides: str, seed: int = 0) -> tuple[Problem, Vessel]:
    """A simulated recording in its two parts, and the true model; disturbances may be added up."""
    trial = asked_for(*overrides)
    data = excite(trial, Streams(seed))
    training, testing = (data.recording.part(mask) for mask in (data.training, data.testing))
    assert data.truth is not None
    return Problem(training, testing, trial.vessel.nominal(), trial.vessel.thruster), data.truth


def sailed(
    trial: Trial, mission: Any = None, model: Vessel | None = None, **options: Any
) -> SimulatedMission:
    """The excitation of a trial, or another mission, with a controller for the nominal model."""
    mission = trial.excitation if mission is None else mission
    model = trial.vessel.nominal() if model is None else model
    return prepare(trial, Streams(trial.seed), model, mission, **options).sail()
