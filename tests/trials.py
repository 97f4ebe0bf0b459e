"""Trials composed from the configuration, as the command line composes them."""

from functools import cache
from pathlib import Path
from typing import Any

from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode

from seatrial.models.identification.problem import Problem
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.sweeps import in_process
from seatrial.runner.sweeps.composition import Composer, SharingLoader
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
def _composer() -> Composer:
    """What composes the trials of a sweep: those that choose the same options share most of it."""
    in_process.register(())
    with initialize_config_dir(str(CONF), version_base="1.3"):
        hydra = GlobalHydra.instance().hydra
        assert hydra is not None
        master = hydra.compose_config("trial", [], run_mode=RunMode.RUN)
        return Composer(SharingLoader(hydra.config_loader), master)


def ordered(*overrides: str) -> Order:
    """The order that `python -m runner OVERRIDES` makes; disturbance cases may be added up."""
    return _composer().order(list(overrides))


def asked_for(*overrides: str) -> Trial:
    """The trial of that order."""
    order = ordered(*overrides)
    return build_trial(order.config, order.names)


# What is composed once for all tests.
composed = cache(asked_for)


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
