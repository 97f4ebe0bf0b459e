"""The options of a search, and the study of Optuna that they describe."""

from dataclasses import dataclass
from typing import Literal

import optuna

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegativeInt, PositiveInt, check_ranges
from seatrial.runner.compare.search_candidates import Objective, objective_of

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
