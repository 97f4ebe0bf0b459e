"""The request of a comparison table, and the runs and numbers that it selects."""

import math
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.cli import MOST_CELLS, TableOptions, axes_of
from seatrial.runner.compare.likeness import Likeness, differing, require_few
from seatrial.runner.compare.pivot import Key, Prediction, prediction_of
from seatrial.runner.compare.results import (
    BELOW_TRUE_MODEL,
    DESIGN_FLAWS,
    FINISHED,
    OWN_FACTORS,
    Observation,
    Queries,
    StoredRun,
    ordered,
)
from seatrial.runner.compare.statistics import DEFAULT, IntervalKind, checked
from seatrial.runner.record.catalogue import HORIZONS, PER_FILE

LIMITED = tuple(f"limited_share_{horizon}" for horizon in HORIZONS)
HELD_FREE_RUN = "held_free_run"
DIVERGENCE = (*LIMITED, HELD_FREE_RUN)


@dataclass(frozen=True)
class TableRequest:
    """The request of a table.

    `names` are metrics, or terms if `of_coefficients`; empty means all terms. Empty `dofs`,
    `stages`, `models` mean all. `baseline` maps factors to the levels of the reference. Cells may
    average over the factors of `pool`.
    """

    names: Sequence[str]
    rows: Key = ("identifier",)
    columns: Key = ("disturbance",)
    of_coefficients: bool = False
    dofs: Sequence[str] = ()
    stages: Sequence[str] = ()
    models: Sequence[str] = ("identified",)
    statistics: Sequence[str] = DEFAULT
    interval: IntervalKind = "t"
    baseline: Mapping[str, str] = field(default_factory=dict)
    where: str | None = None
    sweep: str | None = None  # a number, a name or `all`; by default the newest one
    tag: str | None = None  # only sweeps with it
    pool: Key = ()
    digits: int = 4
    cells: int = MOST_CELLS  # most cells, with the empty ones

    @property
    def factors(self) -> Key:
        """The factors that are properties of runs."""
        wanted = (*self.rows, *self.columns, *self.baseline)
        return tuple(dict.fromkeys(name for name in wanted if name not in OWN_FACTORS))

    @property
    def by_file(self) -> bool:
        """Whether each file that was tested on is shown beside all of them."""
        return "file" in (*self.rows, *self.columns, *self.baseline)

    @property
    def own_factors(self) -> Key:
        """The factors that are properties of the number."""
        return tuple(name for name in OWN_FACTORS if name != "file" or self.by_file)


@dataclass(frozen=True)
class Selection:
    """The numbers selected by a request: `shown` fill the cells, `all` include the baseline.

    `split` are the factors that the runs of a cell would differ in; `diverged` are the predictions
    that diverged; `scope` names the sweep. `unsettled` are the (run, model) whose controller is
    unstable on its own model, `infeasible` those whose limits are too small for the weather.
    `fixed` are the own factors with one level, `extra` those with several levels that are neither
    rows nor columns. `covering` are the runs whose standard errors are of the coefficient, not only
    of its estimate.
    """

    runs: Sequence[StoredRun]
    shown: Sequence[Observation]
    all: Sequence[Observation]
    flagged: frozenset[tuple[int, str]]
    fixed: Mapping[str, str]
    extra: Key
    likeness: Likeness
    scope: str = ""
    split: Key = ()
    unsettled: frozenset[tuple[int, str]] = frozenset()
    infeasible: frozenset[tuple[int, str]] = frozenset()
    diverged: Mapping[Prediction, float] = field(default_factory=dict)
    covering: frozenset[int] = frozenset()


