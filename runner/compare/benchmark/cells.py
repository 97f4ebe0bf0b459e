"""Cells of the benchmark: what an entrant does in a case of a task, as options of a trial."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.benchmark.task import MAPS, Case, Located, Task, located


@dataclass(frozen=True)
class BenchmarkTrial:
    """One trial of the benchmark; `options` are all that its command gives."""

    task: str
    case: str
    entrant: str
    seed: int
    options: tuple[str, ...]


@dataclass(frozen=True)
class Lacking:
    """A case whose files are not all there, each as it was found."""

    case: str
    files: tuple[Located, ...]


def entrants_of(task: Task, chosen: Sequence[str] = ()) -> Mapping[str, tuple[str, ...]]:
    """Return the options of the chosen entrants, by default all of the task.

    One that the task does not name is an option of the group `identifier`, such as one's own.
    """
    if not chosen:
        return task.entrants
    return {name: task.entrants.get(name, (f"identifier={name}",)) for name in chosen}


def cells(
    name: str, task: Task, entrants: Mapping[str, tuple[str, ...]]
) -> Iterator[BenchmarkTrial]:
    """Yield the cells of a task, entrant by entrant, of those cases whose files are there."""
    files = {file.name: file for file in located(task)}
    absent = {lack.case for lack in lacking(task)}
    maps = {"map": task.map, "test_map": task.test_map}
    mapped = [f"excitation.{key}={MAPS / file}" for key, file in maps.items() if file is not None]
    for entrant, options in entrants.items():
        for label, case in task.cases.items():
            if label in absent:
                continue
            given = (
                *(*task.trial, *mapped, *case.options, *_recordings(task, case, files), *options),
                f"horizons_s={list(task.horizons_s)}",
            )
            for seed in range(case.seeds or task.seeds):
                # The last option of a key counts: an entrant may replace one of the task.
                last = {option.partition("=")[0]: option for option in (*given, f"seed={seed}")}
                yield BenchmarkTrial(name, label, entrant, seed, tuple(last.values()))


def lacking(task: Task) -> list[Lacking]:
    """Return the cases whose files are missing or damaged."""
    files = {file.name: file for file in located(task)}
    found = []
    for label, case in task.cases.items():
        own = [files[part] for path in case.files for part in task.parts(path)]
        if wrong := tuple(file for file in own if file.state != "found"):
            found.append(Lacking(label, wrong))
    return found


def _recordings(task: Task, case: Case, files: Mapping[str, Located]) -> Iterator[str]:
    for key, names in (("train", case.train), ("test", case.test)):
        if names:
            parts = [(name, task.parts(name)[0]) for name in names]
            paths = [str(files[part].path).removesuffix(part) + name for name, part in parts]
            if any(set(path) & set("'\"\\") for path in paths):
                raise ConfigurationError(f"{paths[0]}: got a quote or backslash in a path of data")
            yield f"excitation.{key}={json.dumps(paths)}"
