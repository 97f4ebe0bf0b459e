"""The space and the options of a search; the space is made from sweeps, also inside lists.

controller.lowpass_hz=tag(log,interval(0.1,5))                a number, on a logarithmic scale
'controller.kp=[interval(20,400),interval(50,900),940]'       numbers of a list
controller=pid_ff,lqi   'identifier.order=range(2,9)'         choices and integers
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import optuna
from hydra.core.override_parser.types import (
    ChoiceSweep,
    Glob,
    IntervalSweep,
    Override,
    RangeSweep,
    Sweep,
)
from omegaconf import OmegaConf
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegativeInt, PositiveInt, check_ranges
from seatrial.runner.compare.search_candidates import Objective, objective_of
from seatrial.runner.job import Order
from seatrial.runner.overrides import nested_sweeps, text_of
from seatrial.runner.sweep import values_of

DIGITS = 6  # of a candidate's numbers, so that its command line can be read
PRUNED = optuna.trial.TrialState.PRUNED
Values = Mapping[str, Any]  # of parameters, by name: numbers and texts


@dataclass(frozen=True)
class Space:
    """What the command line asks for: options with parameters, seeds, and those without.

    Parameters are named by their option, as `identifier` or `controller.kp[0]`.
    """

    searched: tuple[Override, ...]
    seeds: tuple[str, ...]  # overrides
    fixed: tuple[str, ...]
    distributions: Mapping[str, BaseDistribution]

    def overrides(self, values: Values) -> list[str]:
        """Return the overrides of a candidate, without its seeds."""
        by_key = {override.get_key_element(): override.value() for override in self.searched}
        return [*self.fixed, *(f"{k}={text_of(v, k, values)}" for k, v in by_key.items())]

    def rounded(self, values: Values) -> dict[str, Any]:
        """Return the parameters of a candidate with DIGITS digits, inside their intervals."""
        return {
            name: min(max(float(f"{values[name]:.{DIGITS}g}"), space.low), space.high)
            if isinstance(space, FloatDistribution)
            else values[name]
            for name, space in self.distributions.items()
        }

    def present(self, order: Order) -> dict[str, Any] | None:
        """Return the parameters of a configuration; None if it is not within the space."""
        config = OmegaConf.create(dict(order.config))
        values = {}
        for name, space in self.distributions.items():
            key = name.lstrip("+")
            value = order.names.get(key) or OmegaConf.select(config, key)
            if isinstance(space, CategoricalDistribution):
                value = text_of(value)
                inside = value in space.choices
            else:
                assert isinstance(space, FloatDistribution | IntDistribution)
                inside = isinstance(value, int | float) and space.low <= value <= space.high
            if not inside:
                return None
            values[name] = value
        return values


def space_of(overrides: Sequence[Override]) -> Space:
    """Sort the overrides of a search; raises ConfigurationError if none has several values."""
    searched: list[Override] = []
    seeds, fixed = ["seed=0"], list[str]()
    distributions: dict[str, BaseDistribution] = {}
    for override in overrides:
        key = override.get_key_element()
        sweeps = dict(nested_sweeps(override.value(), key))
        if key == "seed":
            seeds = values_of(override)
        elif not sweeps:
            fixed += values_of(override)
        else:
            searched.append(override)
            for name, sweep in sweeps.items():
                try:
                    distributions[name] = _distribution(override, sweep)
                except (ValueError, TypeError) as error:  # of Optuna
                    raise ConfigurationError(f"{name}: {' '.join(str(error).split())}") from error
    if not searched:
        raise ConfigurationError(
            "hydra/sweeper=optuna: got no option to search, expected one such as "
            "'controller.kp=[interval(50,200),550,940]' or identifier=ls,plsr"
        )
    return Space(tuple(searched), tuple(seeds), tuple(fixed), distributions)


def _distribution(override: Override, sweep: Sweep) -> BaseDistribution:
    """Return Optuna's distribution of a sweep; raises ValueError or TypeError for an empty one."""
    log = "log" in sweep.tags
    if isinstance(sweep, Glob):
        return CategoricalDistribution(list(override.sweep_string_iterator()))
    if isinstance(sweep, ChoiceSweep):
        return CategoricalDistribution(list(dict.fromkeys(map(text_of, sweep.list))))
    if isinstance(sweep, RangeSweep):  # its end is not one of its values
        values = sorted(sweep.range())
        if not values:
            raise ValueError("got no values, expected at least one")
        if all(isinstance(value, int) for value in values):
            return IntDistribution(int(values[0]), int(values[-1]), step=abs(int(sweep.step)))
        return FloatDistribution(float(values[0]), float(values[-1]), step=abs(float(sweep.step)))
    assert isinstance(sweep, IntervalSweep)
    low, high = sweep.start, sweep.end
    if isinstance(low, int) and isinstance(high, int):
        return IntDistribution(low, high, log=log)
    return FloatDistribution(float(low or 0.0), float(high or 0.0), log=log)


@dataclass(frozen=True)
class SearchOptions:
    """The options of a search, as conf/hydra/sweeper/optuna.yaml explains them."""

    metric: tuple[str, ...]
    dof: str | None
    stage: str | None
    model: str
    statistic: Literal["mean", "median", "min", "max"]
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

    def objectives(self) -> list[Objective]:
        """Return the objectives; raises ConfigurationError for what no trial stores."""
        own = (self.dof, self.stage, self.model, self.statistic, self.direction)
        return [objective_of(name, *own) for name in self.metric]

    @property
    def prunes(self) -> bool:
        """Whether candidates may be stopped early: Optuna's pruners know one objective."""
        return self.prune and len(self.metric) == 1

    def study(self) -> optuna.Study:
        """Return a new study; every loss is minimised."""
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        seed, startup = self.sampler_seed, self.startup
        return optuna.create_study(
            sampler=optuna.samplers.RandomSampler(seed=seed)
            if self.sampler == "random"
            else optuna.samplers.TPESampler(
                seed=seed, n_startup_trials=startup, constant_liar=self.batch > 1
            ),
            pruner=optuna.pruners.MedianPruner(startup, n_warmup_steps=1)
            if self.prunes
            else optuna.pruners.NopPruner(),
            directions=["minimize"] * len(self.metric),
        )
