"""The folders in which options are searched for: the project's own, then those of the user.

An option is taken from the first of these folders that has it:

1. the project's `conf`, so that a name means the same to everyone,
2. `--config-dir FOLDER`,
3. the folders in SEATRIAL_CONF, separated as in PATH,
4. `conf` of the working folder,
5. `conf` of the packages of plug-ins (seatrial.runner.configuration.plugins).
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.plugins import plugins

CONF = Path(__file__).resolve().parents[2] / "conf"
HARBOURS = CONF / "evaluation" / "harbours"
VARIABLE = "SEATRIAL_CONF"


class UserFolders(SearchPathPlugin):
    """Adds the user's folders to Hydra's search path, behind the project's."""

    config_dir: ClassVar[str | None] = None  # of the command line

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the folders."""
        for folder in user_folders():
            search_path.append("user", f"file://{folder}")


def located(name: object) -> Path:
    """The file of a map; a name without a folder may be that of a map of the benchmark."""
    path = Path(str(name)).expanduser()
    ours = CONF / "benchmark" / "maps" / path
    return ours if len(path.parts) == 1 and not path.is_file() and ours.is_file() else path


def harbour_file(name: object) -> Path:
    """The file of a harbour: a supplied one by its name, or a path."""
    supplied = HARBOURS / f"{name}.geojson"
    return supplied if supplied.is_file() else Path(str(name)).expanduser()


def user_folders() -> list[Path]:
    """Return the folders of the user, absolute, in the order in which they are searched.

    Raises ConfigurationError if SEATRIAL_CONF names a folder that does not exist.
    """
    named = [Path(word) for word in os.environ.get(VARIABLE, "").split(os.pathsep) if word]
    for path in named:
        if not path.is_dir():
            raise ConfigurationError(f"{VARIABLE}: got {path}, expected a folder")
    first = [Path(UserFolders.config_dir)] if UserFolders.config_dir else []
    packaged = [plugin.conf for plugin in plugins() if plugin.conf is not None]
    candidates = [*first, *named, Path("conf"), *packaged]
    found = dict[Path, Path]()
    for path in filter(Path.is_dir, candidates):
        found.setdefault(path.resolve(), path.absolute())
    found.pop(CONF, None)
    return list(found.values())


def options(group: str) -> list[str]:
    """Return the names of a group's options in all folders."""
    folders = [CONF, *user_folders()]
    return sorted({path.stem for folder in folders for path in (folder / group).glob("*.yaml")})


def is_group(name: str) -> bool:
    """Whether a folder has options of this name."""
    return any((folder / name).is_dir() for folder in (CONF, *user_folders()))


def is_option(name: str) -> bool:
    """Whether a trial has an option of this name, or the first of its names with dots."""
    first = name.partition(".")[0]
    return is_group(first) or f"\n{first}:" in (CONF / "trial.yaml").read_text(encoding="utf-8")


def hidden() -> Iterator[str]:
    """Yield a warning for each file of the user that differs from one of an earlier folder."""
    folders = [CONF, *user_folders()]
    for i, folder in enumerate(folders[1:], start=1):
        for file in sorted(folder.glob("**/*.yaml")):
            earlier = (before / file.relative_to(folder) for before in folders[:i])
            first = next(filter(Path.is_file, earlier), file)
            if first.read_bytes() != file.read_bytes():
                yield (
                    f"{os.path.relpath(file)} is not used: seatrial or an earlier folder has a "
                    "file of this name, expected another name"
                )
