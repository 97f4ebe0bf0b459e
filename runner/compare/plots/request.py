"""The request of a figure, and the selection of its runs.

The sailed missions of one run, for the figures of deployments.
"""

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
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.terminal import visible
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.rows import Series
from seatrial.runner.vocabulary import DOF_ORDER

Drawing = TypeVar("Drawing")
LONGEST_STEM = 150  # characters of a file name; file systems take 255 bytes


@dataclass(frozen=True)
class PlotRequest:
    """Options of a figure; each kind uses some of them. Empty `dofs` mean all."""

    run: int | None = None
    metric: str = "force_mse"
    rows: str = "identifier"
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


@dataclass(frozen=True)
class Facet:
    """The runs of one figure, and its label."""

    trials: pd.DataFrame  # see `frame`
    condition: Condition
    label: str = ""  # "vessel = milliampere", empty if there is one figure
    run: int | None = None  # the requested run

    @cached_property
    def runs(self) -> Sequence[StoredRun]:
        """The runs as objects."""
        return stored_runs(self.trials)

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
    names = [name for name in trials if name not in NO_LEVELS]
    drawable = {name: trials[name].cat.rename_categories(_label) for name in names}
    return trials.assign(**drawable)


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
    condition, _ = results.selected(request.where, request.sweep, request.tag)
    if request.run is not None:
        condition = with_run(results.where(request.where), request.run)
    factors = [*(rows or [request.rows]), request.columns]
    factors += [request.facet] if request.facet is not None else []
    for factor in factors:
        results.names.check(factor, "--rows/--columns/--facet")
    trials = _drawable(results.trials(condition, factors))
    split = []
    if averages and "all" not in request.pool:
        split = _unlike(results, trials, factors, request)
        if "vessel" not in (*factors, *split, *request.pool):
            split += ["vessel"] if trials["vessel"].nunique() > 1 else []
    names = [*([] if request.facet is None else [request.facet]), *split]
    if split:
        trials = _drawable(results.trials(condition, [*factors, *split]))
    if not names:
        return [Facet(trials, condition, "", request.run)]
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


def newest_with(
    results: Queries, facet: Facet, names: Sequence[str]
) -> tuple[StoredRun, Sequence[StoredDiagnostic]] | None:
    """Return the newest run with the diagnostic `names[0]` and its diagnostics of these names.

    The result is None if no run of the facet has it.
    """
    diagnostics = results.diagnostics(facet.runs, names, facet.condition)
    for run in reversed(facet.runs):
        if any(row.name == names[0] for row in diagnostics[run.id]):
            return run, diagnostics[run.id]
    return None


def with_run(condition: Condition, run: int) -> Condition:
    """Restrict the condition to one run."""
    return replace(condition, run=run)


Choice = Callable[[Queries, Sequence[StoredRun], Condition], StoredRun]


def each_run(
    results: Queries,
    request: PlotRequest,
    kinds: Sequence[str],
    column: str | None = None,
    typical: Choice = lambda results, runs, condition: runs[-1],  # the newest
) -> list[tuple[StoredRun, list[str]]]:
    """Return the runs of figures over time, and which of the series `kinds` each run has.

    The run is the requested one, else the newest finished run that meets --where and has such a
    series (with the given column); with --facet it is the newest run of each level. `typical` may
    choose another one of these runs, which are ordered by age.
    """
    condition, _ = results.selected(request.where, request.sweep, request.tag)
    if request.run is not None:
        condition = with_run(results.where(request.where), request.run)
    facet = request.facet
    if facet is not None:
        results.names.check(facet, "--rows/--columns/--facet")
    factors = [] if facet is None else [facet]
    superseded = request.run is not None
    runs = stored_runs(_drawable(results.trials(condition, factors, superseded)))
    stored = results.series_columns(condition)
    candidates: dict[str, list[tuple[StoredRun, list[str]]]] = defaultdict(list)
    for run in runs:
        available = {k: stored[run.id][k] for k in kinds if k in stored.get(run.id, ())}
        available = {
            kind: names for kind, names in available.items() if column is None or column in names
        }
        if available and (request.run is not None or run.status == FINISHED):
            level = run.levels[facet] if facet is not None else ""
            candidates[level].append((run, list(available)))
    if not candidates:
        subject = f"run {request.run}" if request.run is not None else "no finished run"
        verb = "has no" if request.run is not None else "that matches has a"
        suffix = f" with {column}" if column else ""
        raise ConfigurationError(f"plot: {subject} {verb} series {' or '.join(kinds)}{suffix}")
    chosen = []
    for level in ordered(candidates):
        has = {run.id: names for run, names in candidates[level]}
        run = typical(results, [run for run, _ in candidates[level]], condition)
        chosen.append((run, has[run.id]))
    return chosen


def subtitle(run: StoredRun) -> str:
    """Return `run 17: milliampere, noise, plsr, seed 3`."""
    names = ("vessel", "disturbance", "identifier")
    levels = ", ".join(run.levels[name] for name in names)
    return f"run {run.id}: {levels}, seed {run.levels['seed']}"


PREFIX = "deployment_"
KINDS = ("deployment_nominal", "deployment_identified")
Voyages = Mapping[str, Series]


def voyages(
    results: Queries, request: PlotRequest, what: str, instead: str | None = None
) -> list[tuple[StoredRun, Voyages]]:
    """Return the runs, one for each figure, and their sailed missions by model.

    A run without a deployment uses the series `instead`. `what` names the figure in the error
    message. Of two equal voyages it is the first. Raises ConfigurationError if there is no such
    series or no motion in the plane.
    """
    kinds = KINDS if instead is None else (*KINDS, instead)
    return [
        (
            run,
            distinct(
                _planar_series(results, run, what, [k for k in stored if k in KINDS] or stored)
            ),
        )
        for run, stored in each_run(results, request, kinds)
    ]


def of_identified(results: Queries, run: StoredRun, missions: Voyages) -> list[str]:
    """Say why only the nominal model is drawn: the identified one sails alike, or did not sail."""
    if list(missions) != ["nominal"]:
        return []
    if any(file.kind == f"{PREFIX}identified" for file in results.reader.series_files(run.id)):
        return ["the identified model sails the same track"]
    return [results.reader.run(run.id).note or "the identified model did not sail"]


def distinct(series_of: Voyages) -> Voyages:
    """Leave out the voyage of the identified model if it is that of the nominal one.

    So it is without identification, and if nothing is taken from the model.
    """
    pair = [series_of.get(name) for name in ("nominal", "identified")]
    if pair[0] is None or pair[1] is None or not _equal(pair[0], pair[1]):
        return series_of
    return {"nominal": pair[0]}


def _equal(first: Series, second: Series) -> bool:
    return first.columns.keys() == second.columns.keys() and all(
        np.array_equal(first.columns[name], second.columns[name], equal_nan=True)
        for name in first.columns
    )


def _planar_series(results: Queries, run: StoredRun, what: str, kinds: Sequence[str]) -> Voyages:
    series_of = {kind.removeprefix(PREFIX): results.reader.series(run.id, kind) for kind in kinds}
    for kind, series in zip(kinds, series_of.values(), strict=True):
        missing = [name for name in ("t", "x", "y") if name not in series.columns]
        if missing:
            raise ConfigurationError(
                f"{what}: run {run.id} has no {missing[0]} in its series"
                f" {kind}; it needs a vessel that moves in the plane"
            )
    return series_of


def degrees(values: Sample) -> Sample:
    """Convert radians to degrees."""
    return np.asarray(np.degrees(values), dtype=np.float64)