def request_of(options: TableOptions) -> TableRequest:
    """Return the request of the options; raises ConfigurationError if they conflict."""
    of_coefficients = bool(options.coefficient) or options.coefficients
    if of_coefficients and options.metric:
        raise ConfigurationError("--metric and --coefficient: got both, expected one of them")
    row_factors, column_factors = (
        _factors(axis) for axis in axes_of(options.rows, options.columns)
    )
    if options.coefficients and not options.coefficient:
        row_factors = tuple(f for f in ("dof", "metric") if f not in column_factors) + tuple(
            f for f in row_factors if f not in ("dof", "metric") and f not in column_factors
        )
    twice = [f for f in row_factors if f in column_factors]
    if twice:
        raise ConfigurationError(
            f"--rows and --columns: both name {twice[0]}, expected one of them"
        )
    shown = _listed(options.model) or (
        () if "model" in row_factors + column_factors else ("identified",)
    )
    return TableRequest(
        names=_listed(options.coefficient if of_coefficients else options.metric or ["force_mse"]),
        rows=row_factors,
        columns=column_factors,
        of_coefficients=of_coefficients,
        dofs=_all_or(_listed(options.dof)),
        stages=_all_or(_listed(options.stage)),
        models=_all_or(shown),
        statistics=checked(_listed(options.statistic) or DEFAULT),
        interval=options.interval,
        baseline=_baseline(options.baseline),
        where=options.where,
        sweep=options.sweep,
        tag=options.tag,
        pool=_listed(options.pool),
        digits=options.digits,
        cells=options.cells,
    )


def _listed(texts: Sequence[str] | None) -> Key:
    """Return the distinct values of a repeated or comma-separated option."""
    parts = (part.strip() for text in texts or () for part in text.split(","))
    return tuple(dict.fromkeys(part for part in parts if part))


def _all_or(levels: Key) -> Key:
    return () if "all" in levels else levels


def _factors(text: str) -> Key:
    """Return factor names, none for `none`; the name of a coefficient, `term`, is its metric."""
    names = _listed([text])
    return () if names == ("none",) else tuple("metric" if n == "term" else n for n in names)


def _baseline(texts: Sequence[str] | None) -> dict[str, str]:
    """Return the levels of the baseline by factor."""
    levels = {}
    for text in _listed(texts):
        factor, equals, level = (part.strip() for part in text.partition("="))
        if not (factor and equals and level):
            raise ConfigurationError(
                f"--baseline: got {text!r}, expected a factor and its level such as identifier=none"
            )
        levels[factor] = level
    return levels


def gather(results: Queries, request: TableRequest) -> Selection:
    """Read runs and numbers of a request; raise ConfigurationError for an unknown name.

    A cell whose runs differ in more than the seed is split by what they differ in, or refused.
    """
    for factor in request.factors:
        results.names.check(factor, "--rows/--columns")
    for factor in request.pool:
        if factor != "all":
            results.names.check(factor, "--pool")
    selection = _gathered(results, request)
    cells: dict[Hashable, list[Observation]] = defaultdict(list)
    for observation in selection.shown:
        named = (*request.rows, *request.columns, *OWN_FACTORS)
        cells[tuple(observation.level(name) for name in named)].append(observation)
    split = [] if "all" in request.pool else differing(selection.likeness, cells, request.pool)
    require_few(split, "the cells of this table")
    if not split:
        return selection
    rows = (*request.rows, *split)
    return replace(_gathered(results, replace(request, rows=rows)), split=tuple(split))


