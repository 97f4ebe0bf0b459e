"""The declaration of a figure, the options of the command `plot`, and the search for figures.

Each file of the folder `plots` with `FIGURE = Figure(...)` and `drawings(results, request)` is a
figure; there is no other list of figures. The declaration says which options of `plot` the figure
takes. Files of plug-ins are searched for figures too (configuration/plugins.py).
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.configuration.plugins import attributed, is_own, plugins
from seatrial.runner.record.vocabulary import DOF_ORDER

if TYPE_CHECKING:
    from seatrial.runner.compare.frame import Queries
    from seatrial.runner.compare.plots.style import Drawing

PLOTS = Path(__file__).with_name("plots")
DECLARES = "\nFIGURE = "  # in the file of a figure
log = logging.getLogger(__name__)
Several = list[str] | None
OPTIONS = (*("run", "metric", "rows", "columns", "dof", "model"), *("facet", "band", "log", "pool"))


@dataclass(frozen=True)
class PlotRequest:
    """The options of the command `plot`; each kind of figure takes some of them."""

    kind: str
    run: int | None = None
    metric: str = "force_mse"
    rows: str = ""  # empty: the default of the kind
    columns: str = ""
    dof: Several = None  # None: all
    model: str = "identified"
    facet: str | None = None
    band: float | None = None  # [%] level of the bands about a prediction
    log: bool | None = None  # None: by the range of the values
    width: str | None = None
    where: str | None = None
    sweep: str | None = None  # a number, a name, a tag or `all`; by default the newest one
    pool: Several = None  # factors that a group may average over
    output: Path | None = None

    def shown(self, has: Callable[[str], bool], lacking: str = "") -> list[str]:
        """Return the requested degrees of freedom for which `has` is true, in reading order.

        Raises ConfigurationError with the message `lacking`, if it is given, where there are none.
        """
        dofs = [dof for dof in DOF_ORDER if (not self.dof or dof in self.dof) and has(dof)]
        if lacking and not dofs:
            raise ConfigurationError(f"plot {self.kind}: {lacking} of these degrees of freedom")
        return dofs

    def check(self) -> None:
        """Raise ConfigurationError for an unknown kind, and for an option that it does not take."""
        options, untouched = _module(self.kind).FIGURE.options, PlotRequest(self.kind)
        for name in OPTIONS:
            if getattr(self, name) != getattr(untouched, name) and name not in options:
                taken = ", ".join(f"--{option}" for option in options) or "those of runs alone"
                where = f"plot {self.kind}: --{name}: not an option of this figure"
                raise ConfigurationError(f"{where}, expected {taken}")


def split(texts: Sequence[str] | None) -> tuple[str, ...]:
    """Return the distinct values of a repeated or comma-separated option, without empty ones."""
    parts = (part.strip() for text in texts or () for part in text.split(","))
    return tuple(dict.fromkeys(part for part in parts if part))


def axes_of(rows: str | None, columns: str | None) -> tuple[str, str]:
    """Return the factors of rows and columns; the defaults are identifier and disturbance.

    If one option already uses the default of the other, the defaults are exchanged.
    """
    if rows is None:
        rows = "disturbance" if "identifier" in split([columns or ""]) else "identifier"
    if columns is None:
        columns = next((n for n in ("disturbance", "identifier") if n not in split([rows])), "none")
    return rows, columns


@dataclass(frozen=True)
class Figure:
    """A kind of figure.

    `needs` is the data that runs must have stored. `options` are those of the command `plot` that
    the figure takes, beside those that select runs and files; `rows` is the default of --rows. A
    report shows it at position `place`, 0 for not at all, with `help` as its caption, for each of
    `report_rows`, and if it takes --metric for each of the main metrics.
    """

    name: str
    help: str
    needs: str
    options: Sequence[str] = OPTIONS
    rows: str = ""
    place: int = 0
    report_rows: Sequence[str] = ()


def figures() -> dict[str, Figure]:
    """Return the figures of the folder `plots` and of plug-ins by name, in alphabetical order."""
    return {name: module.FIGURE for name, module in sorted(_modules().items())}


def drawings(results: "Queries", request: PlotRequest) -> "list[Drawing]":
    """Draw the figures of a request; raises ConfigurationError for an unknown kind."""
    module = _module(request.kind)
    rows, columns = axes_of(request.rows or module.FIGURE.rows or None, request.columns or None)
    with attributed({"_target_": f"{module.__name__}.drawings"}):
        made: list[Drawing] = module.drawings(results, replace(request, rows=rows, columns=columns))
    return made


def _module(name: str) -> ModuleType:
    """Return the module of a figure."""
    known = _modules()
    if name not in known:
        raise ConfigurationError(
            f"plot: got {name!r}, {meant(name, known)}expected one of {', '.join(sorted(known))}"
        )
    return known[name]


@cache
def _modules() -> dict[str, ModuleType]:
    """The modules of the figures by name; of two figures of one name the first counts."""
    files = {f"{__package__}.plots.{path.stem}": path for path in sorted(PLOTS.glob("*.py"))}
    for plugin in plugins():
        files |= plugin.files
    modules: dict[str, ModuleType] = {}
    for name in (n for n, path in files.items() if DECLARES in path.read_text("utf-8", "replace")):
        try:
            module = import_module(name)
            figure = module.FIGURE
            if not isinstance(figure, Figure):
                raise TypeError(f"FIGURE is a {type(figure).__name__}, expected a Figure")
        except Exception as error:
            if is_own(name):
                raise
            log.warning("%s is no figure: %s", name, " ".join(str(error).split()))
            continue
        first = modules.setdefault(figure.name, module)
        if first is not module:
            log.warning("figure %s of %s is not used: %s has it", figure.name, name, first.__name__)
    return modules
