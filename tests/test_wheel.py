"""The wheel: one import name with everything in it, which runs in any folder."""

import os
import re
import shutil
import subprocess
import sys
import venv
from importlib.metadata import Distribution, distribution, packages_distributions
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement

from seatrial import __version__
from tests.runner.programs import ROOT, rows
from tests.test_plugins import written

GUIDE = ROOT / "docs" / "howto" / "python.md"
CHECKS = """
assert run.status == "finished"
assert (len(sweep.runs()), len(pairs.runs())) == (4, 2)
assert table.frame["identifier"].tolist() == ["none", "ls"]
assert 0.0 < run.metric("e_pos_mae", dof="position") < 1.0
assert len(axes.patches) == 2
assert again.logbook.model(again.number, "nominal").coefficients.equals(model.coefficients)
assert estimator.score(test) > 0.99
assert ferry.dofs == ("surge", "sway", "yaw")
"""
OFFLINE = ("--no-deps", "--no-index")
FOLDERS = {"conf": "seatrial/conf", "models": "seatrial/models", "runner": "seatrial/runner"}


def requirements(name: str, seen: dict[str, Distribution]) -> dict[str, Distribution]:
    """The distributions that a distribution needs to run, by name, without extras."""
    for line in distribution(name).requires or ():
        requirement = Requirement(line)
        extras = ("", *requirement.extras)
        marker = requirement.marker
        if requirement.name not in seen and (
            marker is None or any(marker.evaluate({"extra": extra}) for extra in extras)
        ):
            seen[requirement.name] = distribution(requirement.name)
            requirements(requirement.name, seen)
    return seen


