"""A sweep compiles before its workers start, each combination of kinds of parts once."""

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from seatrial.models import compiled
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials import precompile, trial
from seatrial.runner.trials.closed_loop import Streams, prepare
from tests.runner.programs import ROOT, sweep
from tests.trials import asked_for

DEFAULT = ("disturbance=noise", "identifier=ls", "evaluation=four_corner")
UPDATE = "+update={window_s: 9, every_s: 1, trigger: feedback, threshold: 0.5, lowpass_hz: null}"


@cache
def kinds(*overrides: str) -> tuple[str, ...]:
    return precompile.kinds(asked_for(*DEFAULT, *overrides))


@pytest.mark.parametrize(
    ("change", "same"),
    [
        (("seed=3", "sample_time_s=0.2", "excitation.interval_s=200"), (0, 1, 2, 3)),
        *((("identifier=ridge",), (0, 1, 3)), (("disturbance=[noise,wind]",), (1, 2, 3))),
        *((("excitation=prbs_waypoints",), (0, 2, 3)), (("evaluation=operation",), (0, 1, 2))),
        *((("controller=lqi",), (0,)), (("vessel=otter",), ()), ((UPDATE,), ())),
    ],
)
def test_kinds_of_parts_decide_what_is_compiled(change: tuple[str, ...], same: tuple[int]) -> None:
    before, after = kinds(), kinds(*change)
    assert tuple(i for i in range(4) if before[i] == after[i]) == same


def test_other_programs_are_not_run_before_the_workers() -> None:
    assert not kinds("identifier=command", "identifier.command=[fit]")


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Trial]:
    """The trials that are run, and fail; what is compiled is in a folder of its own."""
    runs: list[Trial] = []

    def run(trial: Trial) -> None:
        runs.append(trial)
        raise RuntimeError("as a trial may fail on few samples")

    monkeypatch.setattr(precompile.trials, "run", run)
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    return runs


def test_one_trial_of_each_kind_runs_once_on_a_machine(runs: list[Trial]) -> None:
    rows = (("seed=0",), ("seed=1",), ("identifier=ridge",), ("identifier=ridge", "seed=2"))
    planned = [(kinds(*row), lambda row=row: asked_for(*DEFAULT, *row)) for row in rows]
    precompile.precompile(planned)
    assert [trial.names["identifier"] for trial in runs] == ["ls", "ridge"]
    assert {trial.samples for trial in runs} == {precompile.SAMPLES}
    precompile.precompile([*planned, ((), lambda: pytest.fail("a part from elsewhere"))])
    assert len(runs) == 2


def test_few_samples_train_test_and_deploy() -> None:
    few = replace(asked_for(*DEFAULT), samples=50)
    excited = trial.excite(few, Streams(0))
    assert excited.training.sum() == excited.testing.sum() == 50
    assert len(excited.recording) > 1000
    model, mission = few.vessel.nominal(), few.evaluation
    assert len(prepare(few, Streams(0), model, mission, deployed=True).weather.pose_noise) == 50


# Python imports this module at its start, in workers as well.
SITE = """
import os
from seatrial.models import compiled
real = compiled._Cache.save_overload
def save_overload(self, sig, cres):
    with open(os.environ["NOTES"], "a") as file:
        print(os.getpid(), self._file(sig, cres.codegen), file=file)
    real(self, sig, cres)
compiled._Cache.save_overload = save_overload
"""


@pytest.mark.nightly
def test_workers_on_an_empty_cache_compile_nothing(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(SITE)
    notes = tmp_path / "notes"
    process = sweep(
        *("identifier=none,ls", "evaluation=none", "seed=0,1", "disturbance=noise"),
        *("hydra/launcher=processes", "hydra.launcher.n_jobs=4"), folder=tmp_path, NOTES=str(notes),
        PYTHONPATH=f"{tmp_path}{os.pathsep}{ROOT}", SEATRIAL_CACHE=str(tmp_path / "cache"),
    )  # fmt: skip
    out, err = process.communicate(timeout=1200)
    assert process.returncode == 0, err
    assert "4 finished" in out
    assert err.count("compiling simulation.loop._sail (first time on this machine)") == 1
    compilations = [line.split() for line in notes.read_text().splitlines()]
    assert len(compilations) > 20
    assert {pid for pid, _ in compilations} == {str(process.pid)}
    assert len({file for _, file in compilations}) == len(compilations)
