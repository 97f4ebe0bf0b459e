"""The request of a comparison table, and the runs and numbers that it selects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.cli import TableOptions, axes_of
from seatrial.runner.compare.pivot import Key, Pivot
from seatrial.runner.compare.results import (
    BELOW_TRUE_MODEL,
    DESIGN_FLAWS,
    FINISHED,
    OWN_FACTORS,
    Observation,
    Results,
    Run,
    ordered,
)
from seatrial.runner.compare.statistics import DEFAULT, IntervalKind, checked
from seatrial.runner.vocabulary import GROUPS


@dataclass(frozen=True)
class TableRequest:
    """The request of a table.

    `names` are metrics, or terms if `of_coefficients`; empty means all terms. Empty `dofs`,
    `stages`, `models` mean all. `baseline` is a factor and its level.
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
    baseline: tuple[str, str] | None = None
    where: str | None = None
    digits: int = 4

    @property
    def factors(self) -> Key:
        """The factors that are properties of runs."""
        wanted = (*self.rows, *self.columns, *(self.baseline or ())[:1])
        return tuple(dict.fromkeys(name for name in wanted if name not in OWN_FACTORS))


@dataclass(frozen=True)
class Found:
    """The numbers selected by a request: `shown` fill the cells, `all` include the baseline.

    `unsettled` are the (run, model) whose controller is unstable on its own model, `infeasible`
    those whose limits are too small for the weather. `fixed` are the own factors with one level,
    `extra` those with several levels that are neither rows nor columns.
    """

    runs: Sequence[Run]
    shown: Sequence[Observation]
    all: Sequence[Observation]
    flagged: frozenset[tuple[int, str]]
    fixed: Mapping[str, str]
    extra: Key
    unsettled: frozenset[tuple[int, str]] = frozenset()
    infeasible: frozenset[tuple[int, str]] = frozenset()


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
        baseline=_factor_and_level(options.baseline),
        where=options.where,
        digits=options.digits,
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


def _factor_and_level(baseline: str | None) -> tuple[str, str] | None:
    if baseline is None:
        return None
    factor, equals, level = (part.strip() for part in baseline.partition("="))
    if not (factor and equals and level):
        raise ConfigurationError(
            f"--baseline: got {baseline!r}, expected a factor and its level such as identifier=none"
        )
    return factor, level


def gather(results: Results, request: TableRequest) -> Found:
    """Read runs and numbers of a request; raises ConfigurationError for an unknown name."""
    for factor in request.factors:
        results.names.check(factor, "--rows/--columns")
    condition = results.where(request.where)
    runs = results.runs(condition, request.factors)
    if request.of_coefficients:
        numbers, flagged = results.coefficients(runs, condition), frozenset[tuple[int, str]]()
        unsettled = infeasible = frozenset[tuple[int, str]]()
    else:
        only = {name: levels for name, levels in _wanted(request).items() if name != "metric"}
        numbers = results.metrics(runs, request.names, condition, only)
        if not numbers:  # read all levels, for the error message
            numbers = results.metrics(runs, request.names, condition)
        flags = results.metrics(runs, (BELOW_TRUE_MODEL, *DESIGN_FLAWS), condition)
        flagged = frozenset(
            (o.run.id, o.dof) for o in flags if o.name == BELOW_TRUE_MODEL and o.value
        )
        flaws = [o for o in flags if o.name in DESIGN_FLAWS and (o.value or 0.0) >= 1.0]
        unsettled, infeasible = (
            frozenset((o.run.id, o.model) for o in flaws if o.name == name) for name in DESIGN_FLAWS
        )
    numbers = _selected(results, numbers, request)
    _check_baseline(request, runs, numbers)
    finished = [o for o in numbers if o.run.status == FINISHED]
    shown = [o for o in finished if not request.models or o.model in request.models]
    levels = {name: ordered(o.level(name) for o in shown) for name in OWN_FACTORS}
    free = [n for n in OWN_FACTORS if n not in request.rows + request.columns]
    return Found(
        runs,
        shown,
        finished,
        flagged,
        fixed={name: levels[name][0] for name in OWN_FACTORS if len(levels[name]) == 1},
        extra=tuple(name for name in free if len(levels[name]) > 1),
        unsettled=unsettled,
        infeasible=infeasible,
    )


def _selected(
    results: Results, numbers: Sequence[Observation], request: TableRequest
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
    if models and request.baseline and request.baseline[0] == "model":
        models.append(request.baseline[1])
    return {
        "metric": request.names,
        "dof": request.dofs,
        "stage": request.stages,
        "model": models,
    }


def _check_names(results: Results, request: TableRequest, names: set[str]) -> None:
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
    request: TableRequest, runs: Sequence[Run], numbers: Sequence[Observation]
) -> None:
    if request.baseline is None:
        return
    factor, level = request.baseline
    if factor in OWN_FACTORS:
        available = ordered(o.level(factor) for o in numbers)
    else:
        available = ordered(run.levels[factor] for run in runs)
    if level not in available:
        raise ConfigurationError(
            f"--baseline: no run has {factor}={level}; expected one of {', '.join(available)}"
        )


def pooled(results: Results, table: Pivot) -> list[str]:
    """Return notes on the factors, other than the seed, that cells average over."""
    choices: dict[str, set[str]] = {}
    repeated: set[int] = set()
    labels = itemgetter(*GROUPS, "seed")
    for cell in table.cells.values():
        first_runs: dict[tuple[str, ...], int] = {}
        for run in {o.run.id: o.run for o in cell.observed}.values():
            choice_levels = labels(run.levels)
            if first_runs.setdefault(choice_levels, run.id) != run.id and len(repeated) < 40:
                repeated |= {first_runs[choice_levels], run.id}
        for name, levels in zip(GROUPS, map(set, zip(*first_runs, strict=True)), strict=False):
            if len(levels) > 1:
                choices.setdefault(name, set()).update(levels)
    notes = [f"{name} ({', '.join(ordered(levels))})" for name, levels in choices.items()]
    notes += _differing_keys(results, sorted(repeated))
    return [f"cells average over {', '.join(notes)}: narrow by --where"] if notes else []


def _differing_keys(results: Results, ids: Sequence[int]) -> list[str]:
    configs = results.configs(ids)
    keys = dict.fromkeys(key for config in configs for key in config)
    notes = []
    for key in keys:
        levels = ordered(str(config.get(key)) for config in configs)
        if len(levels) > 1 and key != "seed" and not key.startswith("database."):
            notes.append(f"{key} ({', '.join(levels[:4])}{', …' if len(levels) > 4 else ''})")
    return notes if len(notes) <= 4 else [*notes[:4], f"{len(notes) - 4} more keys"]
