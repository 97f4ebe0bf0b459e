"""Plug-ins: installed packages with an entry point `seatrial.plugins`, and modules that are named.

    [project.entry-points."seatrial.plugins"]      (in the pyproject.toml of a package)
    fleet = "fleet"

    SEATRIAL_PLUGINS=speeds,speed_figure           (modules of the working folder, or installed)

The folder `conf` of a plug-in's package is searched for options. Importing a plug-in registers the
metrics that it declares; its modules with a `FIGURE` are kinds of figures.
"""

import logging
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from traceback import walk_tb

from seatrial.models.errors import PartError, SeatrialError

ENTRY_POINTS = "seatrial.plugins"
VARIABLE = "SEATRIAL_PLUGINS"
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Plugin:
    """A plug-in: its name, its module, and the files of this module or package."""

    name: str
    module: str
    files: tuple[Path, ...]
    is_package: bool
    conf: Path | None = None  # a package's folder of configurations


def plugins() -> tuple[Plugin, ...]:
    """Return the plug-ins that are installed or named; one that does not exist is logged."""
    return _plugins(os.environ.get(VARIABLE, ""))


@cache
def _plugins(named: str) -> tuple[Plugin, ...]:
    installed = [(point.name, point.module) for point in entry_points(group=ENTRY_POINTS)]
    modules = [(word.strip(), word.strip()) for word in named.split(",") if word.strip()]
    candidates = (_plugin(name, module) for name, module in (*sorted(installed), *modules))
    return tuple(plugin for plugin in candidates if plugin is not None)


def _plugin(name: str, module: str) -> Plugin | None:
    """Find a plug-in; of a package nothing is imported."""
    try:
        spec = find_spec(module)
    except Exception as error:  # a module inside a package that cannot be imported
        _log_failure(name, error)
        return None
    if spec is None or spec.origin is None:
        log.warning("plug-in %s: there is no module %s", name, module)
        return None
    file = Path(spec.origin)
    if not spec.submodule_search_locations:
        return Plugin(name, module, (file,), False)
    files, conf = tuple(sorted(file.parent.glob("*.py"))), file.with_name("conf")
    return Plugin(name, module, files, True, conf if conf.is_dir() else None)


def load() -> None:
    """Import every plug-in, which registers its metrics; one that fails is logged."""
    for plugin in plugins():
        try:
            import_module(plugin.module)
        except Exception as error:
            _log_failure(plugin.name, error)


def _log_failure(name: str, error: BaseException) -> None:
    log.warning("cannot import plug-in %s", failure(name, error))


def failure(name: str, error: BaseException) -> str:
    """Return a failure of a plug-in in one line."""
    reason = " ".join(str(error).split())
    return f"{name}: {type(error).__name__}{': ' if reason else ''}{reason}"


# The parts of a configuration that come from elsewhere.


def is_own(name: str) -> bool:
    """Whether a class or module belongs to this package."""
    return f"{name}.".startswith(f"{__name__.partition('.')[0]}.")


def targets(node: object) -> Iterator[str]:
    """Yield the classes that a configuration names."""
    if isinstance(node, Mapping):
        if isinstance(node.get("_target_"), str):
            yield node["_target_"]
        node = list(node.values())
    if isinstance(node, list | tuple):
        for child in node:
            yield from targets(child)


@contextmanager
def attributed(config: object) -> Iterator[None]:
    """Turn an exception out of a part from elsewhere into a PartError that names the part.

    Any other exception is a bug of ours, and passes as it is.
    """
    try:
        yield
    except SeatrialError:
        raise
    except Exception as error:
        part = _culprit(error, {name for name in targets(config) if not is_own(name)})
        if part is None:
            raise
        raise PartError(failure(part, error)) from error


def _culprit(error: Exception, parts: Collection[str]) -> str | None:
    """Return the part that an exception passed through; the innermost one of several."""
    frames = [frame.f_globals.get("__name__", "") for frame, _ in walk_tb(error.__traceback__)]
    for module in reversed(frames):
        for part in sorted(parts):
            if module.partition(".")[0] == part.partition(".")[0]:
                return part
    # The step of a part is compiled inside our loop.
    return min(parts, default=None) if type(error).__module__.startswith("numba.") else None