def run(*command: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """A command in a folder, without the variables that would show it the checkout."""
    hidden = ("PYTHONPATH", "SEATRIAL_DATA", "VIRTUAL_ENV", "HYDRA_FULL_ERROR")
    environment = {
        name: value
        for name, value in os.environ.items()
        # The Makefile's PIP_CONSTRAINT is a path relative to the checkout.
        if name not in hidden and not name.startswith("PIP_")
    }
    return subprocess.run(
        command, cwd=folder, env=environment | {"COLUMNS": "200"}, capture_output=True, text=True,
        timeout=600, check=False,
    )  # fmt: skip


def said(*command: str | Path, folder: Path) -> str:
    """What a command says, which must succeed."""
    answer = run(*command, folder=folder)
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the source distribution of a copy of the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "checkout"
    ignore = shutil.ignore_patterns("__pycache__")
    for name in (*FOLDERS, "seatrial"):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE", "MANIFEST.in"):
        shutil.copy(ROOT / name, copy)
    build = "import setuptools.build_meta as build; build.build_sdist('..')"
    said(sys.executable, "-c", build, folder=copy)
    (sources,) = folder.glob("*.tar.gz")
    return built(sources, folder)


@pytest.fixture(scope="module")
def binaries(wheel: Path) -> Path:
    """The programs of a new environment that holds the wheel and what it requires, no more."""
    folder = wheel.with_name("environment")
    venv.create(folder, symlinks=True)
    (packages,) = folder.glob("lib/python3*/site-packages")
    needed = requirements("seatrial", {})
    names = {required.name for required in needed.values()}
    shared = {
        folder
        for folder, owners in packages_distributions().items()
        if not names.issuperset(owners)
    }
    for required in needed.values():
        for file in required.files or ():
            # A folder that other distributions use as well (hydra_plugins) is linked by file.
            part = file if file.parts[0] in shared else Path(file.parts[0])
            link = packages / part
            if ".." not in file.parts and not link.exists():
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(Path(str(required.locate_file(part))).resolve())
    install(folder / "bin" / "python", wheel)
    return folder / "bin"


@pytest.mark.slow
def test_the_wheel_holds_every_file_under_one_name(wheel: Path) -> None:
    files = [name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name]
    tree = {
        f"{inside}/{path.relative_to(ROOT / name).as_posix()}"
        for name, inside in FOLDERS.items()
        for path in (ROOT / name).rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }
    assert sorted(files) == sorted(tree | {"seatrial/__init__.py", "seatrial/py.typed"})
    assert wheel.stat().st_size <= 1_500_000


@pytest.mark.nightly
def test_plug_ins_need_no_fork(binaries: Path, tmp_path: Path) -> None:
    """docs/howto/plugins.md in an empty folder, with what the wheel requires alone."""

    seatrial, results = binaries / "seatrial", binaries / "seatrial-results"
    assert "wrote my_fit.py" in said(seatrial, "init", "plugin", "my_fit", folder=tmp_path)
    calls = "[getattr(t, name)() for name in dir(t) if name.startswith('test_')]"
    said(binaries / "python", "-c", f"import test_my_fit as t; {calls}", folder=tmp_path)
    written(tmp_path)
    assert "conf: controller=pd_python, " in said(seatrial, "--help", folder=tmp_path)
    surge = ("vessel=surge_linear", "excitation=prbs", "evaluation=none", "controller=none")
    program = f"--variant=identifier=fit identifier.command=[{binaries}/python,fit.py]"
    out = said(seatrial, "-m", *surge, program, "--variant=identifier=my_fit", folder=tmp_path)
    assert "2 runs: 2 finished" in out
    empty = tmp_path / "empty"
    empty.mkdir()
    source = package(tmp_path)
    install(binaries / "python", built(source, source))
    assert "fleet_fit" in said(seatrial, "--help", folder=empty)
    assert "speeds: Largest speed" in said(results, "plot", "--help", folder=empty)
    assert "speed_max" in said(results, "metrics", folder=empty)
    said(seatrial, *surge, "identifier=fleet_fit", folder=empty)


def package(folder: Path) -> Path:
    """A package of the plug-ins in a folder, with the entry point of the guide."""
    source = folder / "source"
    (source / "fleet" / "conf" / "identifier").mkdir(parents=True)
    (source / "fleet" / "__init__.py").write_text("from fleet.speeds import LargestSpeed\n")
    for name in ("my_fit.py", "speeds.py", "speed_figure.py"):
        shutil.copy(folder / name, source / "fleet")
    options = (folder / "conf" / "identifier" / "my_fit.yaml").read_text()
    (source / "fleet" / "conf" / "identifier" / "fleet_fit.yaml").write_text(
        options.replace("_target_: my_fit.", "_target_: fleet.my_fit.")
    )
    guide = (ROOT / "docs" / "howto" / "plugins.md").read_text()
    entry_point = guide.partition("```toml\n")[2].partition("```")[0]
    (source / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["setuptools"]\nbuild-backend = "setuptools.build_meta"\n'
        '[project]\nname = "fleet"\nversion = "1"\n'
        f"{entry_point}"
        '[tool.setuptools]\npackages = ["fleet"]\n'
        '[tool.setuptools.package-data]\nfleet = ["conf/**/*.yaml"]\n'
    )
    return source


def built(source: Path, folder: Path) -> Path:
    """The wheel of a source in a folder, built with what is installed here."""
    words = ("wheel", *OFFLINE, "--no-build-isolation", source)
    said(sys.executable, "-m", "pip", *words, folder=folder)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(python: Path, wheel: Path) -> None:
    """Install a wheel into the environment of an interpreter."""
    words = ("--python", python, "install", *OFFLINE, wheel)
    said(sys.executable, "-m", "pip", *words, folder=wheel.parent)


# Several commands in one process; what they import comes from the wheel.
COMMANDS = """
import importlib.util, sys
from seatrial.runner.__main__ import main
from seatrial.runner.compare.__main__ import run

def seatrial(*words):
    sys.argv = ["seatrial", *words]
    assert not main(), words

def results(*words):
    assert run(words) == 0, words

if __name__ == "__main__":  # workers import this file
    for name in ("models", "runner", "conf", "docs", "tests"):
        assert importlib.util.find_spec(name) is None, name
    seatrial("-m", "identifier=none,ls", "evaluation=none", "hydra/launcher=processes")
    seatrial("identifier=ls", "evaluation=none", "seed=1")
    for words in ("plot residual", "report", "site"):
        results(*words.split())
    seatrial("init", "vessel", "tug")
    seatrial("vessel=conf/vessel/tug.yaml", "identifier=none", "evaluation=none")
    inner = object.__getattribute__  # loads no module that is to be loaded when it is used
    modules = [module for module in sys.modules.values() if isinstance(module, type(sys))]
    files = {inner(module, "__dict__").get("__file__") or "" for module in modules}
    assert any("seatrial/models/simulation" in file for file in files)
    print("inside", [file for file in files if file.startswith(sys.orig_argv[-1])])
"""


@pytest.mark.slow
def test_the_commands_run_in_an_empty_folder(binaries: Path, tmp_path: Path) -> None:
    assert "identifier: " in said(binaries / "seatrial", "--help", folder=tmp_path)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "commands.py").write_text(COMMANDS)
    out = said(binaries / "python", "commands.py", f"{ROOT}/", folder=tmp_path)
    assert "compare: seatrial-results table --rows identifier" in out
    assert "run 3 finished; see seatrial-results show 3" in out
    assert "wrote conf/vessel/tug.yaml" in out
    assert out.splitlines()[-1] == "inside []"
    words = ("table", "--metric", "force_mse", "--stage", "validation")
    table = said(binaries / "seatrial-results", *words, folder=tmp_path)
    assert {"none", "ls"} <= set(table.split())
    results = tmp_path / "results"
    assert {path.name for path in tmp_path.iterdir()} == {"commands.py", "conf", "results"}
    assert list((results / "figures").iterdir())
    assert (results / "site" / "runs.html").is_file()
    query = "SELECT git_commit, json_extract(versions, '$.seatrial') FROM run WHERE id = 3"
    assert rows(tmp_path, query) == [(None, __version__)]


@pytest.mark.nightly
def test_the_guide_of_python_runs_in_an_empty_folder(binaries: Path, tmp_path: Path) -> None:
    """The code of docs/howto/python.md, which does what the page says."""
    blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    assert len(blocks) == 7
    (tmp_path / "guide.py").write_text("".join([*blocks, CHECKS]))
    out = said(binaries / "python", "guide.py", folder=tmp_path)
    assert out.startswith("identifier: no option 'lss', did you mean ls?")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"guide.py", "results", "track.pdf", "boat.png", "ferry.c", "ferry.h"}
