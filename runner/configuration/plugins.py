"""Plug-ins: installed packages with an entry point `seatrial.plugins`, and modules that are named.

    [project.entry-points."seatrial.plugins"]      (in the pyproject.toml of a package)
    fleet = "fleet"

    SEATRIAL_PLUGINS=speeds,speed_figure           (modules of the working folder, or installed)

The folder `conf` of a plug-in's package is searched for options. Importing a plug-in registers the
metrics that it declares; its modules with a `FIGURE` are kinds of figures.
"""

import logging
import os
from collections.abc import Iterator, Mapping
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
BROKEN = "cannot import plug-in %s"
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Plugin:
    """A plug-in: its module, and the files of this module or package by their names."""

    module: str
    files: Mapping[str, Path]
    conf: Path | None = None  # a package's folder of configurations


def plugins() -> tuple[Plugin, ...]:
    """Return the plug-ins that are installed or named; one that does not exist is logged."""
    return _plugins(os.environ.get(VARIABLE, ""))


@cache
def _plugins(named: str) -> tuple[Plugin, ...]:
    installed = sorted(point.module for point in entry_points(group=ENTRY_POINTS))
    modules = (*installed, *filter(None, map(str.strip, named.split(","))))
    return tuple(plugin for plugin in map(_plugin, modules) if plugin is not None)


def _plugin(module: str) -> Plugin | None:
    """Find a plug-in; of a package nothing is imported."""
    try:
        spec = find_spec(module)
    except Exception as error:  # a module inside a package that cannot be imported
        log.warning(BROKEN, failure(module, error))
        return None
    if spec is None or spec.origin is None:
        log.warning("plug-in %s: there is no such module", module)
        return None
    file = Path(spec.origin)
    if not spec.submodule_search_locations:
        return Plugin(module, {module: file})
    files = {f"{module}.{path.stem}": path for path in sorted(file.parent.glob("[!_]*.py"))}
    conf = file.with_name("conf")
    return Plugin(module, {module: file, **files}, conf if conf.is_dir() else None)


def load() -> None:
    """Import every plug-in, which registers its metrics; one that fails is logged."""
    for plugin in plugins():
        try:
            import_module(plugin.module)
        except Exception as error:
            log.warning(BROKEN, failure(plugin.module, error))


def failure(name: str, error: BaseException) -> str:
    """Return a failure of a plug-in in one line."""
    reason = " ".join(str(error).split())
    return f"{name}: {type(error).__name__}{': ' if reason else ''}{reason}"


def is_own(name: str) -> bool:
    """Whether a class or module belongs to this package."""
    return f"{name}.".startswith(f"{__name__.partition('.')[0]}.")


def leaves(node: object, key: str = "") -> Iterator[tuple[str, object]]:
    """Yield the values of a configuration that hold no others, each with its option."""
    if isinstance(node, Mapping):
        for name, child in node.items():
            yield from leaves(child, f"{key}.{name}" if key else str(name))
    elif isinstance(node, list | tuple):
        for i, child in enumerate(node):
            yield from leaves(child, f"{key}[{i}]")
    else:
        yield key, node


def targets(node: object) -> list[str]:
    """Return the classes that a configuration names."""
    named = (value for key, value in leaves(node) if key.rpartition(".")[2] == "_target_")
    return [value for value in named if isinstance(value, str)]


@contextmanager
def attributed(config: object) -> Iterator[None]:
    """Turn an exception out of a part from elsewhere into a PartError that names the part.

    Of several that it passed through that is the innermost one. Any other exception is a bug of
    ours, and passes as it is.
    """
    try:
        yield
    except SeatrialError:
        raise
    except Exception as error:
        parts = sorted({name for name in targets(config) if not is_own(name)})
        frames = [frame.f_globals.get("__name__", "") for frame, _ in walk_tb(error.__traceback__)]
        tops = [module.partition(".")[0] for module in reversed(frames)]
        passed = [part for top in tops for part in parts if part.partition(".")[0] == top]
        if type(error).__module__.startswith("numba."):
            passed += parts  # whose steps are compiled inside our loop
        if not passed:
            raise
        raise PartError(failure(passed[0], error)) from error
