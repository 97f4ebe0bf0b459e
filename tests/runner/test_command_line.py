"""Wrong commands are refused in one line; exit codes say what became of the right ones."""

import os
import re
import sys
import tomllib
from pathlib import Path

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.database import LogbookWriter
from tests.runner.command import Command
from tests.runner.programs import ROOT, completed, ended, program

REFUSED = {
    "sample_time_s=-1": "sample_time_s must be positive, got -1",
    "plant.scale=0": "plant.scale must be positive, got 0",
    "seed=": "seed: got '', expected an integer",
    "seed=1,2": "seed=1,2: several values, expected one (a sweep needs -m)",
    "seed": "'seed' cannot be read, expected seed=...",
    "=ls": "got '=ls', expected option=value",
    "~": "got '~', expected option=value",
    "seed=${nowhere}": "seed: got ${nowhere}, which is no option",
    "+seed=2": "+seed: the option exists already, write seed=...",
    "~seed": "seed is missing",
    "~vessel": "vessel: got none, expected an option of the group",
    "bogus=1": "bogus: unknown option, see python -m runner --cfg job",
    "identifer=ls": "identifer: unknown option, did you mean identifier?",
    "vessel=null": "vessel: got null, expected one of ",
    "vessel={name: tug}": "vessel: got a name without _target_, expected vessel=tug, or ",
    "vessel=[1,2]": "vessel: got [1,2], expected one of ",
    "vessel=./tug.yaml": "vessel: there is no file ./tug.yaml",
    "disturbance.wind.speed=5": "disturbance.wind.speed: unknown option, disturbance as it is ",
    "limits.memory.most=5": "limits.memory.most: unknown option, memory as it is chosen has no ",
    "identifier={basis: linear}": "identifier.basis: unknown option, expected one of candidates, ",
    "vessel=miliampere": "vessel: no option 'miliampere', did you mean milliampere? expected",
    "hydra/launcher=nope": "hydra/launcher: no option 'nope', expected one of basic, processes",
    "identifier=grid": "identifier=grid is gone: in a checkout, use --config-dir docs/published ",
    "experiment=hoyer_figure_7_20": "experiment=hoyer_figure_7_20 is gone: in a checkout, use ",
    "excitation.believed.error=0.1": "excitation.believed is gone: use excitation.nominal",
    "excitation.differentiation.window=5": "excitation.differentiation is gone: velocities are ",
    "identifier.horizon_s=abc": "identifier.horizon_s: got 'abc', expected a number",
    "+identifier.zzz=1": "identifier.zzz: unknown option, expected one of ",
    "identifier._target_=os.system": "identifier._target_: got 'os.system', which is not a",
    "database=postgresql": "SEATRIAL_DATABASE is not set; expected postgresql://",
    "database.url=mysql://a/b": "database.url: unknown database dialect 'mysql' in mysql://a/b; ",
    "database.url=results.db": "database.url is not a database URL: got 'results.db'; ",
    "--config-dir": "--config-dir: expected a value",
    "--config-dir=nowhere": "--config-dir: got ",
    "--cfg=jobb": "--cfg: got jobb, expected one of 'job', 'hydra', 'all'",
    "identifier.candidates=[ls]": "identifier.candidates: got [ls], which cannot replace its ",
    "version": "'version' cannot be read, did you mean python -m runner --version?",
    "--bogus": "unknown flag --bogus, see --help",
    "--vessel=tug": "unknown flag --vessel=tug, did you mean vessel=tug?",
    "--show-completion": "unknown flag --show-completion, did you mean --shell-completion?",
    "--seed=3": "unknown flag --seed=3, did you mean seed=3?",
    "--experiment=x": "unknown flag --experiment=x, did you mean experiment=x?",
    "sweep": "'sweep' cannot be read, did you mean python -m runner -m option=a,b ...?",
    "kvlc2": "'kvlc2' cannot be read, did you mean vessel=kvlcc2?",
    "vessels": "'vessels' cannot be read, expected vessel=NAME; python -m runner --help lists",
    "run": "'run' cannot be read, did you mean python -m runner option=value ...?",
    "list": "'list' cannot be read, did you mean python -m runner.compare runs?",
    "tabel": "'tabel' cannot be read, did you mean python -m runner.compare table?",
    "doctor": "doctor is gone: pip check examines the packages; ",
    "benchmrk": "'benchmrk' cannot be read, did you mean python -m runner benchmark?",
    "--config-name=nope": "--config-name: got 'nope', expected a file",
    "--resolve": "--resolve: expected --cfg or --help as well",
    "--experimental-rerun=x": "--experimental-rerun: see python -m runner.compare show RUN --comm",
    "identifier=[ls,iv]": "identifier: got [ls,iv], expected one; a sweep has several: -m ident",
}


