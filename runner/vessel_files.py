"""Vessels that are no option of the configuration: `vessel=path.yaml` and `vessel=run:17`.

A path is one from the working folder. `run:17` is the identified model of run 17 in the logbook of
the trial, as `seatrial-results model 17 --to yaml` writes it.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode
from omegaconf import OmegaConf

from seatrial.runner import database, export
from seatrial.runner.vocabulary import Config

GROUP = "vessel/"
RUN = re.compile(rf"{GROUP}run:(?P<id>\d{{1,18}})(\.yaml)?", re.ASCII)
# Options that say where the logbook is; an experiment may say it as well.
_PLACES = re.compile(r"\+?(results_dir|database(\.url)?|experiment)=")


def file_of(config_path: str) -> Path | None:
    """Return the file that a path of the configuration, `vessel/tug.yaml`, names; else None."""
    if not config_path.startswith(GROUP) or not config_path.endswith(".yaml"):
        return None
    path = Path(config_path.removeprefix(GROUP)).absolute()
    return path if path.is_file() else None


def node_of(run_id: int, overrides: Sequence[str]) -> Config:
    """Return the vessel of a run's identified model; `overrides` are those of the command line.

    Raises LogbookError if there is no such run or model.
    """
    url = _logbook(overrides)
    with database.Reader.read(url) as logbook:
        return export.stored_model.read_model(logbook, run_id).node


def _logbook(overrides: Sequence[str]) -> str:
    """Return the address of the trial's logbook, from the rest of its configuration."""
    places = [text for text in overrides if _PLACES.match(text)]
    config = GlobalHydra.instance().config_loader().load_configuration(
        "trial", overrides=[*places, "vessel=milliampere"], run_mode=RunMode.RUN
    )  # fmt: skip
    url = OmegaConf.select(config, "database.url")
    return str(url or database.engine.file_url(Path(str(config.results_dir)) / "results.db"))
