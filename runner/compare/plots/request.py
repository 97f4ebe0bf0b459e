"""What a figure is asked for, and the runs that go into it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.results import FINISHED, Results, Run, ordered
from seatrial.runner.compare.where import Condition


@dataclass(frozen=True)
class PlotRequest:
    """Options of a figure; each kind uses those that concern it. Empty `dofs` mean all."""

    run: int | None = None
    metric: str = "force_mse"
    rows: str = "identifier"
    columns: str = "disturbance"
    dofs: Sequence[str] = ()
    model: str = "identified"
    facet: str | None = None
    log: bool | None = None  # None lets the figures decide
    where: str | None = None


@dataclass(frozen=True)
class Facet:
    """The runs of one figure, and what tells it from the others."""

    runs: Sequence[Run]
    condition: Condition | None
    label: str = ""  # "vessel = milliampere", empty without --facet
    run: int | None = None  # the one run asked for

    def title(self, text: str) -> str:
        """The figure's title with the facet in it."""
        about = [self.label] if self.label else []
        about += [f"run {self.run}"] if self.run is not None else []
        return f"{text} ({', '.join(about)})" if about else text

    def file(self, name: str) -> str:
        """A file name without anything that could lead elsewhere."""
        whole = f"{name}-{self.label.replace(' = ', '-')}" if self.label else name
        whole += f"-run-{self.run}" if self.run is not None else ""
        return re.sub(r"[^\w.\-]+", "_", whole, flags=re.ASCII).strip("._") or "figure"


def facets(
    results: Results, request: PlotRequest, rows: Sequence[str] | None = None
) -> list[Facet]:
    """The runs of each figure; raises ConfigurationError where none match.

    `rows` are the factors of a kind that takes several.
    """
    condition = results.where(request.where)
    if request.run is not None:
        condition = with_run(condition, request.run)
    factors = [*(rows or [request.rows]), request.columns]
    factors += [request.facet] if request.facet else []
    for factor in factors:
        results.names.check(factor, "--rows/--columns/--facet")
    runs = results.runs(condition, factors)
    if request.facet is None:
        return [Facet(runs, condition, run=request.run)]
    return [
        Facet(
            [run for run in runs if run.levels[request.facet] == level],
            condition,
            f"{request.facet} = {level}",
            request.run,
        )
        for level in ordered(run.levels[request.facet] for run in runs)
    ]


def with_run(condition: Condition | None, run: int) -> Condition:
    """The condition, and that it be this run."""
    from seatrial.runner.compare.where import Comparison, Joined

    one = Comparison("id", "=", run)
    return one if condition is None else Joined("and", (condition, one))


def each_run(
    results: Results, request: PlotRequest, kinds: Sequence[str], column: str | None = None
) -> list[tuple[Run, list[str]]]:
    """The runs of figures over time, one a figure, and which of the series `kinds` each has.

    It is the run asked for, else the newest finished one that meets --where and has such a series
    (with the given column); with --facet the newest of each level.
    """
    condition = results.where(request.where)
    if request.run is not None:
        condition = with_run(condition, request.run)
    facet = request.facet
    if facet is not None:
        results.names.check(facet, "--rows/--columns/--facet")
    factors = [] if facet is None else [facet]
    runs = results.runs(condition, factors, superseded=request.run is not None)
    stored = results.series_columns(condition)
    found: dict[str, tuple[Run, list[str]]] = {}
    for run in reversed(runs):
        have = {k: stored[run.id][k] for k in kinds if k in stored.get(run.id, ())}
        have = {kind: names for kind, names in have.items() if column is None or column in names}
        if have and (request.run is not None or run.status == FINISHED):
            found.setdefault(run.levels[facet] if facet is not None else "", (run, list(have)))
    if not found:
        which = f"run {request.run}" if request.run is not None else "no finished run"
        verb = "has no" if request.run is not None else "that matches has a"
        about = f" with {column}" if column else ""
        raise ConfigurationError(f"plot: {which} {verb} series {' or '.join(kinds)}{about}")
    return [found[level] for level in ordered(found)]


def subtitle(run: Run) -> str:
    """`run 17: milliampere, noise, plsr, seed 3`."""
    names = ("vessel", "disturbance", "identifier")
    told = ", ".join(run.levels[name] for name in names)
    return f"run {run.id}: {told}, seed {run.levels['seed']}"