IN_A_SWEEP = (
    "plant.scale=0", "vessel={name: tug}", "seed=${nowhere}", "~seed", "vessel=null",
    "identifier.horizon_s=abc", "database=postgresql",
)  # fmt: skip


@pytest.mark.slow
def test_a_wrong_argument_is_refused(seatrial: Command, subtests: pytest.Subtests) -> None:
    fake = seatrial.pretend()
    for argument, message in REFUSED.items():
        with subtests.test(argument):
            assert seatrial.refuses(argument).startswith(message)
    for argument in IN_A_SWEEP:
        with subtests.test(argument, sweep=True):
            said = seatrial.refuses("-m", "disturbance=calm,noise", argument)
            assert REFUSED[argument] in said
    assert fake.ran == []


def test_a_name_that_is_gone_may_be_used_again(seatrial: Command) -> None:
    folder = seatrial.folder / "own" / "identifier"
    folder.mkdir(parents=True)
    (folder / "sparse.yaml").write_text("_target_: seatrial.models.identification.robust.Robust\n")
    shown = seatrial("--config-dir", "own", "identifier=sparse", "--cfg", "job")
    assert (shown.code, shown.err) == (0, "")
    assert "Robust" in shown.out


def test_without_a_word_it_says_what_it_is_and_runs_nothing(seatrial: Command) -> None:
    fake, answer = seatrial.pretend(), seatrial()
    assert (answer.code, answer.err, fake.ran) == (0, "", [])
    assert list(seatrial.folder.iterdir()) == []
    shown = re.findall(r"^  python -m (runner\S*)", answer.out, re.MULTILINE)
    assert shown == ["runner", "runner", "runner.compare"]


def test_a_sample_time_whose_powers_are_no_numbers(seatrial: Command) -> None:
    """Some vessels derive weights from it before it is compared with the mission."""
    for seconds in (1e300, 1e-300):
        said = seatrial.refuses("vessel=blueboat", f"sample_time_s={seconds!r}")
        assert said.startswith("sample_time_s must be at ")


def test_a_flag_may_stand_in_the_midst_of_options(seatrial: Command) -> None:
    answer = seatrial("seed=1", "-m", "identifier=ls,none", "dry_run=true")
    assert "2 trials: 2 new" in answer.out
    assert seatrial.refuses("seed=1", "--vessel", "tug") == (
        "unknown flag --vessel, did you mean vessel=tug?"
    )


def test_a_trial_is_run_once(seatrial: Command) -> None:
    fake = seatrial.pretend()
    first = seatrial("seed=5")
    assert (first.code, fake.ran) == (0, [5])
    assert first.out.startswith("run 1 finished; see python -m runner.compare show 1")
    again = seatrial("seed=5")
    assert (again.code, fake.ran) == (0, [5])
    assert "already in the logbook as run 1" in again.out
    assert seatrial("seed=5", "rerun=true").out.startswith("run 2 finished")
    assert fake.ran == [5, 5]


def test_what_is_stored_of_a_run(seatrial: Command) -> None:
    seatrial.pretend()
    seatrial("seed=5", "identifier=none", "database.url=sqlite:///${results_dir}/results.db")
    with LogbookWriter.read("sqlite:///results/results.db") as logbook:
        run = logbook.run(1)
        (metric,) = logbook.metrics(1)
    assert run.summary.status == "finished"
    assert (run.summary.identifier, run.summary.vessel) == ("none", "milliampere")
    assert run.config["seed"] == 5
    assert "database" not in run.config
    assert run.overrides[:2] == ["seed=5", "identifier=none"]
    assert run.command is not None
    assert run.command.startswith("python -m runner seed=5 identifier=none")
    assert {"python", "cpus", "numpy", "hydra-core"} <= run.versions.keys()
    assert (metric.name, metric.value, metric.unit) == ("force_mse", 5.0, "N^2")


