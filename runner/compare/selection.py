"""What a comparison is asked for, and what the database holds for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.cli import axes_of
from seatrial.runner.compare.command_options import TableOptions
from seatrial.runner.compare.factors import CHOICES
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


@dataclass(frozen=True)
class TableRequest:
    """What a table shows.

    `names` are metrics, or terms where `of_coefficients`; empty means all terms. Empty `dofs`,
    `stages`, `models` mean all there are. `baseline` is a factor and its level.
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
    """What the database holds for a request: `shown` go into cells, `all` serve the baseline too.

    `unsettled` and `infeasible` are (run, model) whose controller's design does not settle on its
    own model, or whose limits are below the weather. `fixed` are the own factors that have one
    level throughout, `extra` those with several that neither rows nor columns name.
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
    """The request that command line options make; raises ConfigurationError where they clash."""
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
    """Options that may be repeated or parted by commas, as one list."""
    parts = (part.strip() for text in texts or () for part in text.split(","))
    return tuple(dict.fromkeys(part for part in parts if part))


def _all_or(levels: Key) -> Key:
    return () if "all" in levels else levels


def _factors(text: str) -> Key:
    """Factor names, `none` for no factor; a coefficient's `term` is what its metric is to a run."""
    names = _listed([text])
    return () if names == ("none",) else tuple("metric" if n == "term" else n for n in names)


def _factor_and_level(baseline: str | None) -> tuple[str, str] | None:
    if baseline is None:
        return None
    factor, equals, level = (part.strip() for part in baseline.partition("="))
    if not (factor and equals and level):
        raise ConfigurationError(
            f"--baseline: got {baseline!r}, expected a factor and its level as identifier=none"
        )
    return factor, level


def gather(results: Results, request: TableRequest) -> Found:
    """Reads runs and numbers of a request; raises ConfigurationError for what is not known."""
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
        if not numbers:  # then what there is instead
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
    """The numbers asked for by name, DOF, stage and model; an unknown one is refused by name."""
    _check_names(results, request, {o.name for o in numbers})
    kept = list(numbers)
    for factor, levels in _wanted(request).items():
        have = ordered(o.level(factor) for o in kept)
        kept = [o for o in kept if not levels or o.level(factor) in levels]
        if levels and have and not kept:
            raise ConfigurationError(
                f"--{factor}: no run has {', '.join(request.names) or 'a coefficient'} with"
                f" {factor} {', '.join(levels)}; expected one of {', '.join(have)}"
            )
    return kept


def _wanted(request: TableRequest) -> dict[str, Sequence[str]]:
    """The levels asked for of what a number says itself; none of one means all of them."""
    models = list(request.models)
    if models and request.baseline and request.baseline[0] == "model":
        models.append(request.baseline[1])
    return {
        "metric": request.names,
        "dof": request.dofs,
        "stage": request.stages,
        "model": models,
    }


def _check_names(results: Results, request: TableRequest, found: set[str]) -> None:
    """Refuses a name that no run has; one that only these runs lack is an empty cell."""
    if found.issuperset(request.names):
        return
    what = "coefficient" if request.of_coefficients else "metric"
    known = found if request.of_coefficients else found | {*results.metric_names()}
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
        have = ordered(o.level(factor) for o in numbers)
    else:
        have = ordered(run.levels[factor] for run in runs)
    if level not in have:
        raise ConfigurationError(
            f"--baseline: no run has {factor}={level}; expected one of {', '.join(have)}"
        )


def pooled(results: Results, table: Pivot) -> list[str]:
    """Notes on what is averaged within a cell beside seeds."""
    choices: dict[str, set[str]] = {}
    twins: set[int] = set()
    labels = itemgetter(*CHOICES, "seed")
    for cell in table.cells.values():
        seen: dict[tuple[str, ...], int] = {}
        for run in {o.run.id: o.run for o in cell.observed}.values():
            same = labels(run.levels)
            if seen.setdefault(same, run.id) != run.id and len(twins) < 40:
                twins |= {seen[same], run.id}
        for name, levels in zip(CHOICES, map(set, zip(*seen, strict=True)), strict=False):
            if len(levels) > 1:
                choices.setdefault(name, set()).update(levels)
    notes = [f"{name} ({', '.join(ordered(levels))})" for name, levels in choices.items()]
    notes += _differing_keys(results, sorted(twins))
    return [f"cells average over {', '.join(notes)}: narrow by --where"] if notes else []


def _differing_keys(results: Results, ids: Sequence[int]) -> list[str]:
    configs = results.configs(ids)
    keys = dict.fromkeys(key for config in configs for key in config)
    found = []
    for key in keys:
        levels = ordered(str(config.get(key)) for config in configs)
        if len(levels) > 1 and key != "seed" and not key.startswith("database."):
            found.append(f"{key} ({', '.join(levels[:4])}{', …' if len(levels) > 4 else ''})")
    return found if len(found) <= 4 else [*found[:4], f"{len(found) - 4} more keys"]
