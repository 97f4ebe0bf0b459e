"""The declaration of a figure, and the search for figures.

Each file of the folder `plots` with `FIGURE = Figure(...)` and `drawings(results, request)` is a
figure; there is no other list of figures. The arguments of the declaration are literals and are
read without importing the file, because the help shows them and matplotlib is slow to import.
Files of plug-ins are searched for figures too (seatrial.runner.plugins). Any other module with the
same two names is a figure as well; it is selected by its module name.
"""

import ast
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal

from seatrial.models.errors import ConfigurationError, PartError, SeatrialError
from seatrial.runner.plugins import failure, is_own, plugins

if TYPE_CHECKING:
    from seatrial.runner.compare.frame import Queries
    from seatrial.runner.compare.plots.request import PlotRequest
    from seatrial.runner.compare.plots.style import Drawing

    Drawings = Callable[[Queries, PlotRequest], list[Drawing]]

PLOTS = Path(__file__).with_name("plots")
log = logging.getLogger(__name__)
LONGEST_NAME = 200  # of a module


@dataclass(frozen=True)
class Figure:
    """A kind of figure.

    `needs` is the data that runs must have stored. `rows` is the default of --rows. A report shows
    the figure with `caption` at position `place`, once for every level of `each`; a figure without
    a caption is not in the report.
    """

    name: str
    help: str
    needs: str
    rows: str = ""
    caption: str = ""
    place: int = 0
    each: Literal["", "dof", "column", "metric and dof"] = ""


@cache
def figures() -> dict[str, Figure]:
    """Return the figures of the folder `plots` and of plug-ins by name, in alphabetical order."""
    return {name: figure for name, (figure, _) in sorted(_declared().items())}


def figure_of(name: str) -> Figure:
    """Return the declaration of a figure; raises ConfigurationError for an unknown name."""
    figure = figures().get(name)
    if figure is not None:
        return figure
    figure = vars(_module(name)).get("FIGURE")
    if not isinstance(figure, Figure):
        raise ConfigurationError(f"plot: {name} has no FIGURE = Figure(...)")
    return figure


def drawings_of(name: str) -> "Drawings":
    """Return the function that draws a figure; raises ConfigurationError for an unknown name.

    Errors of a function from elsewhere are PartErrors with the name of its module.
    """
    module = _module(name)
    drawings: Drawings | None = vars(module).get("drawings")
    if drawings is None:
        raise ConfigurationError(f"plot: {name} has no function drawings(results, request)")
    return drawings if is_own(module.__name__) else _guarded(drawings, module.__name__)


def _guarded(drawings: "Drawings", module: str) -> "Drawings":
    def draw(results: "Queries", request: "PlotRequest") -> "list[Drawing]":
        try:
            return drawings(results, request)
        except SeatrialError:
            raise
        except Exception as error:
            raise PartError(failure(f"{module}.drawings", error)) from error

    return draw


def _module(name: str) -> ModuleType:
    """Return the module of a figure, given its name or the name of another module."""
    module = _declared()[name][1] if name in _declared() else name
    if len(module) < LONGEST_NAME and all(part.isidentifier() for part in module.split(".")):
        try:
            return import_module(module)
        except Exception as error:
            missing = error.name if isinstance(error, ModuleNotFoundError) else None
            if not f"{module}.".startswith(f"{missing}."):  # there is one, and it fails
                if is_own(module):
                    raise
                raise PartError(f"plot: cannot import {failure(module, error)}") from error
    expected = ", ".join(figures())
    raise ConfigurationError(
        f"plot: got {name!r}, expected one of {expected}, or the name of a module"
    )


@cache
def _declared() -> dict[str, tuple[Figure, str]]:
    """The figures with their modules; of two of one name the first counts."""
    result: dict[str, tuple[Figure, str]] = {}
    for file, module in _files():
        figure = _declaration(file) if is_own(module) else _foreign_declaration(file)
        if figure is None:
            continue
        if figure.name in result:
            log.warning(
                "figure %s of %s is not used: %s has it",
                figure.name,
                module,
                result[figure.name][1],
            )
        else:
            result[figure.name] = figure, module
    return result


def _files() -> Iterator[tuple[Path, str]]:
    """Yield the files that may declare a figure, with their modules."""
    for path in sorted(PLOTS.glob("*.py")):
        yield path, f"{__package__}.plots.{path.stem}"
    for plugin in plugins():
        for path in plugin.files:
            inside = plugin.is_package and path.stem != "__init__"
            yield path, f"{plugin.module}.{path.stem}" if inside else plugin.module


def _foreign_declaration(path: Path) -> Figure | None:
    try:
        return _declaration(path)
    except Exception as error:
        log.warning("%s is no figure: %s", path, " ".join(str(error).split()))
        return None


def _declaration(path: Path) -> Figure | None:
    text = path.read_text(encoding="utf-8")
    if "\nFIGURE = " not in text:
        return None
    for node in ast.parse(text).body:
        match node:
            case ast.Assign(targets=[ast.Name("FIGURE")], value=ast.Call() as call):
                options = {
                    keyword.arg or "": ast.literal_eval(keyword.value) for keyword in call.keywords
                }
                return Figure(*map(ast.literal_eval, call.args), **options)
    return None