def test_a_failed_trial(seatrial: Command) -> None:
    seatrial.pretend().failing = {3}
    answer = seatrial("seed=3")
    assert answer.code == 1
    line = "seatrial: run 1 failed: ZeroDivisionError: seed 3 ran aground; see python -m runner."
    assert answer.err.startswith(line)
    assert answer.err.count("\n") == 1
    with LogbookWriter.read("sqlite:///results/results.db") as logbook:
        run = logbook.run(1)
    assert (run.summary.status, run.summary.error_type) == ("failed", "ZeroDivisionError")
    assert run.traceback is not None
    assert "command.py" in run.traceback


def test_a_diverged_trial_keeps_what_still_holds(seatrial: Command) -> None:
    seatrial.pretend().diverging = {3}
    answer = seatrial("seed=3")
    assert answer.code == 1
    assert "run 1 diverged: Diverged: |r| = 11 rad/s" in answer.err
    with LogbookWriter.read("sqlite:///results/results.db") as logbook:
        assert logbook.run(1).summary.status == "diverged"
        assert len(logbook.metrics(1)) == 1


def test_full_error_keeps_the_traceback(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    seatrial.pretend()
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    with pytest.raises(ConfigurationError, match="seed must not be negative"):
        seatrial("seed=-1")
    assert os.environ["HYDRA_FULL_ERROR"] == "1"


def test_a_reader_that_stops_reading_is_no_error() -> None:
    line = f"{sys.executable} -m runner --help | head -1"
    done = completed("bash", "-o", "pipefail", "-c", line)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("seatrial: ")


def test_looking_around_imports_nothing_heavy(tmp_path: Path) -> None:
    heavy = "numpy|numba|scipy|sklearn|sqlalchemy|pyarrow|matplotlib|pandas|rich|joblib"
    code = (
        "import os, sys\n"
        "from seatrial.runner.__main__ import main\n"
        "os.environ |= {'COMP_LINE': 'seatrial vess', 'COMP_POINT': '13'}\n"
        "for words in (['--help'], ['-sc', 'query=bash'], ['--hydra-help'], ['--version']):\n"
        "    sys.argv = ['seatrial', *words]\n"
        "    try:\n        assert not main(), words\n"
        "    except SystemExit as end:\n        assert not end.code, words\n"
        "print({name.partition('.')[0] for name in sys.modules}, file=sys.stderr)\n"
    )
    status, _, said = ended(program("-c", code, folder=tmp_path))
    assert status == 0, said
    assert re.search(rf"'({heavy})'", said) is None, said
    assert "'hydra'" in said


def test_planning_imports_what_it_needs(tmp_path: Path) -> None:
    """These take a second together: a stored trial asked again needs none of them."""
    code = (
        "import sys\n"
        "from seatrial.runner.__main__ import main\n"
        "sys.argv = ['seatrial', 'disturbance=noise', 'identifier=ls', 'dry_run=true']\n"
        "assert main() == 0\n"
        "heavy = {'scipy.signal', 'scipy.stats', 'sklearn', 'pymoo', 'matplotlib'}\n"
        "sys.exit(str(found) if (found := heavy & set(sys.modules)) else 0)\n"
    )
    status, _, said = ended(program("-c", code, folder=tmp_path))
    assert status == 0, said


WITHOUT = """
import importlib.machinery, runpy, sys
find = importlib.machinery.PathFinder.find_spec
hidden = set(sys.argv.pop(1).split(","))
importlib.machinery.PathFinder.find_spec = staticmethod(
    lambda name, *rest: None if name.partition(".")[0] in hidden else find(name, *rest)
)
runpy.run_module("seatrial.runner", run_name="__main__")
"""


@pytest.mark.slow
def test_it_runs_without_the_packages_of_its_extras() -> None:
    """As pip install seatrial has it: what the extras bring is neither needed nor looked for."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        extras = tomllib.load(file)["project"]["optional-dependencies"]
    own = ("docs", "test", "bench", "check")  # for developers
    packages = {
        re.split(r"[\[><=]", text)[0].replace("-", "_")
        for extra, texts in extras.items()
        if extra not in own
        for text in texts
    }
    words = ("vessel=surge_linear", "identifier=ls", "dry_run=true")
    answer = completed(sys.executable, "-c", WITHOUT, ",".join(packages), *words)
    assert answer.returncode == 0, answer.stderr
    assert {"optuna", "casadi"} <= packages
    words = ("controller=nmpc", "dry_run=true")
    answer = completed(sys.executable, "-c", WITHOUT, ",".join(packages), *words)
    assert "is not installed: pip install 'seatrial[nmpc]'" in answer.stderr
