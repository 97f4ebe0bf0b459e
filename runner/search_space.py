"""The space and the options of a search; the space is made from sweeps, also inside lists.

controller.lowpass_hz=tag(log,interval(0.1,5))                a number, on a logarithmic scale
'controller.kp=[interval(20,400),interval(50,900),940]'       numbers of a list
controller=pid_ff,lqi   'identifier.order=range(2,9)'         choices and integers
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import floor
from typing import Any, Literal

import optuna
from hydra.core.override_parser.types import (
    ChoiceSweep,
    Glob,
    IntervalSweep,
    Override,
    QuotedString,
    RangeSweep,
    Sweep,
)
from optuna.distributions import BaseDistribution

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegativeInt, PositiveInt, check_ranges
from seatrial.runner.compare.search_candidates import Objective, objective_of
from seatrial.runner.overrides import nested_sweeps
from seatrial.runner.sweep import values_of

DIGITS = 6  # of a candidate's numbers, so that its command line can be read
Values = dict[str, Any]  # of parameters, by name: numbers and texts, as Optuna gives them


@dataclass(frozen=True)
class Dimension:
    """An option with one parameter, or a list or mapping with several.

    `places` are the sweeps by the name of their parameter; `value` is the parsed override.
    """

    key: str
    value: object
    places: Mapping[str, Sweep]
    choices: tuple[str, ...]  # texts, if the option itself is a choice

    def override(self, values: Values) -> str:
        """Return the override of a candidate."""
        if self.choices:
            return f"{self.key}={values[self.key]}"
        return f"{self.key}={_text(self.value, self.key, values)}"


def dimension(override: Override) -> Dimension:
    """Return the dimension of an override with sweeps."""
    key, value = override.get_key_element(), override.value()
    choices: tuple[str, ...] = ()
    if override.is_sweep_override() and isinstance(value, ChoiceSweep | Glob):
        choices = tuple(dict.fromkeys(map(str, override.sweep_string_iterator())))
    return Dimension(key, value, dict(nested_sweeps(value, key)), choices)


def distributions(space: Sequence[Dimension]) -> dict[str, BaseDistribution]:
    """Return Optuna's distributions by parameter; raises ConfigurationError for an empty one."""
    found: dict[str, BaseDistribution] = {}
    for one in space:
        if one.choices:
            found[one.key] = optuna.distributions.CategoricalDistribution(one.choices)
            continue
        for name, sweep in one.places.items():
            try:
                found[name] = _distribution(sweep)
            except (ValueError, TypeError) as error:
                raise ConfigurationError(f"{name}: {' '.join(str(error).split())}") from error
    return found


