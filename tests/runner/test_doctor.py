"""`seatrial doctor` and `--version`: what is there, what is lacking, and the exit code."""

import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

from seatrial import __version__
from seatrial.runner.commands import doctor
from tests.runner.command import Command
from tests.runner.compare.conftest import Program
from tests.runner.compare.conftest import program as program

ROOT = Path(__file__).parents[2]
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def lines(capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """The verdict of each line, by the name of what was checked; and the number of problems."""
    text = capsys.readouterr().out.splitlines()
    verdicts = {line[9:].split("  ")[0].strip(): line.split()[0] for line in text[:-1]}
    assert text[-1].startswith(f"{sum(v == 'problem' for v in verdicts.values())} problem")
    return verdicts


def test_this_environment_has_no_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SEATRIAL_DATABASE", raising=False)
    monkeypatch.setenv("SEATRIAL_DATA", str(tmp_path))
    assert doctor.main([]) == 0
    said = lines(capsys)
    names = {requirement.partition(">")[0] for requirement in DECLARED["dependencies"]}
    assert names <= said.keys()
    extras = DECLARED["optional-dependencies"].keys() - {*doctor.OF_PROJECT}
    assert {f"extra {name}" for name in extras} <= said.keys()
    assert not list(tmp_path.iterdir())  # it looks, and makes nothing


@pytest.mark.parametrize("broken", ["version", "package", "cache", "data", "database", "file"])
def test_each_problem_is_named_and_counts(
    broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A missing extra is none."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SEATRIAL_DATABASE", raising=False)
    (tmp_path / "file").write_text("no database, and no folder")

    def installed(name: str) -> str:
        if (name == "numpy" and broken == "package") or name == "optuna":
            raise PackageNotFoundError(name)
        return "1.0" if name == "numpy" and broken == "version" else version(name)

    monkeypatch.setattr(doctor, "version", installed)
    variable, value, name = {
        "version": ("UNUSED", "", "numpy"),
        "package": ("UNUSED", "", "numpy"),
        "cache": ("SEATRIAL_CACHE", str(tmp_path / "file" / "cache"), "compiled code"),
        "data": ("SEATRIAL_DATA", str(tmp_path / "nowhere"), "SEATRIAL_DATA"),
        "database": ("SEATRIAL_DATABASE", "postgresql://localhost:1/none", "logbook"),
        "file": ("SEATRIAL_DATABASE", f"sqlite:///{tmp_path}/file", "logbook"),
    }[broken]
    monkeypatch.setenv(variable, value)
    assert doctor.main([]) == 1
    verdicts = lines(capsys)
    assert [key for key, verdict in verdicts.items() if verdict == "problem"] == [name]
    assert verdicts["extra search"] == "absent"


def test_version_is_that_of_the_project(seatrial: Command, program: Program) -> None:
    version = f"{__version__} (checkout)\n"
    answer = seatrial("--version")
    assert (answer.code, answer.out, answer.err) == (0, f"seatrial {version}", "")
    assert program("--version") == (0, f"seatrial-results {version}", "")
