"""The command line called inside the tests' process, with a trial that takes no time."""

import logging
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.runner.configuration.config import Trial
from seatrial.runner.configuration.fingerprint import collect
from seatrial.runner.record.rows import Metric, Results
from seatrial.runner.trials import trial as trials
from seatrial.runner.trials.trial import TrialDiverged


@dataclass(frozen=True)
class Answer:
    """What a command left behind."""

    code: int
    out: str
    err: str


@dataclass
class FakeTrial:
    """Stands in for seatrial.runner.trials.trial: what happens depends on the seed.

    A check does not depend on the seed; it refuses scales of the plant.
    """

    failing: set[int] = field(default_factory=set)
    diverging: set[int] = field(default_factory=set)
    refused: set[float] = field(default_factory=set)
    interrupted: set[int] = field(default_factory=set)
    ran: list[int] = field(default_factory=list)

    def check(self, trial: Trial) -> None:
        if trial.plant.scale in self.refused:
            raise ConfigurationError(f"plant.scale: {trial.plant.scale:g} is not seaworthy")

    def run(self, trial: Trial) -> Results:
        self.ran.append(trial.seed)
        metric = Metric("validation", "identified", "surge", "force_mse", float(trial.seed), "N^2")
        results = Results(metrics=[metric])
        if trial.seed in self.interrupted:
            raise KeyboardInterrupt
        if trial.seed in self.failing:
            raise ZeroDivisionError(f"seed {trial.seed}\nran aground")
        if trial.seed in self.diverging:
            error = Diverged("|r| = 11 rad/s exceeds 10 at t = 3.0 s", 3.0, "r")
            raise TrialDiverged(error, results)
        return results


class Command:
    """Calls `python -m runner` in a folder of its own."""

    def __init__(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        self.folder = folder
        self.fake = FakeTrial()
        self._monkeypatch = monkeypatch
        self._capsys = capsys
        monkeypatch.chdir(folder)
        monkeypatch.delenv("HYDRA_FULL_ERROR", raising=False)

    def pretend(self) -> FakeTrial:
        """From here on trials take no time."""
        self._monkeypatch.setattr(trials, "check", self.fake.check)
        self._monkeypatch.setattr(trials, "run", self.fake.run)
        return self.fake

    def __call__(self, *arguments: str) -> Answer:
        from seatrial.runner.__main__ import main

        self._capsys.readouterr()
        collect.cache_clear()
        with self._monkeypatch.context() as patch, logging_kept():
            patch.setattr(sys, "argv", ["seatrial", *arguments])
            patch.setattr(sys, "orig_argv", ["python", "-m", "runner", *arguments])
            try:
                code = main()
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else 0
        said = self._capsys.readouterr()
        return Answer(code, said.out, said.err)

    def succeeds(self, *arguments: str) -> Answer:
        """The answer of a command that ends with exit code 0."""
        answer = self(*arguments)
        assert answer.code == 0, answer
        return answer

    def refuses(self, *arguments: str) -> str:
        """The one line of a command that is refused, which must leave the folder as it was."""
        before = sorted(self.folder.rglob("*"))
        answer = self(*arguments)
        assert answer.code == 2, answer
        assert answer.out == ""
        assert answer.err.startswith("seatrial: ")
        assert answer.err.count("\n") == 1, answer.err
        assert sorted(self.folder.rglob("*")) == before
        return answer.err.removeprefix("seatrial: ").rstrip("\n")

    def reasons(self, variants: Iterable[str], *arguments: str) -> list[str]:
        """Why a dry run of a sweep refuses each of its variants."""
        words = [word for variant in variants for word in ("--variant", variant)]
        lines = self.succeeds("-m", *words, *arguments, "dry_run=true").out.splitlines()[:-1]
        assert {line.split()[0] for line in lines} == {"refused"}, lines
        return [line.split("  ")[-1].strip() for line in lines]


@contextmanager
def logging_kept() -> Iterator[None]:
    """Undo what Hydra does to the logging of the whole process."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        yield
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)
