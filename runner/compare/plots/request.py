"""The request of a figure, the runs that it selects, and the series that they have stored."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
import pandas as pd

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.comparability import differing, of_runs, require_few, with_conditions
from seatrial.runner.compare.frame import (
    FINISHED,
    NO_LEVELS,
    Queries,
    StoredRun,
    codes,
    ordered,
    stored_runs,
)
from seatrial.runner.compare.plots.style import Drawing
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.terminal import visible
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOF_ORDER, NOT_STARTED

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
    sweep: str | None = None  # a number, a name, a tag or `all`; by default the newest one
    pool: Sequence[str] = ()  # factors that a group may average over

    def shown(self, has: Callable[[str], bool]) -> list[str]:
        """Return the requested degrees of freedom for which `has` is true, in reading order."""
        return [dof for dof in DOF_ORDER if (not self.dofs or dof in self.dofs) and has(dof)]

    def condition(self, results: Queries) -> Condition:
        """Return the condition that its runs meet."""
        if self.run is None:
            return results.selected(self.where, self.sweep)[0]
        return replace(results.where(self.where), run=self.run)

    def trials(self, results: Queries, factors: Sequence[str], planned: bool) -> pd.DataFrame:
        """Return its trials with their levels of the factors, as matplotlib can draw them.

        A factor may be several, comma-separated, whose levels are joined.
        """
        parts = {factor: parts_of(factor) for factor in factors}
        names = list(dict.fromkeys(name for own in parts.values() for name in own))
        for name in names:
            results.names.check(name, "--rows/--columns/--facet")
        attempts = self.run is not None  # the run asked for may be one that was repeated
        trials = results.trials(self.condition(results), names, attempts, planned)
        levels = [name for name in trials if name not in ("status", *NO_LEVELS)]
        trials = trials.assign(**{n: trials[n].cat.rename_categories(_drawable) for n in levels})
        for factor, own in parts.items():
            if len(own) > 1:
                trials[factor] = trials[own].astype(str).agg(", ".join, axis=1).astype("category")
        return trials


def parts_of(factor: str) -> list[str]:
    """Return the names of a factor of several, comma-separated."""
    return [name.strip() for name in factor.split(",")]


def _drawable(level: str) -> str:
    """Return a level as text, not as a formula between $.

    One that is long or has control characters ends with a part of its digest: it stays distinct.
    """
    if len(level) > LONGEST_STEM or visible(level) != level:
        level = f"{visible(level)[:60]}… {sha256(level.encode()).hexdigest()[:8]}"
    return level.replace("$", r"\$")


@dataclass(frozen=True)
class Facet:
    """The runs of one figure, and its label."""

    trials: pd.DataFrame  # see `frame`; also those that were planned and not started
    condition: Condition
    label: str = ""  # "vessel = milliampere", empty if there is one figure
    run: int | None = None  # the requested run

    @property
    def runs(self) -> Sequence[StoredRun]:
        """The runs as objects, without the trials that were not started."""
        return stored_runs(self.trials[self.trials["status"] != NOT_STARTED])

    def diagnostics(self, results: Queries, names: Sequence[str]) -> pd.DataFrame:
        """Return the named diagnostics of the runs with the levels of their trials."""
        rows = results.diagnostics(names, self.condition)
        return rows.join(self.trials, on="run", how="inner")

    def title(self, text: str) -> str:
        """Return the title of the figure with the vessel and the facet."""
        parts = [self.label] if self.label else []
        parts += [f"run {self.run}"] if self.run is not None else []
        vessels = self.trials.loc[self.trials["status"] == FINISHED, "vessel"].unique()
        if len(vessels) == 1 and "vessel = " not in self.label:
            text = f"{text}, {vessels[0]}"
        return f"{text} ({', '.join(parts)})" if parts else text

    def file(self, name: str) -> str:
        """Return a safe file name: no path separators or special characters."""
        stem = f"{name}-{self.label.replace(' = ', '-')}" if self.label else name
        stem += f"-run-{self.run}" if self.run is not None else ""
        safe = re.sub(r"[^\w.\-]+", "_", stem, flags=re.ASCII).strip("._") or "figure"
        if len(safe) <= LONGEST_STEM:
            return safe
        return f"{safe[:LONGEST_STEM]}-{sha256(stem.encode()).hexdigest()[:12]}"


def each_facet(
    results: Queries,
    request: PlotRequest,
    draw: Callable[[Facet], Drawing | None],
    missing: str,
    averages: bool = False,
) -> list[Drawing]:
    """Return the drawing of each facet that `draw` does not leave out by None.

    A figure that `averages` over runs is drawn once for each level of what the runs of a group
    differ in, and for each vessel.

    Raises ConfigurationError if no run matches, and with the message `missing` if `draw` leaves out
    all facets.
    """
    own, names = [request.rows, request.columns], [request.facet] if request.facet else []
    trials = request.trials(results, [*own, *names], planned=True)
    if averages and "all" not in request.pool:
        stages = definition_of(request.metric).stages
        stage = "deployment" if "deployment" in stages else "validation"
        frame, facts = with_conditions(results, trials, of_runs(trials, stage, request.model))
        groups = codes(frame, list(dict.fromkeys([*own, *names])))
        split = differing(facts, groups, frame["condition"], request.pool)
        require_few(split, "the groups of this figure")
        named = {*parts_of(",".join(own)), *names, *split, *request.pool}
        if trials["vessel"].nunique() > 1 and "vessel" not in named:
            split.append("vessel")
        names += split
        trials = request.trials(results, [*own, *names], planned=True) if split else trials
    condition = request.condition(results)
    parts = dict(iter(trials.groupby(names, observed=True))) if names else {(): trials}
    ranks = [ordered(levels) for levels in zip(*parts, strict=True)]
    drawings = []
    for key in sorted(parts, key=lambda key: list(map(list.index, ranks, key))):
        label = ", ".join(f"{name} = {level}" for name, level in zip(names, key, strict=True))
        drawing = draw(Facet(parts[key], condition, label, request.run))
        drawings += [] if drawing is None else [drawing]
    if not drawings:
        raise ConfigurationError(missing)
    return drawings


def each_run(
    results: Queries,
    request: PlotRequest,
    kinds: Sequence[str],
    typical: Callable[[Queries, Sequence[StoredRun], Condition], StoredRun] | None = None,
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
        subject = "no finished run that matches has a"
        subject = subject if request.run is None else f"run {request.run} has no"
        raise ConfigurationError(f"plot: {subject} series {' or '.join(kinds)}")
    of_levels = [candidates[level] for level in ordered(candidates)]
    chosen = [typical(results, runs, condition) if typical else runs[-1] for runs in of_levels]
    read = results.reader.series
    return [(run, {k: read(run.id, k) for k in kinds if k in stored[run.id]}) for run in chosen]


def subtitle(run: StoredRun) -> str:
    """Return `run 17: milliampere, noise, plsr, seed 3`."""
    levels = ", ".join(run.levels[name] for name in ("vessel", "disturbance", "identifier"))
    return f"run {run.id}: {levels}, seed {run.levels['seed']}"


def in_plane(
    run: StoredRun, what: str, series_of: Voyages, names: Sequence[str] = ("t", "x", "y")
) -> None:
    """Raise ConfigurationError if a voyage of a run has no track in the plane."""
    for series in series_of.values():
        missing = [name for name in names if name not in series.columns]
        if missing:
            raise ConfigurationError(
                f"{what}: run {run.id} has no {missing[0]} in its series {series.kind}; it needs a"
                " vessel that moves in the plane"
            )


def distinct(
    results: Queries, run: StoredRun, series_of: Mapping[str, Series]
) -> tuple[Voyages, list[str]]:
    """Return the deployments of a run by model, and notes on the models that are not among them.

    The deployment of the identified model is left out if it is that of the nominal one, as it is
    without identification. Of a model that was not deployed the note says why.
    """
    voyages = {kind.removeprefix(PREFIX): series for kind, series in series_of.items()}
    models = ("nominal", "identified")
    absent = [model for model in models if model not in voyages]
    if len(absent) == len(models):
        return voyages, []
    if absent:
        reason = results.reader.run(run.id).note
        return voyages, [reason or f"the {model} model did not sail" for model in absent]
    first, second = (voyages[model].columns for model in models)
    if first.keys() == second.keys() and all(
        np.array_equal(first[name], second[name], equal_nan=True) for name in first
    ):
        del voyages["identified"]
        return voyages, ["the identified model sails the same track"]
    return voyages, []


def diagnostics_of(results: Queries, run: StoredRun, names: Sequence[str]) -> pd.DataFrame:
    """Return the diagnostics of one run with these names."""
    return results.diagnostics(names, Condition(run=run.id))
