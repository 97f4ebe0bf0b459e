"""The request of a figure, the runs that it selects, and the series that they have stored."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import TypeVar

import numpy as np
import pandas as pd

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.comparability import differing, of_runs, require_few, with_conditions
from seatrial.runner.compare.frame import (
    FINISHED,
    NO_LEVELS,
    Queries,
    StoredDiagnostic,
    StoredRun,
    codes,
    ordered,
    stored_runs,
)
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.terminal import visible
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOF_ORDER, NOT_STARTED

Drawing = TypeVar("Drawing")
Choice = Callable[[Queries, Sequence[StoredRun], Condition], StoredRun]
Voyages = Mapping[str, Series]  # deployments by model, or the recording
PREFIX = "deployment_"
DEPLOYMENTS = (f"{PREFIX}nominal", f"{PREFIX}identified")
LONGEST_STEM = 150  # characters of a file name; file systems take 255 bytes


@dataclass(frozen=True)
class PlotRequest:
    """Options of a figure; each kind uses some of them. Empty `dofs` mean all."""

    run: int | None = None
    metric: str = "force_mse"
    rows: str = ""  # empty: the default of the kind
    columns: str = "disturbance"
    dofs: Sequence[str] = ()
    model: str = "identified"
    facet: str | None = None
    band: float | None = None  # [%] level of the bands about a prediction
    log: bool | None = None  # None: by the range of the values
    where: str | None = None
    sweep: str | None = None  # a number, a name or `all`; by default the newest one
    tag: str | None = None  # only sweeps with it
    pool: Sequence[str] = ()  # factors that a group may average over

    def shown(self, has: Callable[[str], bool]) -> list[str]:
        """Return the requested degrees of freedom for which `has` is true, in reading order."""
        return [dof for dof in DOF_ORDER if (not self.dofs or dof in self.dofs) and has(dof)]

    def condition(self, results: Queries) -> Condition:
        """Return the condition that its runs meet."""
        if self.run is None:
            return results.selected(self.where, self.sweep, self.tag)[0]
        return replace(results.where(self.where), run=self.run)

    def trials(self, results: Queries, factors: Sequence[str], planned: bool) -> pd.DataFrame:
        """Return its trials with their levels of the factors, as matplotlib can draw them."""
        for factor in factors:
            results.names.check(factor, "--rows/--columns/--facet")
        attempts = self.run is not None  # the run asked for may be one that was repeated
        return _drawable(results.trials(self.condition(results), factors, attempts, planned))


@dataclass(frozen=True)
class Facet:
    """The runs of one figure, and its label."""

    trials: pd.DataFrame  # see `frame`; also those that were planned and not started
    condition: Condition
    label: str = ""  # "vessel = milliampere", empty if there is one figure
    run: int | None = None  # the requested run

    @cached_property
    def runs(self) -> Sequence[StoredRun]:
        """The runs as objects, without the trials that were not started."""
        return stored_runs(self.trials[self.trials["status"] != NOT_STARTED])

    def title(self, text: str) -> str:
        """Return the title of the figure with the vessel and the facet."""
        parts = [self.label] if self.label else []
        parts += [f"run {self.run}"] if self.run is not None else []
        vessels = {run.levels["vessel"] for run in self.runs if run.status == FINISHED}
        if len(vessels) == 1 and "vessel = " not in self.label:
            text = f"{text}, {vessels.pop()}"
        return f"{text} ({', '.join(parts)})" if parts else text

    def file(self, name: str) -> str:
        """Return a safe file name: no path separators or special characters."""
        stem = f"{name}-{self.label.replace(' = ', '-')}" if self.label else name
        stem += f"-run-{self.run}" if self.run is not None else ""
        safe = re.sub(r"[^\w.\-]+", "_", stem, flags=re.ASCII).strip("._") or "figure"
        if len(safe) <= LONGEST_STEM:
            return safe
        return f"{safe[:LONGEST_STEM]}-{sha256(stem.encode()).hexdigest()[:12]}"


def _drawable(trials: pd.DataFrame) -> pd.DataFrame:
    """Return trials whose levels matplotlib draws as text, not as formulas between $.

    A level that is long or has control characters ends with a part of its digest, so that levels
    stay distinct.
    """
    names = [name for name in trials if name not in ("status", *NO_LEVELS)]
    return trials.assign(**{name: trials[name].cat.rename_categories(_label) for name in names})


def _label(level: str) -> str:
    if len(level) > LONGEST_STEM or visible(level) != level:
        level = f"{visible(level)[:60]}… {sha256(level.encode()).hexdigest()[:8]}"
    return level.replace("$", r"\$")


def facets(
    results: Queries,
    request: PlotRequest,
    rows: Sequence[str] | None = None,
    averages: bool = False,
) -> list[Facet]:
    """Return the runs of each figure; raises ConfigurationError if no run matches.

    `rows` are the factors of a figure with several row factors. A figure that `averages` over runs
    is drawn once for each level of what the runs of a group differ in, and for each vessel.
    """
    own = [*(rows or [request.rows]), request.columns]
    names = [] if request.facet is None else [request.facet]
    trials = request.trials(results, [*own, *names], planned=True)
    if averages and "all" not in request.pool:
        split = _unlike(results, trials, [*own, *names], request)
        if trials["vessel"].nunique() > 1 and "vessel" not in (*own, *names, *split, *request.pool):
            split.append("vessel")
        names += split
        trials = request.trials(results, [*own, *names], planned=True) if split else trials
    condition = request.condition(results)
    if not names:
        return [Facet(trials, condition, run=request.run)]
    parts = dict(iter(trials.groupby(names, observed=True)))
    ranks = [ordered(levels) for levels in zip(*parts, strict=True)]
    return [
        Facet(
            parts[key], condition,
            ", ".join(f"{name} = {level}" for name, level in zip(names, key, strict=True)),
            request.run,
        )
        for key in sorted(parts, key=lambda key: list(map(list.index, ranks, key)))
    ]  # fmt: skip


def _unlike(
    results: Queries, trials: pd.DataFrame, factors: Sequence[str], request: PlotRequest
) -> list[str]:
    """Return what the runs of one group of a figure differ in, apart from the seed."""
    stages = definition_of(request.metric).stages
    stage = "deployment" if "deployment" in stages else "validation"
    frame, facts = with_conditions(results, trials, of_runs(trials, stage, request.model))
    groups = codes(frame, list(dict.fromkeys(factors)))
    split = differing(facts, groups, frame["condition"], request.pool)
    require_few(split, "the groups of this figure")
    return split


def each_facet(
    results: Queries,
    request: PlotRequest,
    draw: Callable[[Facet], Drawing | None],
    missing: str,
    averages: bool = False,
) -> list[Drawing]:
    """Return the drawing of each facet that `draw` does not leave out by None.

    Raises ConfigurationError with the message `missing` if it leaves out all of them.
    """
    parts = facets(results, request, averages=averages)
    drawings = [drawing for facet in parts if (drawing := draw(facet))]
    if not drawings:
        raise ConfigurationError(missing)
    return drawings


def diagnostics_of(
    results: Queries, run: StoredRun, names: Sequence[str]
) -> Sequence[StoredDiagnostic]:
    """Return the diagnostics of one run with these names."""
    return results.diagnostics([run], names, Condition(run=run.id))[run.id]


def each_run(
    results: Queries,
    request: PlotRequest,
    kinds: Sequence[str],
    typical: Choice = lambda results, runs, condition: runs[-1],  # the newest
) -> list[tuple[StoredRun, dict[str, Series]]]:
    """Return the runs of figures over time, and those of the series `kinds` that each run has.

    The run is the requested one, else the newest finished run that meets --where and has such a
    series; with --facet it is the newest run of each level. `typical` may choose another one of
    these runs, which are ordered by age.
    """
    condition, facet = request.condition(results), request.facet
    stored = results.series_columns(condition)
    candidates: dict[str, list[StoredRun]] = defaultdict(list)
    for run in stored_runs(request.trials(results, [facet] if facet else [], planned=False)):
        has = any(kind in stored.get(run.id, ()) for kind in kinds)
        if has and (request.run is not None or run.status == FINISHED):
            candidates[run.levels[facet] if facet is not None else ""].append(run)
    if not candidates:
        subject = "no finished run that matches has a" if request.run is None else (
            f"run {request.run} has no")  # fmt: skip
        raise ConfigurationError(f"plot: {subject} series {' or '.join(kinds)}")
    chosen = [typical(results, candidates[level], condition) for level in ordered(candidates)]
    read = results.reader.series
    return [(run, {k: read(run.id, k) for k in kinds if k in stored[run.id]}) for run in chosen]


def subtitle(run: StoredRun) -> str:
    """Return `run 17: milliampere, noise, plsr, seed 3`."""
    names = ("vessel", "disturbance", "identifier")
    levels = ", ".join(run.levels[name] for name in names)
    return f"run {run.id}: {levels}, seed {run.levels['seed']}"


def in_plane(run: StoredRun, what: str, series_of: Voyages) -> Voyages:
    """Return the voyages of a run; raises ConfigurationError if one has no track in the plane."""
    for series in series_of.values():
        missing = [name for name in ("t", "x", "y") if name not in series.columns]
        if missing:
            raise ConfigurationError(
                f"{what}: run {run.id} has no {missing[0]} in its series {series.kind}; it needs a"
                " vessel that moves in the plane"
            )
    return series_of


def distinct(
    results: Queries, run: StoredRun, series_of: Mapping[str, Series]
) -> tuple[Voyages, list[str]]:
    """Return the deployments of a run by model, and notes on the models that are not among them.

    The deployment of the identified model is left out if it is that of the nominal one, as it is
    without identification. Of a model that was not deployed the note says why.
    """
    voyages = {kind.removeprefix(PREFIX): series for kind, series in series_of.items()}
    nominal, identified = voyages.get("nominal"), voyages.get("identified")
    if nominal is None and identified is None:
        return voyages, []
    if nominal is not None and identified is not None and _equal(nominal, identified):
        del voyages["identified"]
        return voyages, ["the identified model sails the same track"]
    reason = results.reader.run(run.id).note
    absent = [model for model in ("nominal", "identified") if model not in voyages]
    return voyages, [reason or f"the {model} model did not sail" for model in absent]


def _equal(first: Series, second: Series) -> bool:
    return first.columns.keys() == second.columns.keys() and all(
        np.array_equal(first.columns[name], second.columns[name], equal_nan=True)
        for name in first.columns
    )
