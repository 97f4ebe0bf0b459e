"""The source of the YAML files of a configuration, with parts that are no options of it.

`vessel=path.yaml` is a file from the working folder, as of every group of a trial, `vessel=run:17`
the identified model of run 17 in the logbook of the trial, as `seatrial-results model 17 --to yaml`
writes it.
"""

import pickle
import re
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, cast

import yaml
from hydra._internal.core_plugins import file_config_source
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.plugins.config_source import ConfigResult
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from seatrial.models.errors import ConfigurationError
from seatrial.runner import database, export
from seatrial.runner.configuration import vessel_options
from seatrial.runner.configuration.invocation import in_words
from seatrial.runner.configuration.search_path import CONF
from seatrial.runner.record.vocabulary import GROUPS, Config

TRIAL = "trial"  # the primary configuration
WHOLE = "+vessel={"
GROUP = "vessel/"
RUN = re.compile(rf"{GROUP}run:(?P<id>\d{{1,18}})(\.yaml)?", re.ASCII)
# Options that say where the logbook is; an experiment may say it as well.
_PLACES = re.compile(r"\+?(results_dir|database(\.url)?|experiment)=")


def file_of(config_path: str) -> Path | None:
    """Return the file that a path of the configuration, `vessel/tug.yaml`, names; else None."""
    group, _, name = config_path.partition("/")
    if group not in GROUPS or not name.endswith(".yaml"):
        return None
    path = Path(name).absolute()
    return path if path.is_file() else None


def node_of(run_id: int, overrides: Sequence[str]) -> Config:
    """Return the vessel of a run's identified model; `overrides` are those of the command line.

    Raises LogbookError if there is no such run or model.
    """
    places = [text for text in overrides if _PLACES.match(text)]  # of the logbook
    config = GlobalHydra.instance().config_loader().load_configuration(
        "trial", overrides=[*places, "vessel=milliampere"], run_mode=RunMode.RUN
    )  # fmt: skip
    url = OmegaConf.select(config, "database.url")
    url = url or database.engine.file_url(Path(str(config.results_dir)) / "results.db")
    with database.LogbookReader.read(str(url)) as logbook:
        return export.stored_model.read_model(logbook, run_id).node


class FileConfigSource(file_config_source.FileConfigSource):
    """Hydra's source of configuration files, with files of the working folder and models of runs.

    Vessels choose excitation, controller and evaluation that suit them (`suited_parts`), beside
    what is named; one that is given whole does so in the defaults of a trial. The class is named as
    Hydra's own: in workers Hydra would refuse another one for files.
    """

    overrides: ClassVar[Sequence[str]] = ()  # of the command line, which say where the logbook is
    job: ClassVar[Sequence[str] | None] = None  # overrides of the trial that is composed
    _own: ClassVar[dict[str, bytes]] = {}  # the program's files: a call loads them twice

    def __init__(self, provider: str, path: str) -> None:
        super().__init__(provider, path)
        self._runs: dict[str, Config] = {}  # workers take them from here

    def is_config(self, config_path: str) -> bool:
        """Whether there is such a file, or the path names a run."""
        return bool(RUN.fullmatch(config_path)) or super().is_config(self._place(config_path))

    def load_config(self, config_path: str) -> ConfigResult:
        """Load a file or the model of a run.

        Raises ConfigurationError if a file is no YAML, and LogbookError if there is no such run.
        """
        if match := RUN.fullmatch(config_path):
            run_id = match["id"]
            if run_id not in self._runs:
                self._runs[run_id] = node_of(int(run_id), self.overrides)
            return ConfigResult(
                provider=self.provider,
                path=f"{self.scheme()}://{self.path}",
                config=self._with_suited_parts(OmegaConf.create(dict(self._runs[run_id]))),
                header=self._get_header_dict(""),
            )
        place = self._place(config_path)
        loaded = self._own if place == config_path and Path(self.path) == CONF else {}
        file = Path(self.path) / self._normalize_file_name(place)
        try:
            if place not in loaded:
                loaded[place] = pickle.dumps(super().load_config(place))
            # Hydra takes the defaults list out of it; a deep copy takes four times as long.
            result: ConfigResult = pickle.loads(loaded[place])
        except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
            mark = getattr(error, "problem_mark", None)
            line = "" if mark is None else f", line {mark.line + 1}"
            reason = in_words(getattr(error, "problem", None) or str(error).splitlines()[0])
            raise ConfigurationError(f"{file}{line}: {reason}, expected YAML") from error
        if not isinstance(result.config, DictConfig):
            raise ConfigurationError(f"{file}: got a list, expected options")
        if config_path.startswith(GROUP):
            result.config = self._with_suited_parts(result.config)
        if config_path.removesuffix(".yaml") == TRIAL and (whole := self._whole_vessel()):
            for part in result.config.defaults:
                if isinstance(part, DictConfig):
                    part.update({k: v for k, v in self._suited(whole).items() if k in part})
        return result

    def _whole_vessel(self) -> Config:
        """The vessel that a trial gives as a mapping instead of an option; else empty."""
        texts = [text for text in self._words() if text.startswith(WHOLE)]
        value = OverridesParser.create().parse_override(texts[-1]).value() if texts else {}
        return cast(Config, value)

    def _words(self) -> Sequence[str]:
        return self.overrides if self.job is None else self.job

    def _suited(self, vessel: Config) -> vessel_options.Choice:
        return vessel_options.suited_parts(vessel, self._words())

    @staticmethod
    def _place(config_path: str) -> str:
        file = file_of(config_path)
        return config_path if file is None else str(file)

    def _with_suited_parts(self, vessel: DictConfig) -> DictConfig:
        """Return a vessel with a defaults list of the parts that suit it, unless it has a list."""
        try:
            node = cast(Config, OmegaConf.to_container(vessel, resolve=True))
        except OmegaConfBaseException:
            return vessel  # it is reported when the trial is composed
        if "defaults" in node:
            return vessel
        overrides = [{f"override /{k}@_global_.{k}": v} for k, v in self._suited(node).items()]
        return cast(DictConfig, OmegaConf.merge({"defaults": ["_self_", *overrides]}, vessel))
