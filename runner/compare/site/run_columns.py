"""The runs of a logbook in columns: their status, seed and factors, with one code a level."""

import json
from collections.abc import Mapping, Sequence

import pandas as pd
import sqlalchemy as sa

from seatrial.runner.compare.comparability import experiments
from seatrial.runner.compare.frame import MOST_VARIABLES, RUN, Queries, level_text, ordered
from seatrial.runner.compare.where import NAME
from seatrial.runner.vocabulary import GROUPS

MOST_KEYS = 200  # in one query
Json = Mapping[str, object]


def run_columns(results: Queries, trials: pd.DataFrame) -> Json:
    """Return status and factors of runs, and their experiments, which differ in the seed alone."""
    names = experiments(trials)
    first = names.index[~names.duplicated()].tolist()
    code = trials["of_code"].astype(object)
    return {
        "groups": GROUPS,
        "ids": trials.index.tolist(),
        "statuses": trials["status"].tolist(),
        "experiments": pd.factorize(names)[0].tolist(),
        "factors": [
            *(_run_factor(name, trials[name].tolist()) for name in (*GROUPS, "seed")),
            _run_factor("code", code.where(code.notna(), "none").tolist()),
            *_configured(results, first),
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


def _configured(results: Queries, first: Sequence[int]) -> list[Json]:
    """Return the keys of the configuration with several levels, by experiment.

    `first` is a run of each experiment. An `offered` factor is one that a command may name; `kinds`
    are the types of the values behind a level, which a condition must quote or not.
    """
    configs = results.configs_of(first)
    each = [configs[run] for run in first]
    names = [
        name
        for name in dict.fromkeys(name for config in each for name in config)
        if name not in results.names.columns and _varies([config.get(name) for config in each])
    ]
    texts = _level_texts(results, first, names)
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
