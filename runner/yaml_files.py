"""The source of the YAML files of a configuration, which are checked before they are expanded."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from hydra._internal.core_plugins import file_config_source
from hydra.plugins.config_source import ConfigResult
from omegaconf import OmegaConf

from seatrial.runner import vessel_files
from seatrial.runner.checked_yaml import check_file
from seatrial.runner.vocabulary import Config


class FileConfigSource(file_config_source.FileConfigSource):
    """Hydra's source of configuration files, which checks a file before it is loaded.

    Vessels may also be files of the working folder, and models of runs (`vessel_files`). Its name
    is that of Hydra's own: in workers Hydra would refuse another one for files.
    """

    overrides: ClassVar[Sequence[str]] = ()  # of the command line, which say where the logbook is

    def __init__(self, provider: str, path: str) -> None:
        super().__init__(provider, path)
        self._runs: dict[str, Config] = {}  # workers take them from here

    def is_config(self, config_path: str) -> bool:
        """Whether there is such a file, or the path names a run."""
        return bool(vessel_files.RUN.fullmatch(config_path)) or super().is_config(
            self._place(config_path)
        )

    def load_config(self, config_path: str) -> ConfigResult:
        """Load a file or the model of a run.

        Raises ConfigurationError if a file is too large, too deep, or no YAML, and LogbookError if
        there is no such run.
        """
        if match := vessel_files.RUN.fullmatch(config_path):
            run_id = match["id"]
            if run_id not in self._runs:
                self._runs[run_id] = vessel_files.node_of(int(run_id), self.overrides)
            return ConfigResult(
                provider=self.provider,
                path=f"{self.scheme()}://{self.path}",
                config=OmegaConf.create(dict(self._runs[run_id])),
                header=self._get_header_dict(""),
            )
        place = self._place(config_path)
        check_file(Path(self.path) / self._normalize_file_name(place))
        return super().load_config(place)

    @staticmethod
    def _place(config_path: str) -> str:
        file = vessel_files.file_of(config_path)
        return config_path if file is None else str(file)
