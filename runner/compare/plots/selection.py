"""The request of a figure, the runs that it selects, and the series that they have stored."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import pandas as pd

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare import frame as frames
from seatrial.runner.compare.comparability import differing, of_runs, require_few, with_conditions
from seatrial.runner.compare.figures import PlotRequest, figures, split
from seatrial.runner.compare.plots.style import Drawing
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.terminal import visible
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import NOT_STARTED

Voyages = Mapping[str, Series]  # deployments by model, or the recording
PREFIX = "deployment_"
DEPLOYMENTS = (f"{PREFIX}nominal", f"{PREFIX}identified")
LONGEST = 60  # characters of a level or the name of a file; file systems take 255 bytes


def condition_of(results: frames.Queries, request: PlotRequest) -> Condition:
    """Return the condition that the runs of a request meet."""
    if request.run is None:
        return results.selected(request.where, request.sweep)[0]
    condition = results.where(request.where)
    met = condition.runs is None or request.run in condition.runs
    return replace(condition, runs=(request.run,) if met else ())


def trials_of(
    results: frames.Queries, request: PlotRequest, factors: Sequence[str] = (),
    planned: bool = False,
) -> pd.DataFrame:  # fmt: skip
    """Return the trials of a request with their levels of the factors, as matplotlib can draw them.

    A factor may be several, comma-separated, whose levels are joined.
    """
    parts = {factor: split([factor]) for factor in factors}
    names = list(dict.fromkeys(name for own in parts.values() for name in own))
    for name in names:
        results.check(name, "--rows/--columns/--facet")
    attempts = request.run is not None  # the run asked for may be one that was repeated
    trials = results.trials(condition_of(results, request), names, attempts, planned)
    levels = [name for name in trials if name not in ("status", *frames.NO_LEVELS)]
    for name in levels:  # as text, not as a formula between $
        drawable = [
            _cut(visible(level)).replace("$", r"\$") for level in trials[name].cat.categories
        ]
        trials[name] = trials[name].cat.rename_categories(drawable)
    for factor, own in parts.items():
        if len(own) > 1:
            trials[factor] = trials[[*own]].astype(str).agg(", ".join, axis=1).astype("category")
    return trials


def _cut(text: str) -> str:
    """Return the beginning of a long text with a part of its digest, so that it stays distinct."""
    digest = sha256(text.encode()).hexdigest()[:12]
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}-{digest}"


@dataclass(frozen=True)
class Facet:
    """The runs of one figure, and its label."""

    trials: pd.DataFrame  # see `frame`; also those that were planned and not started
    condition: Condition
    label: str = ""  # "vessel = milliampere", empty if there is one figure
    run: int | None = None  # the requested run

    @property
    def runs(self) -> Sequence[frames.StoredRun]:
        """The runs as objects, without the trials that were not started."""
        return frames.stored_runs(self.trials[self.trials["status"] != NOT_STARTED])

    def diagnostics(self, results: frames.Queries, names: Sequence[str]) -> pd.DataFrame:
        """Return the named diagnostics of the runs with the levels of their trials."""
        rows = results.diagnostics(names, self.condition)
        return rows.join(self.trials, on="run", how="inner")

    def title(self, text: str) -> str:
        """Return the title of the figure with the vessel and the facet."""
        parts = [self.label] * bool(self.label) + [f"run {self.run}"] * (self.run is not None)
        vessels = self.trials.loc[self.trials["status"] == frames.FINISHED, "vessel"].unique()
        if len(vessels) == 1 and "vessel = " not in self.label:
            text = f"{text}, {vessels[0]}"
        return f"{text} ({', '.join(parts)})" if parts else text

    def file(self, name: str) -> str:
        """Return a safe file name: no path separators or special characters."""
        stem = f"{name}-{self.label.replace(' = ', '-')}" if self.label else name
        stem += f"-run-{self.run}" if self.run is not None else ""
        return _cut(re.sub(r"[^\w.\-]+", "_", stem, flags=re.ASCII).strip("._") or "figure")


def per_facet(
    draw: Callable[[frames.Queries, PlotRequest, Facet], Drawing | None], missing: str = "",
    averages: bool = False,
) -> Callable[[frames.Queries, PlotRequest], list[Drawing]]:  # fmt: skip
    """Return what draws each facet that `draw` does not leave out by None.

    A figure that `averages` over runs is drawn once for each level of what the runs of a group
    differ in, and for each vessel. Raises ConfigurationError if no run matches, and if `draw`
    leaves out all facets, with the message `missing`, by default what the figure needs.
    """

    def drawings(results: frames.Queries, request: PlotRequest) -> list[Drawing]:
        own, names = [request.rows, request.columns], [request.facet] if request.facet else []
        pool = request.pool or []
        trials = trials_of(results, request, [*own, *names], planned=True)
        if averages and "all" not in pool:
            stages = definition_of(request.metric).stages
            stage = "deployment" if "deployment" in stages else "validation"
            frame, facts = with_conditions(results, trials, of_runs(trials, stage, request.model))
            groups = frames.codes(frame, list(dict.fromkeys([*own, *names])))
            apart = differing(facts, groups, frame["condition"], pool)
            require_few(apart, "the groups of this figure")
            named = {*split(own), *names, *apart, *pool}
            if trials["vessel"].nunique() > 1 and "vessel" not in named:
                apart.append("vessel")
            names += apart
            trials = trials_of(results, request, [*own, *names], planned=True) if apart else trials
        condition = condition_of(results, request)
        parts = dict(iter(trials.groupby(names, observed=True))) if names else {(): trials}
        ranks = [frames.ordered(levels) for levels in zip(*parts, strict=True)]
        made = list[Drawing]()
        for key in sorted(parts, key=lambda key: list(map(list.index, ranks, key))):
            label = ", ".join(f"{name} = {level}" for name, level in zip(names, key, strict=True))
            drawing = draw(results, request, Facet(parts[key], condition, label, request.run))
            made += [] if drawing is None else [drawing]
        if not made:
            needs = figures()[request.kind].needs
            lacking = f"plot {request.kind}: no run that matches has {needs}"
            raise ConfigurationError(missing or lacking)
        return made

    return drawings


def each_run(
    results: frames.Queries, request: PlotRequest, kinds: Sequence[str]
) -> list[tuple[frames.StoredRun, dict[str, Series]]]:
    """Return the runs of figures over time, and those of the series `kinds` that each run has.

    The run is the requested one, else the newest finished run that meets --where and has such a
    series; with --facet it is the newest run of each level.
    """
    condition, facet = condition_of(results, request), request.facet
    stored = results.series_columns(condition)
    candidates: dict[str, frames.StoredRun] = {}  # the newest by level
    for run in frames.stored_runs(trials_of(results, request, [facet] if facet else [])):
        has = any(kind in stored.get(run.id, ()) for kind in kinds)
        if has and (request.run is not None or run.status == frames.FINISHED):
            candidates[run.levels[facet] if facet is not None else ""] = run
    if not candidates:
        subject = "no finished run that matches has a"
        subject = subject if request.run is None else f"run {request.run} has no"
        raise ConfigurationError(f"plot: {subject} series {' or '.join(kinds)}")
    chosen = [candidates[level] for level in frames.ordered(candidates)]
    read = results.reader.series
    return [(run, {k: read(run.id, k) for k in kinds if k in stored[run.id]}) for run in chosen]


def per_run(
    draw: Callable[[frames.Queries, PlotRequest, frames.StoredRun, Mapping[str, Series]], Drawing],
    *kinds: str,
) -> Callable[[frames.Queries, PlotRequest], list[Drawing]]:
    """Return what draws one figure of one run (with --facet, for each level), by `each_run`."""
    return lambda results, request: [
        draw(results, request, *own) for own in each_run(results, request, kinds)
    ]


def subtitle(run: frames.StoredRun) -> str:
    """Return `run 17: milliampere, noise, plsr, seed 3`."""
    levels = ", ".join(run.levels[name] for name in ("vessel", "disturbance", "identifier"))
    return f"run {run.id}: {levels}, seed {run.levels['seed']}"


def in_plane(
    run: frames.StoredRun, what: str, series_of: Voyages, names: Sequence[str] = ("t", "x", "y")
) -> None:
    """Raise ConfigurationError if a voyage of a run has no track in the plane."""
    for series in series_of.values():
        for name in (name for name in names if name not in series.columns):
            got = f"run {run.id} has no {name} in its series {series.kind}"
            raise ConfigurationError(f"{what}: {got}, expected a vessel that moves in the plane")


def distinct(
    results: frames.Queries, run: frames.StoredRun, series_of: Mapping[str, Series]
) -> tuple[Voyages, list[str]]:
    """Return the deployments of a run by model, and notes on the models that are not among them.

    A run without any has the voyage of its recording, named `recording`. The deployment of the
    identified model is left out if it is that of the nominal one, as it is without identification.
    Of a model that was not deployed the note says why.
    """
    voyages = {k.removeprefix(PREFIX): s for k, s in series_of.items() if k.startswith(PREFIX)}
    voyages = voyages or {"recording": series_of["recording"]}
    models = ("nominal", "identified")
    absent = [model for model in models if model not in voyages]
    if len(absent) == len(models):
        return voyages, []
    if absent:
        reason = results.reader.run(run.id).note
        return voyages, [reason or f"the {model} model did not sail" for model in absent]
    first, second = (pd.DataFrame(voyages[model].columns) for model in models)
    if first.equals(second):
        del voyages["identified"]
        return voyages, ["the identified model sails the same track"]
    return voyages, []
