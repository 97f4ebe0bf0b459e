"""A task of the benchmark: where its data come from, its trials, and what is scored.

A task is a file of `conf/benchmark`. It ships no data: it names their source, how to get them, and
the SHA-256 of each file. A file is looked for in SEATRIAL_DATA, then in DATA_FOLDER.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Literal, NamedTuple

import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration import options, search_path

GROUP = "benchmark"
VARIABLE = "SEATRIAL_DATA"
MAPS = search_path.CONF / GROUP / "maps"  # of columns
DATA_FOLDER = Path("~/.local/share/seatrial")


@dataclass(frozen=True)
class Case:
    """What is trained and tested on: files relative to the folder of data, or further options."""

    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    seeds: int | None = None  # null: as many as the task has; 1 where nothing is random


@dataclass(frozen=True)
class Task:
    """A task; its trials have the options `trial` and those of a case and an entrant.

    `outputs` are the degrees of freedom whose velocities are scored, `horizons_s` [s] the times
    over which predictions are scored beside the free run. The loss is that of `score`: of the free
    run; of the velocities (`restarts`) or of the position at the last horizon after every measured
    state, where free runs are chaotic. `entrants` are those of this task alone.
    """

    name: str
    title: str
    trial: tuple[str, ...]
    cases: dict[str, Case]
    outputs: tuple[Literal["surge", "sway", "heave", "roll", "pitch", "yaw"], ...]
    # Of the data: name, url, licence, and how to get them; none of a simulated task.
    source: dict[str, str] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)  # SHA-256 by path
    map: str | None = None  # of the columns, a file of the folder `maps` beside the task
    test_map: str | None = None  # of the files that are tested on, where it is another one
    seeds: int = 1
    horizons_s: tuple[float, ...] = (1.0, 10.0, 60.0)
    score: Literal["free_run", "restarts", "position"] = "free_run"
    entrants: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, case in self.cases.items():
            for path in (*case.train, *case.test):
                if not self.parts(path):
                    raise ConfigurationError(f"cases.{name}: {path} has no SHA-256 under `files`")

    def parts(self, *paths: str) -> list[str]:
        """The files of recordings: themselves, or those that are listed of a folder."""
        each = ((file, path) for path in paths for file in self.files)
        return [file for file, path in each if file == path or file.startswith(f"{path}/")]


class Located(NamedTuple):
    """A file of a task: in which folder of data it is, or is expected."""

    name: str
    folder: Path
    state: Literal["found", "damaged", "missing"]


class BenchmarkTrial(NamedTuple):
    """One trial of the benchmark; `options` are all that its command gives."""

    task: str
    case: str
    seed: int
    entrant: str
    options: tuple[str, ...]
    lacking: tuple[Located, ...]  # of its files, those that are missing or damaged


def task_of(name: str) -> Task:
    """Read a task; raises ConfigurationError for an unknown one or a file that is none."""
    names = search_path.options(GROUP)
    if name not in names:
        raise ConfigurationError(f"--task: got {name!r}, expected one of {', '.join(names)}")
    folders = (search_path.CONF, *search_path.user_folders())
    path = next(filter(Path.is_file, (folder / GROUP / f"{name}.yaml" for folder in folders)))
    try:
        node = {**yaml.safe_load(path.read_text(encoding="utf-8")), "name": name}
        task = options.part(Task, node)
    except (yaml.YAMLError, UnicodeDecodeError, TypeError) as error:  # not a mapping
        raise ConfigurationError(f"{path}: {' '.join(str(error).split())}") from error
    except options.OptionError as error:
        raise ConfigurationError(error.at(f"{GROUP}/{name}")) from error
    assert isinstance(task, Task)
    return task


def located(task: Task) -> list[Located]:
    """Where the files of a task are, each verified by its SHA-256."""
    folders = [Path(text).expanduser() for text in (os.environ.get(VARIABLE), DATA_FOLDER) if text]
    files = []
    for name, digest in task.files.items():
        holding = [folder for folder in folders if (folder / name).is_file()]
        if not holding:
            files.append(Located(name, folders[0], "missing"))
            continue
        same = hashlib.sha256((holding[0] / name).read_bytes()).hexdigest() == digest
        files.append(Located(name, holding[0], "found" if same else "damaged"))
    return files


def cells(task: Task, entrants: Sequence[str] = ()) -> Iterator[BenchmarkTrial]:
    """Yield the cells of a task, entrant by entrant.

    An entrant that the task does not name is an option of the group `identifier`, such as one's
    own; by default they are all of the task.
    """
    files, maps = {file.name: file for file in located(task)}, ("map", "test_map")
    columns = [f"excitation.{key}={MAPS / file}" for key in maps if (file := getattr(task, key))]
    names = dict.fromkeys(entrants or task.entrants)
    for entrant, (label, case) in product(names, task.cases.items()):
        needed = [files[part] for part in task.parts(*case.train, *case.test)]
        lacking = tuple(file for file in needed if file.state != "found")
        texts = [*task.trial, *columns, *case.options]
        for key, paths in (("train", case.train), ("test", case.test)):
            of_case = [str(files[task.parts(path)[0]].folder / path) for path in paths]
            texts += [f"excitation.{key}={json.dumps(of_case)}"] if of_case else []
        texts += task.entrants.get(entrant, (f"identifier={entrant}",))
        texts.append(f"horizons_s={list(task.horizons_s)}")
        for seed in range(case.seeds or task.seeds):
            # The last option of a key counts: an entrant may replace one of the task.
            last = {text.partition("=")[0]: text for text in (*texts, f"seed={seed}")}
            yield BenchmarkTrial(task.name, label, seed, entrant, (*last.values(),), lacking)
