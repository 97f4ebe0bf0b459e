"""The source of the YAML files of a configuration, which are checked before they are expanded.

Anchors make a file of a few lines as large as the memory. So the nodes that its aliases stand for
are counted in the events of the parser, which holds no copy of them.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import yaml
from hydra._internal.core_plugins import file_config_source
from hydra.plugins.config_source import ConfigResult
from omegaconf import OmegaConf

from seatrial.models.errors import ConfigurationError
from seatrial.runner import vessel_files

LARGEST = 1_000_000  # bytes of a file
MOST_NODES = 100_000  # with those that aliases stand for
DEEPEST = 50  # nested levels

# libyaml is faster by an order of magnitude, where PyYAML is built with it.
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
BEGIN = (yaml.MappingStartEvent, yaml.SequenceStartEvent)
END = (yaml.MappingEndEvent, yaml.SequenceEndEvent)


class FileConfigSource(file_config_source.FileConfigSource):
    """Hydra's source of configuration files, which checks a file before it is loaded.

    Vessels may also be files of the working folder, and models of runs (`vessel_files`). Its name
    is that of Hydra's own: in workers Hydra would refuse another one for files.
    """

    overrides: ClassVar[Sequence[str]] = ()  # of the command line, which say where the logbook is

    def __init__(self, provider: str, path: str) -> None:
        super().__init__(provider, path)
        self._runs: dict[str, dict[str, Any]] = {}  # workers take them from here

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
                config=OmegaConf.create(self._runs[run_id]),
                header=self._get_header_dict(""),
            )
        place = self._place(config_path)
        check_file(Path(self.path) / self._normalize_file_name(place))
        return super().load_config(place)

    @staticmethod
    def _place(config_path: str) -> str:
        file = vessel_files.file_of(config_path)
        return config_path if file is None else str(file)


def check_file(path: Path) -> None:
    """Raise ConfigurationError for a file that is too large, too deep, or no YAML.

    A file that does not exist is left to Hydra, which knows where it looked.
    """
    try:
        size = path.stat().st_size
        if size > LARGEST:
            raise ConfigurationError(f"{path}: got {size} bytes, expected at most {LARGEST}")
        data = path.read_bytes()
    except OSError:
        return
    try:
        check_text(data, str(path))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        reason = getattr(error, "problem", None) or " ".join(str(error).split())
        raise ConfigurationError(f"{path}{line}: {reason}, expected YAML") from error


def check_text(data: bytes, name: str) -> None:
    """Raise ConfigurationError for YAML text of too many nodes or levels; `name` is its file."""
    sizes: dict[str, int] = {}  # of anchored nodes
    open_nodes: list[tuple[str | None, int]] = []  # anchor, number of nodes before it
    count = 0
    for event in yaml.parse(data, Loader=LOADER):
        if isinstance(event, END):
            anchor, before = open_nodes.pop()
            if anchor is not None:
                sizes[anchor] = count - before
            continue
        if isinstance(event, yaml.AliasEvent):
            where = f"{name}, line {event.start_mark.line + 1}"
            if event.anchor in (anchor for anchor, _ in open_nodes):
                raise ConfigurationError(f"{where}: *{event.anchor} stands for a node around it")
            count += sizes.get(event.anchor, 1)
        elif isinstance(event, BEGIN):
            open_nodes.append((event.anchor, count))
            count += 1
        elif isinstance(event, yaml.ScalarEvent):
            count += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
        if count > MOST_NODES or len(open_nodes) > DEEPEST:
            what = f"{MOST_NODES} nodes" if count > MOST_NODES else f"{DEEPEST} levels"
            line = event.start_mark.line + 1
            raise ConfigurationError(f"{name}, line {line}: got more than {what}, with aliases")