def _gathered(results: Queries, request: TableRequest) -> Selection:
    condition, scope = results.selected(request.where, request.sweep, request.tag)
    runs = results.runs(condition, request.factors)
    likeness = Likeness(results, runs)
    flags: list[Observation] = []
    if request.of_coefficients:
        numbers = results.coefficients(runs, condition)
    else:
        only = {name: levels for name, levels in _wanted(request).items() if name != "metric"}
        numbers = results.metrics(runs, request.names, condition, only)
        if not numbers:  # read all levels, for the error message
            numbers = results.metrics(runs, request.names, condition)
        if request.by_file:
            of_files = results.of_files(runs, request.names, condition)
            if not of_files:
                raise ConfigurationError(
                    f"--rows/--columns: no run has {', '.join(request.names)} by file, expected "
                    f"one of {', '.join(PER_FILE)} of runs with several files for testing"
                )
            numbers += of_files
        names = (BELOW_TRUE_MODEL, *DESIGN_FLAWS, *DIVERGENCE)
        flags = results.metrics(runs, names, condition)
    numbers = _selected(results, numbers, request)
    _check_baseline(request, runs, numbers)
    finished = [o for o in numbers if o.run.status == FINISHED]
    shown = [o for o in finished if not request.models or o.model in request.models]
    levels = {name: ordered(o.level(name) for o in shown) for name in request.own_factors}
    free = [name for name in levels if name not in request.rows + request.columns]
    unsettled, infeasible = (
        frozenset((o.run.id, o.model) for o in flags if o.name == name and (o.value or 0.0) >= 1.0)
        for name in DESIGN_FLAWS
    )
    return Selection(
        [*runs, *results.not_started(condition, request.factors, runs)],
        shown,
        finished,
        frozenset((o.run.id, o.dof) for o in flags if o.name == BELOW_TRUE_MODEL and o.value),
        fixed={name: each[0] for name, each in levels.items() if len(each) == 1},
        extra=tuple(name for name in free if len(levels[name]) > 1),
        likeness=likeness,
        scope=scope,
        unsettled=unsettled,
        infeasible=infeasible,
        diverged=diverged_predictions(flags),
        covering=results.covering(runs, condition) if request.of_coefficients else frozenset(),
    )


def diverged_predictions(numbers: Sequence[Observation]) -> dict[Prediction, float]:
    """Return the predictions that diverged, and the time [s] that a free run held, else NaN.

    `numbers` are the metrics DIVERGENCE of some runs.
    """
    held = {prediction_of(o): o.value for o in numbers if o.name == HELD_FREE_RUN}
    return {
        place: math.nan if held.get(place) is None else float(held[place] or 0.0)
        for place in (prediction_of(o) for o in numbers if o.name in LIMITED and o.value)
    }


def _selected(
    results: Queries, numbers: Sequence[Observation], request: TableRequest
) -> list[Observation]:
    """Select numbers by name, DOF, stage and model; raises ConfigurationError if none is left."""
    _check_names(results, request, {o.name for o in numbers})
    selected = list(numbers)
    for factor, levels in _wanted(request).items():
        available = ordered(o.level(factor) for o in selected)
        selected = [o for o in selected if not levels or o.level(factor) in levels]
        if levels and available and not selected:
            raise ConfigurationError(
                f"--{factor}: no run has {', '.join(request.names) or 'a coefficient'} with"
                f" {factor} {', '.join(levels)}; expected one of {', '.join(available)}"
            )
    return selected


def _wanted(request: TableRequest) -> dict[str, Sequence[str]]:
    """Return the requested levels of the own factors; an empty list means all levels."""
    models = list(request.models)
    if models and "model" in request.baseline:
        models.append(request.baseline["model"])
    return {"metric": request.names, "dof": request.dofs, "stage": request.stages, "model": models}


def _check_names(results: Queries, request: TableRequest, names: set[str]) -> None:
    """Reject a name that no run has; a name that only these runs lack gives an empty cell."""
    if names.issuperset(request.names):
        return
    what = "coefficient" if request.of_coefficients else "metric"
    known = names if request.of_coefficients else names | {*results.metric_names()}
    for name in request.names:
        if name not in known and known:
            raise ConfigurationError(
                f"--{what}: no {what} {name!r}; expected one of {', '.join(sorted(known))}"
            )


def _check_baseline(
    request: TableRequest, runs: Sequence[StoredRun], numbers: Sequence[Observation]
) -> None:
    for factor, level in request.baseline.items():
        if factor in OWN_FACTORS:
            available = ordered(o.level(factor) for o in numbers)
        else:
            available = ordered(run.levels[factor] for run in runs)
        if level not in available:
            raise ConfigurationError(
                f"--baseline: no run has {factor}={level}; expected one of {', '.join(available)}"
            )
