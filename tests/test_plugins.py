"""docs/howto/plugins.md, done as a new user would: its files and commands in an empty folder."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.runner.programs import ROOT, completed, rows

FILE = re.compile(
    r"^```(?:python|yaml|octave)\n[#%] ([\w/]+\.(?:py|yaml|m))\n(.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
SURGE = (
    *("vessel=surge_linear", "excitation=prbs", "controller=none", "evaluation=none"),
    "plant.scale=0.6",
)
NOTE = "over ground, of the true motion"
SHORT = ("excitation.interval_s=5", "identifier=none")


def written(folder: Path, page: str = "docs/howto/plugins.md", count: int = 8) -> Path:
    """The files of a page, in a folder."""
    files = FILE.findall((ROOT / page).read_text())
    assert len(files) == count
    for name, text in files:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def call(folder: Path, *command: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """`python -m COMMAND` in a folder that holds nothing of the project."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])  # of `python`
    own = {"PYTHONPATH": str(ROOT), "COLUMNS": "200", "PATH": path}
    return completed(sys.executable, "-m", *command, folder=folder, **own | variables)


def run(folder: Path, *command: str, **variables: str) -> str:
    done = call(folder, *command, **variables)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_init_writes_an_identifier_and_a_test_that_pass(tmp_path: Path) -> None:
    out = run(tmp_path, "seatrial.runner", "init", "plugin", "my_fit")
    for name in ("my_fit.py", "conf/identifier/my_fit.yaml", "test_my_fit.py"):
        assert f"wrote {name}" in out
    out = run(tmp_path, "pytest", "-q", "-p", "no:cacheprovider", "test_my_fit.py")
    assert "3 passed" in out
    run(tmp_path, "seatrial.runner", *SURGE, "identifier=my_fit")
    assert rows(tmp_path, "select identifier, status from run") == [("my_fit", "finished")]
    true, found = (
        dict(rows(tmp_path, f"select term, value from coefficient where model = '{model}'"))
        for model in ("plant", "identified")
    )
    assert found == pytest.approx(true, rel=1e-4)


@pytest.mark.slow
def test_a_controller_in_python_runs_beside_a_compiled_one(tmp_path: Path) -> None:
    folder = written(tmp_path)
    done = call(folder, "seatrial.runner", "-m", *SHORT, "controller=pd_python,pid_ff")
    assert done.returncode == 0, done.stderr
    assert "2 runs: 2 finished" in done.stdout
    (line,) = [line for line in done.stderr.splitlines() if "not compiled" in line]
    assert "controller pd_python.Pd: its step is Python" in line


@pytest.mark.nightly
def test_a_metric_and_a_figure_appear_in_tables_and_plots(tmp_path: Path) -> None:
    folder, named = written(tmp_path), {"SEATRIAL_PLUGINS": "speeds,speed_figure"}
    run(folder, "seatrial.runner", *SHORT, "metrics=[{_target_: speeds.LargestSpeed}]")
    assert "speed_max" not in run(folder, "seatrial.runner.compare", "metrics")
    commands = ("metrics", "table --metric speed_max", "plot --help", "plot speeds")
    (folder / "all.py").write_text(
        "from seatrial.runner.compare.__main__ import run\n"
        f"for words in {commands}:\n    print('#' * 9)\n    assert run(words.split()) == 0\n"
    )
    _, metrics, table, shown, files = run(folder, "all", **named).split("#########\n")
    assert "speed_max" in metrics
    assert "speed_max [m/s]" in table
    assert NOTE in table
    assert "speeds: Largest speed of every run." in " ".join(shown.split())
    assert [Path(path).name for path in files.split()] == ["speeds.png", "speeds.svg"]


@pytest.mark.slow
def test_a_plug_in_that_cannot_be_imported_costs_one_line(tmp_path: Path) -> None:
    folder = written(tmp_path)
    (folder / "broken.py").write_text("import no_such_module\nFIGURE = Figure(name)\n")
    text = (folder / "speeds.py").read_text()
    (folder / "same.py").write_text(text.replace("speed_max", "e_pos_mae"))
    (folder / "pie.py").write_text(
        (folder / "speed_figure.py").read_text().replace("speeds", "bars")
    )
    named = {"SEATRIAL_PLUGINS": "broken,nowhere,same,speeds,pie"}
    done = call(folder, "seatrial.runner.compare", "metrics", **named)
    assert done.returncode == 0
    assert "speed_max" in done.stdout
    assert done.stderr.splitlines() == [
        "plug-in nowhere: there is no such module",
        "cannot import plug-in broken: ModuleNotFoundError: No module named 'no_such_module'",
        "cannot import plug-in same: ValueError: metric e_pos_mae: got a second definition,"
        " expected one",
    ]
    done = call(folder, "seatrial.runner.compare", "plot", "--help", **named)
    assert done.returncode == 0
    _, broken, pie = done.stderr.splitlines()
    assert broken == "broken is no figure: No module named 'no_such_module'"
    assert pie == "figure bars of pie is not used: seatrial.runner.compare.plots.bars has it"


@pytest.mark.nightly
def test_a_program_in_python_finds_the_coefficients(tmp_path: Path) -> None:
    folder = written(tmp_path)
    run(folder, "seatrial.runner", *SURGE, "identifier=fit")
    compare(folder, "fit")
    run(folder, "seatrial.runner", *SURGE, "identifier=fit")
    assert rows(folder, "select count(*) from run") == [(1,)]  # known already
    (folder / "fit.py").write_text((folder / "fit.py").read_text() + "\nprint('done')\n")
    run(folder, "seatrial.runner", *SURGE, "identifier=fit")
    assert rows(folder, "select count(*) from run") == [(2,)]  # the program has changed


@pytest.mark.nightly
@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no Octave: apt-get install octave")
def test_a_program_in_octave_finds_the_coefficients(tmp_path: Path) -> None:
    folder = written(tmp_path)
    run(folder, "seatrial.runner", *SURGE, "identifier=fit_octave")
    compare(folder, "fit_octave")


def compare(folder: Path, identifier: str) -> None:
    """Without noise, least squares on the acting force give the true vessel."""
    assert rows(folder, "select identifier, status from run") == [(identifier, "finished")]
    true, nominal, found = (
        dict(rows(folder, f"select term, value from coefficient where model = '{model}'"))
        for model in ("plant", "nominal", "identified")
    )
    assert found == pytest.approx(true, rel=1e-6)
    assert found != pytest.approx(nominal, rel=1e-2)


@pytest.mark.nightly
def test_workers_find_the_parts_of_the_working_folder(tmp_path: Path) -> None:
    folder = written(tmp_path)
    sweep = ("-m", "identifier=fit,none", "seed=0,1", "hydra/launcher=processes")
    out = run(folder, "seatrial.runner", *sweep, *SURGE, "hydra.launcher.n_jobs=2")
    assert "4 runs: 4 finished" in out
    parts = ("-m", "controller=pd_python,pid_ff", "hydra/launcher=processes")
    out = run(folder, "seatrial.runner", *parts, *SHORT, "hydra.launcher.n_jobs=2")
    assert "2 runs: 2 finished" in out