def _distribution(sweep: Sweep) -> BaseDistribution:
    log = "log" in sweep.tags
    if isinstance(sweep, ChoiceSweep):
        return optuna.distributions.CategoricalDistribution([_plain(value) for value in sweep.list])
    if isinstance(sweep, IntervalSweep):
        low, high = sweep.start, sweep.end
        if isinstance(low, int) and isinstance(high, int):
            return optuna.distributions.IntDistribution(low, high, log=log)
        return optuna.distributions.FloatDistribution(
            float(low or 0.0), float(high or 0.0), log=log
        )
    if isinstance(sweep, RangeSweep):  # its end is not one of its values
        low, end, step = sweep.start or 0, sweep.stop or 0, sweep.step
        if isinstance(low, int) and isinstance(end, int) and isinstance(step, int):
            return optuna.distributions.IntDistribution(
                low, low + step * ((end - 1 - low) // step), step=step
            )
        count = floor((float(end) - float(low)) / float(step) - 1e-9)
        high = float(low) + count * float(step)
        return optuna.distributions.FloatDistribution(float(low), high, step=float(step))
    raise ValueError(f"got {sweep}, expected interval, range or choice")


def described(distribution: BaseDistribution) -> str:
    """Return a distribution in words."""
    if isinstance(distribution, optuna.distributions.CategoricalDistribution):
        return ", ".join(map(str, distribution.choices))
    assert isinstance(
        distribution, optuna.distributions.FloatDistribution | optuna.distributions.IntDistribution
    )
    text = f"{distribution.low:g} to {distribution.high:g}"
    text += f", step {distribution.step:g}" if distribution.step not in (None, 1) else ""
    return f"{text}, logarithmic" if distribution.log else text


def rounded(values: Values, space: Mapping[str, BaseDistribution]) -> Values:
    """Return the parameters of a candidate with DIGITS digits, inside their intervals."""
    return {name: _rounded(values[name], space[name]) for name in space}


def _rounded(value: Any, distribution: BaseDistribution) -> Any:
    if not isinstance(distribution, optuna.distributions.FloatDistribution):
        return value
    return min(max(float(f"{value:.{DIGITS}g}"), distribution.low), distribution.high)


def present(
    space: Sequence[Dimension],
    known: Mapping[str, BaseDistribution],
    config: Mapping[str, object],
    names: Mapping[str, str],
) -> Values | None:
    """Return the parameters of a configuration; None if it is not within the space.

    `names` are the options chosen for groups.
    """
    values: dict[str, object] = {}
    for one in space:
        node = names[one.key] if one.key in names else _at(config, one.key)
        if one.choices:
            values[one.key] = _plain(node)
        else:
            values |= dict(_entries(one.value, node, one.key))
    for name, distribution in known.items():
        if not _contains(distribution, values.get(name)):
            return None
    return values


def _contains(distribution: BaseDistribution, value: object) -> bool:
    if isinstance(distribution, optuna.distributions.CategoricalDistribution):
        return value in distribution.choices
    assert isinstance(
        distribution, optuna.distributions.FloatDistribution | optuna.distributions.IntDistribution
    )
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and distribution.low <= value <= distribution.high  # type: ignore[operator]


def _at(config: object, key: str) -> object:
    for part in key.lstrip("+").split("."):
        config = config.get(part) if isinstance(config, Mapping) else None
    return config


def _entries(value: object, node: object, name: str) -> Iterator[tuple[str, object]]:
    """Pair the sweeps of a value with the entries of a configuration."""
    if isinstance(value, Sweep):
        yield name, node
    elif isinstance(value, list) and isinstance(node, list | tuple) and len(value) == len(node):
        for i, (inner, entry) in enumerate(zip(value, node, strict=True)):
            yield from _entries(inner, entry, f"{name}[{i}]")
    elif isinstance(value, dict) and isinstance(node, Mapping):
        for key, inner in value.items():
            yield from _entries(inner, node.get(str(key)), f"{name}.{key}")


def _text(value: object, name: str, values: Values) -> str:
    """Return a value in the grammar of the command line, with the parameters in their places."""
    if isinstance(value, Sweep):
        return _plain(values[name])
    if isinstance(value, list):
        return "[" + ",".join(_text(v, f"{name}[{i}]", values) for i, v in enumerate(value)) + "]"
    if isinstance(value, dict):
        inner = (f"{key}:{_text(v, f'{name}.{key}', values)}" for key, v in value.items())
        return "{" + ",".join(inner) + "}"
    return _plain(value)


def _plain(value: object) -> str:
    """Return a single value as text."""
    if isinstance(value, QuotedString):
        return str(value.with_quotes())
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


@dataclass(frozen=True)
class Space:
    """What the command line asks for: parameters, seeds, and options that are the same for all."""

    dimensions: tuple[Dimension, ...]
    seeds: tuple[str, ...]  # overrides
    fixed: tuple[str, ...]

    def jobs(self, values: Values) -> list[list[str]]:
        """Return the overrides of a candidate's trials, one for each seed."""
        own = [one.override(values) for one in self.dimensions]
        return [[*self.fixed, *own, seed] for seed in self.seeds]

    def command(self, values: Values) -> list[str]:
        """Return the overrides that sail a candidate again."""
        seeds = ",".join(text.partition("=")[2] for text in self.seeds)
        return [*self.fixed, *(one.override(values) for one in self.dimensions), f"seed={seeds}"]


def space_of(overrides: Sequence[Override]) -> Space:
    """Sort the overrides of a search; raises ConfigurationError if none has several values."""
    dimensions: list[Dimension] = []
    seeds: list[str] = ["seed=0"]
    fixed: list[str] = []
    for override in overrides:
        key = override.get_key_element()
        if key == "seed":
            seeds = values_of(override)
        elif next(nested_sweeps(override.value(), key), None) is not None:
            dimensions.append(dimension(override))
        else:
            fixed += values_of(override)
    if not dimensions:
        raise ConfigurationError(
            "hydra/sweeper=optuna: got no option to search, expected one such as "
            "'controller.kp=[interval(50,200),550,940]' or identifier=ls,plsr"
        )
    return Space(tuple(dimensions), tuple(seeds), tuple(fixed))


PRUNED = optuna.trial.TrialState.PRUNED


@dataclass(frozen=True)
class SearchOptions:
    """The options of a search, as conf/hydra/sweeper/optuna.yaml explains them."""

    metric: tuple[str, ...]
    dof: str | None
    stage: str | None
    model: str
    statistic: str
    direction: Literal["auto", "minimize", "maximize"]
    trials: PositiveInt
    batch: PositiveInt
    sampler: Literal["tpe", "random"]
    startup: PositiveInt
    sampler_seed: NotNegativeInt
    prune: bool
    default_first: bool

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.metric:
            raise ConfigurationError("search.metric: got none, expected at least one metric")
        if self.statistic not in ("mean", "median", "min", "max"):
            raise ConfigurationError(
                f"search.statistic: got {self.statistic!r}, expected mean, median, min or max"
            )

    def objectives(self) -> list[Objective]:
        """Return the objectives; raises ConfigurationError for what no trial stores."""
        return [
            objective_of(name, self.dof, self.stage, self.model, self.statistic, self.direction)
            for name in self.metric
        ]

    @property
    def prunes(self) -> bool:
        """Whether candidates may be stopped early: Optuna's pruners know one objective."""
        return self.prune and len(self.metric) == 1

    def study(self) -> optuna.Study:
        """Return a new study; every loss is minimised."""
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        sampler = (
            optuna.samplers.RandomSampler(seed=self.sampler_seed)
            if self.sampler == "random"
            else optuna.samplers.TPESampler(
                seed=self.sampler_seed,
                n_startup_trials=self.startup,
                constant_liar=self.batch > 1,
            )
        )
        pruner = (
            optuna.pruners.MedianPruner(self.startup, n_warmup_steps=1)
            if self.prunes
            else optuna.pruners.NopPruner()
        )
        directions: list[Literal["minimize"]] = ["minimize" for _ in self.metric]
        return optuna.create_study(sampler=sampler, pruner=pruner, directions=directions)
