"""Like with like: which numbers a cell may pool, and what counts as a replicate.

The *circumstances* of a number are everything in its run that can change it, except the seed: the
options, the configuration and the code. What happens after a stage of the trial cannot change its
numbers, and neither the nominal model nor the plant depends on the identifier. Two numbers of equal
circumstances and equal seed are one experiment, stored twice. The seed counts only if one of the
random streams that the number depends on was drawn.
"""

import math
from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import cached_property
from math import fsum

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.results import OWN_FACTORS, Observation, Queries, StoredRun
from seatrial.runner.record.vocabulary import GROUPS, NOT_COMPARED

STORAGE = (*NOT_COMPARED, "metrics", "seed")
AFTER_VALIDATION = ("evaluation", "plant.change", "update")
WITHOUT_IDENTIFIER = ("mean_motion", "nominal", "plant")
MOST_SPLITS = 3
Circumstances = Mapping[str, str]


def within(key: str, names: Iterable[str]) -> bool:
    """Return whether a dotted key is one of the names, or lies below one of them."""
    return any(key == name or key.startswith(f"{name}.") for name in names)


def _ignored(observation: Observation) -> tuple[str, ...]:
    """Return the names that cannot change a number."""
    names: tuple[str, ...] = STORAGE
    if observation.stage != "deployment":
        names += AFTER_VALIDATION
    if observation.model in WITHOUT_IDENTIFIER:
        names += ("identifier",)
    return names


class Likeness:
    """The circumstances of the numbers of some runs."""

    def __init__(self, results: Queries, runs: Sequence[StoredRun]) -> None:
        self._results = results
        self._first: dict[str, StoredRun] = {}  # one run of each experiment
        for run in runs:
            self._first.setdefault(self.experiment_of(run), run)
        # The circumstances by experiment and ignored names, numbered by their content.
        self._known: dict[tuple[str, tuple[str, ...]], tuple[int, Circumstances]] = {}
        self._numbers: dict[frozenset[tuple[str, str]], int] = {}

    @staticmethod
    def experiment_of(run: StoredRun) -> str:
        """Return a name that is equal for runs that differ in nothing but the seed."""
        return run.experiment or f"run {run.id}"  # of runs of earlier versions it is not known

    @cached_property
    def _facts(self) -> Mapping[str, Circumstances]:
        """Options, configuration and code of every experiment."""
        runs = list(self._first.items())
        configs = self._results.configs_of([run.id for _, run in runs])
        return {
            name: {group: run.levels[group] for group in GROUPS}
            | {"code": run.code or "unknown"}
            | {key: str(value) for key, value in configs[run.id].items()}
            for name, run in runs
        }

    def of(self, observation: Observation) -> Circumstances:
        """Return the circumstances of a number, by name."""
        return self._numbered(observation)[1]

    def number(self, observation: Observation) -> int:
        """Return a number that is equal for numbers of equal circumstances."""
        return self._numbered(observation)[0]

    def _numbered(self, observation: Observation) -> tuple[int, Circumstances]:
        ignored = _ignored(observation)
        key = self.experiment_of(observation.run), ignored
        if key not in self._known:
            facts = {
                name: level for name, level in self._facts[key[0]].items()
                if not within(name, ignored)
            }  # fmt: skip
            number = self._numbers.setdefault(frozenset(facts.items()), len(self._numbers))
            self._known[key] = number, facts
        return self._known[key]

    def seed(self, observation: Observation) -> str | None:
        """Return the seed of a number; None if the number does not depend on it."""
        drawn = observation.run.drawn
        if drawn is None:
            return observation.run.levels["seed"]
        if observation.model in WITHOUT_IDENTIFIER:
            drawn = drawn - {"identifier"}
        return observation.run.levels["seed"] if drawn else None

    def experiment(self, observation: Observation) -> Hashable:
        """Return a key that is equal for numbers of one experiment."""
        own = tuple(observation.level(factor) for factor in OWN_FACTORS)
        return self.number(observation), self.seed(observation), own

    def distinct(self, observations: Iterable[Observation]) -> list[Observation]:
        """Return one number of every experiment, the newest, in the order of the first."""
        newest = {self.experiment(observation): observation for observation in observations}
        return list(newest.values())


def differing(
    likeness: Likeness, cells: Mapping[Hashable, Sequence[Observation]], pooled: Sequence[str] = ()
) -> list[str]:
    """Return the factors that make every cell alike if they become factors of the table.

    `pooled` are the names that cells may average over, with all that lies below them. Options of a
    group come before the keys of the configuration, so that keys that follow from an option are
    not named.
    """
    groups: dict[Hashable, dict[int, Circumstances]] = defaultdict(dict)
    for cell, observations in cells.items():
        for observation in observations:
            circumstances = likeness.of(observation)
            hidden = tuple(
                (key, level) for key, level in circumstances.items() if within(key, pooled)
            )
            members = groups[cell, hidden if pooled else ()]
            members.setdefault(likeness.number(observation), circumstances)
    factors: list[str] = []
    parts = [list(members.values()) for members in groups.values() if len(members) > 1]
    names = dict.fromkeys(key for part in parts for member in part for key in member)
    for name in [*GROUPS, *(key for key in names if key not in GROUPS)]:
        if not parts:
            break
        split = [_split(part, name) for part in parts]
        if any(len(levels) > 1 for levels in split):
            factors.append(name)
            parts = [part for levels in split for part in levels if len(part) > 1]
    return factors


