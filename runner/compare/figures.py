"""The declaration of a figure, and the search for figures.

Each file of the folder `plots` with `FIGURE = Figure(...)` and `drawings(results, request)` is a
figure; there is no other list of figures. The arguments of the declaration are literals and are
read without importing the file, because the help shows them and matplotlib is slow to import. Any
other module with the same two names is a figure too; it is selected by its module name.
"""

import ast
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from seatrial.models.errors import ConfigurationError

if TYPE_CHECKING:
    from seatrial.runner.compare.plots.request import PlotRequest
    from seatrial.runner.compare.plots.style import Drawing
    from seatrial.runner.compare.results import Results

    Drawings = Callable[[Results, PlotRequest], list[Drawing]]

PLOTS = Path(__file__).with_name("plots")
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
    """Return the figures of the folder `plots` by name, in alphabetical order."""
    return {figure.name: figure for figure, _ in sorted(_files(), key=lambda entry: entry[0].name)}


def figure_of(name: str) -> Figure:
    """Return the declaration of a figure; raises ConfigurationError for an unknown name."""
    figure = figures().get(name)
    if figure is not None:
        return figure
    figure = vars(import_module(_module(name))).get("FIGURE")
    if not isinstance(figure, Figure):
        raise ConfigurationError(f"plot: {name} has no FIGURE = Figure(...)")
    return figure


def drawings_of(name: str) -> "Drawings":
    """Return the function that draws a figure; raises ConfigurationError for an unknown name."""
    drawings: Drawings | None = vars(import_module(_module(name))).get("drawings")
    if drawings is None:
        raise ConfigurationError(f"plot: {name} has no function drawings(results, request)")
    return drawings


def _module(name: str) -> str:
    """Return the module of a figure, given its name or the name of another module."""
    for figure, path in _files():
        if figure.name == name:
            return f"{__package__}.plots.{path.stem}"
    if len(name) < LONGEST_NAME and all(part.isidentifier() for part in name.split(".")):
        try:
            return import_module(name).__name__
        except ModuleNotFoundError as error:
            if not f"{name}.".startswith(f"{error.name}."):
                raise  # an import inside the module failed
    expected = ", ".join(figures())
    raise ConfigurationError(
        f"plot: got {name!r}, expected one of {expected}, or the name of a module"
    )


@cache
def _files() -> tuple[tuple[Figure, Path], ...]:
    declarations = ((_declaration(path), path) for path in sorted(PLOTS.glob("*.py")))
    return tuple((figure, path) for figure, path in declarations if figure is not None)


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
