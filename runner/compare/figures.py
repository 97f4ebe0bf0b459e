"""What a figure declares of itself, and how figures are found.

A file of the folder `plots` with `FIGURE = Figure(...)` and `drawings(results, request)` is a
figure; no list names it. The arguments are literals, which are read without importing the file:
the command line shows them, and matplotlib is slow to import. A figure from elsewhere is any
module with the same two names; it is asked for by its module name.
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


@dataclass(frozen=True)
class Figure:
    """A kind of figure.

    `needs` is what runs must have stored. `rows` is the factor of its rows unless --rows is given.
    A report has it under `caption`, at `place` among the others, once for every level of `each`;
    without a caption it is in no report.
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
    """The figures of the folder `plots` by name, in alphabetical order."""
    return {figure.name: figure for figure, _ in sorted(_files(), key=lambda one: one[0].name)}


def figure_of(name: str) -> Figure:
    """The declaration of a figure; ConfigurationError where there is none of this name."""
    figure = figures().get(name)
    if figure is not None:
        return figure
    figure = vars(import_module(_module(name))).get("FIGURE")
    if not isinstance(figure, Figure):
        raise ConfigurationError(f"plot: {name} has no FIGURE = Figure(...)")
    return figure


def drawings_of(name: str) -> "Drawings":
    """The function that draws a figure; ConfigurationError where there is none of this name."""
    drawings: Drawings | None = vars(import_module(_module(name))).get("drawings")
    if drawings is None:
        raise ConfigurationError(f"plot: {name} has no function drawings(results, request)")
    return drawings


def _module(name: str) -> str:
    """The module of a figure, by its name or by that of a module from elsewhere."""
    for figure, path in _files():
        if figure.name == name:
            return f"{__package__}.plots.{path.stem}"
    try:
        return import_module(name).__name__
    except ModuleNotFoundError as error:
        if not f"{name}.".startswith(f"{error.name}."):
            raise  # of what the module itself imports
    expected = ", ".join(figures())
    raise ConfigurationError(
        f"plot: got {name!r}, expected one of {expected}, or the name of a module"
    )


@cache
def _files() -> tuple[tuple[Figure, Path], ...]:
    found = ((_declaration(path), path) for path in sorted(PLOTS.glob("*.py")))
    return tuple((figure, path) for figure, path in found if figure is not None)


def _declaration(path: Path) -> Figure | None:
    text = path.read_text(encoding="utf-8")
    if "\nFIGURE = " not in text:
        return None
    for node in ast.parse(text).body:
        match node:
            case ast.Assign(targets=[ast.Name("FIGURE")], value=ast.Call() as call):
                options = {one.arg or "": ast.literal_eval(one.value) for one in call.keywords}
                return Figure(*map(ast.literal_eval, call.args), **options)
    return None
