"""The runs of a logbook in columns: their status, seed and factors, with one code a level."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sqlalchemy as sa

from seatrial.runner.compare.likeness import Likeness
from seatrial.runner.compare.results import (
    MOST_VARIABLES,
    RUN,
    Queries,
    StoredRun,
    level_text,
    ordered,
)
from seatrial.runner.compare.where import NAME
from seatrial.runner.record.vocabulary import GROUPS

MOST_KEYS = 200  # in one query
Json = Mapping[str, object]


@dataclass(frozen=True)
class Experiments:
    """Runs that differ in nothing but the seed, with one of them for each experiment."""

    of_run: Sequence[int]
    first: Sequence[StoredRun]

    @classmethod
    def of(cls, runs: Sequence[StoredRun], likeness: Likeness) -> "Experiments":
        """Return the experiments of some runs, in the order of their first run."""
        numbers: dict[str, int] = {}
        first: list[StoredRun] = []
        of_run = []
        for run in runs:
            name = likeness.experiment_of(run)
            if name not in numbers:
                numbers[name] = len(first)
                first.append(run)
            of_run.append(numbers[name])
        return cls(of_run, first)


def run_columns(results: Queries, runs: Sequence[StoredRun]) -> Json:
    """Return status and factors of runs."""
    likeness = Likeness(results, runs)
    experiments = Experiments.of(runs, likeness)
    return {
        "groups": GROUPS,
        "ids": [run.id for run in runs],
        "statuses": [run.status for run in runs],
        "experiments": experiments.of_run,
        "factors": [
            *(_run_factor(name, [r.levels[name] for r in runs]) for name in (*GROUPS, "seed")),
            _run_factor("code", [run.code or "none" for run in runs]),
            *_configured(results, experiments),
        ],
    }


def _run_factor(name: str, levels_of_runs: Sequence[str]) -> Json:
    """Return a factor that is a column of the table of runs, with one code for each run."""
    levels = ordered(levels_of_runs)
    places = {level: place for place, level in enumerate(levels)}
    kinds = [
        ["number" if name == "seed" else "null" if level == "none" and name == "code" else "text"]
        for level in levels
    ]
    codes = [places[level] for level in levels_of_runs]
    return {"name": name, "levels": levels, "kinds": kinds, "codes": codes, "offered": True}


def _configured(results: Queries, experiments: Experiments) -> list[Json]:
    """Return the keys of the configuration with several levels, by experiment.

    An `offered` factor is one that a command may name; `kinds` are the types of the values behind a
    level, which a condition must quote or not.
    """
    configs = results.configs_of([run.id for run in experiments.first])
    each = [configs[run.id] for run in experiments.first]
    names = [
        name
        for name in dict.fromkeys(name for config in each for name in config)
        if name not in results.names.columns and _varies([config.get(name) for config in each])
    ]
    texts = _level_texts(results, [run.id for run in experiments.first], names)
    return [
        _key_factor(name, texts[name], [config.get(name) for config in each])
        | {"offered": name in results.names.keys}
        for name in names
    ]


def _varies(values: Sequence[object]) -> bool:
    """Return whether values of a configuration differ, also in their types."""
    return any(type(v) is not type(values[0]) or v != values[0] for v in values)


def _level_texts(
    results: Queries, ids: Sequence[int], names: Sequence[str]
) -> dict[str, list[str]]:
    """Return the levels of keys as a table shows them: the database writes them, as for a table.

    A key that no condition can name is shown as JSON.
    """
    texts: dict[str, list[str]] = {name: [] for name in names}
    nameable = [name for name in names if NAME.fullmatch(name)]
    for start in range(0, len(ids), MOST_VARIABLES):
        part = ids[start : start + MOST_VARIABLES]
        for first in range(0, len(nameable), MOST_KEYS):
            keys = nameable[first : first + MOST_KEYS]
            query = sa.select(RUN.c.id, *map(results.names.text, keys)).where(RUN.c.id.in_(part))
            rows = {id_: levels for id_, *levels in map(tuple, results.reader.select(query))}
            for place, name in enumerate(keys):
                texts[name] += [level_text(rows[id_][place]) for id_ in part]
    configs = results.configs_of(ids) if len(nameable) < len(names) else {}
    for name in set(names) - set(nameable):
        texts[name] = [json.dumps(configs[id_].get(name)) for id_ in ids]
    return texts


def _key_factor(name: str, texts: Sequence[str], values: Sequence[object]) -> dict[str, object]:
    levels = ordered(texts)
    kinds: dict[str, set[str]] = {level: set() for level in levels}
    for text, value in zip(texts, values, strict=True):
        kinds[text].add(_kind(value))
    places = {level: place for place, level in enumerate(levels)}
    return {
        "name": name,
        "levels": levels,
        "kinds": [sorted(kinds[level]) for level in levels],
        "by_experiment": [places[text] for text in texts],
    }


def _kind(value: object) -> str:
    """Return how a condition writes a value."""
    if value is None:
        return "null"
    return "number" if isinstance(value, bool | int | float) else "text"