def _split(part: Sequence[Circumstances], name: str) -> list[list[Circumstances]]:
    """Return the members of a part by their level of a name."""
    levels: dict[str | None, list[Circumstances]] = defaultdict(list)
    for member in part:
        levels[member.get(name)].append(member)
    return list(levels.values())


class TooDifferentError(ConfigurationError):
    """Runs differ in too many factors for one table or figure."""


def require_few(factors: Sequence[str], what: str) -> None:
    """Raise TooDifferentError if the runs differ in too many factors to be told apart."""
    if len(factors) > MOST_SPLITS:
        names = ", ".join(factors[:8]) + (", ..." if len(factors) > 8 else "")
        raise TooDifferentError(
            f"{what} would average over {names}: name them in --rows or --columns, select by"
            f" --where or --sweep, or say --pool {','.join(factors[:8])}"
        )


class Counterparts:
    """The numbers of a baseline, found for each number of another cell.

    `baseline` maps the factors that the baseline fixes to their levels; `named` are the other
    factors of the table.
    """

    def __init__(
        self,
        observations: Iterable[Observation],
        baseline: Mapping[str, str],
        likeness: Likeness,
        named: Sequence[str],
    ) -> None:
        self._baseline, self._likeness = baseline, likeness
        self._fixed = tuple(name for name in baseline if name not in OWN_FACTORS)
        self._named = tuple(name for name in named if within(name, self._fixed))
        self._references: dict[Hashable, list[Observation]] = defaultdict(list)
        for observation in observations:
            value = math.nan if observation.value is None else observation.value
            if self.is_reference(observation) and math.isfinite(value):
                self._references[self._shared(observation)].append(observation)

    def is_reference(self, observation: Observation) -> bool:
        """Return whether a number belongs to the baseline."""
        return all(observation.level(name) == level for name, level in self._baseline.items())

    def pairs(self, observations: Iterable[Observation]) -> dict[str | None, tuple[float, float]]:
        """Return numbers beside those of their counterparts, averaged within each seed.

        None is the seed of pairs that depend on none.
        """
        pairs: dict[str | None, dict[Hashable, tuple[float, float]]] = defaultdict(dict)
        for observation in observations:
            for reference in self._of(observation):
                if observation.value is not None and reference.value is not None:
                    experiments = tuple(map(self._likeness.experiment, (observation, reference)))
                    seed = self._likeness.seed(observation) or self._likeness.seed(reference)
                    pairs[seed][experiments] = observation.value, reference.value
        return {
            seed: (fsum(own for own, _ in both) / len(both), fsum(r for _, r in both) / len(both))
            for seed, by_experiment in pairs.items()
            for both in [by_experiment.values()]
        }

    def seeds(self, observations: Iterable[Observation]) -> set[str | None]:
        """Return the seeds of the baseline's numbers under the circumstances of some numbers."""
        return {
            self._likeness.seed(reference)
            for o in observations
            for reference in self._alike(o, self._references.get(self._shared(o), []))
        }

    def _shared(self, observation: Observation) -> Hashable:
        """Return what a number and its counterpart have in common, except the seed."""
        own = tuple(observation.level(name) for name in OWN_FACTORS if name not in self._baseline)
        ignored = self._fixed if "model" not in self._baseline else (*self._fixed, "identifier")
        facts = self._likeness.of(observation).items()
        return own, frozenset(fact for fact in facts if not within(fact[0], ignored))

    def _of(self, observation: Observation) -> list[Observation]:
        """Return the counterparts of a number: of its seed, if both depend on a seed."""
        candidates = self._references.get(self._shared(observation), [])
        seed = self._likeness.seed(observation)
        return [
            candidate
            for candidate in self._alike(observation, candidates)
            if seed is None or self._likeness.seed(candidate) in (None, seed)
        ]

    def _alike(
        self, observation: Observation, candidates: Sequence[Observation]
    ) -> list[Observation]:
        """Return the candidates with the levels that the table names or that they differ in."""
        if not candidates:
            return []
        own = self._likeness.of(observation)
        each = [self._likeness.of(candidate) for candidate in candidates]
        names = dict.fromkeys(key for facts in each for key in facts if within(key, self._fixed))
        decisive = [
            name
            for name in names
            if name not in self._baseline
            and (name in self._named or len({facts.get(name) for facts in each}) > 1)
        ]
        return [
            candidate
            for candidate, facts in zip(candidates, each, strict=True)
            if all(own.get(name) == facts.get(name) for name in decisive)
        ]
