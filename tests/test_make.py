"""What make says on a machine where it cannot set up, and that it does not set up twice."""

import os
import re
import shutil
import stat
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAKE = shutil.which("make")
CONSTRAINTS = ("constraints.txt", "constraints-ray.txt")

pytestmark = pytest.mark.skipif(MAKE is None, reason="make is not installed")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with the Makefile, and a PATH with nothing but what it calls."""
    tools = tmp_path / "here" / "tools"
    tools.mkdir(parents=True)
    for name in ("Makefile", "pyproject.toml", *CONSTRAINTS):
        shutil.copy(ROOT / name, tools.parent)
    for name in ("sh", "touch", "mkdir", "rm", "find"):
        found = shutil.which(name)
        assert found is not None
        (tools / name).symlink_to(found)
    return tools.parent


def pretend_python(checkout: Path, name: str, version: str, venv: bool) -> None:
    """An interpreter of this version, with or without its venv module; notes what it is asked."""
    script = checkout / "tools" / name
    script.write_text(
        "#!/bin/sh\n"
        f'echo "{name} $*" >> "{checkout}/asked"\n'
        f'echo "$PIP_CONSTRAINT $PIP_BUILD_CONSTRAINT $*" >> "{checkout}/constrained"\n'
        "for last; do :; done\n"
        'case "$*" in\n'
        f"*version_info*) echo {version} ;;\n"
        f"*ensurepip*) exit {0 if venv else 1} ;;\n"
        '*"-m venv"*) mkdir -p "$last/bin"; : > "$last/bin/python" ;;\n'
        f"--version) echo Python {version} ;;\n"
        "esac\n"
    )
    script.chmod(script.stat().st_mode | stat.S_IXUSR)


def set_up(checkout: Path, folder: str = ".venv", name: str = "stub") -> Path:
    """An environment with an interpreter, as make sets it up."""
    binaries = checkout / folder / "bin"
    binaries.mkdir(parents=True)
    pretend_python(checkout, name, "3.11", venv=True)
    return Path(shutil.copy(checkout / "tools" / name, binaries / "python"))


def make(checkout: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    assert MAKE is not None
    environment = {"PATH": str(checkout / "tools"), "HOME": str(checkout)}
    return subprocess.run(
        [MAKE, "--no-print-directory", *arguments], cwd=checkout, env=environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def asked(checkout: Path) -> str:
    return (checkout / "asked").read_text()


@pytest.mark.parametrize("version", [None, "3.10", "3.14"])
def test_no_python_or_one_that_is_too_old_or_too_new(checkout: Path, version: str | None) -> None:
    if version:
        pretend_python(checkout, "python3", version, venv=True)
    answer = make(checkout, ".venv/bin/python")
    assert answer.returncode != 0
    assert "seatrial: no Python 3.11, 3.12 or 3.13 found" in answer.stderr


def test_no_venv_module_names_the_package(checkout: Path) -> None:
    pretend_python(checkout, "python3", "3.12", venv=False)
    answer = make(checkout, ".venv/bin/python")
    assert answer.returncode != 0
    assert "install Debian's package python3.12-venv" in answer.stderr
    assert not (checkout / ".venv").exists()


def test_the_newest_that_can_is_taken(checkout: Path) -> None:
    pretend_python(checkout, "python3", "3.11", venv=True)
    pretend_python(checkout, "python3.12", "3.12", venv=True)
    pretend_python(checkout, "python3.13", "3.13", venv=False)
    answer = make(checkout, ".venv/bin/python")
    assert answer.returncode == 0, answer.stderr
    assert "setting up .venv with Python 3.12" in answer.stdout
    assert "python3.12 -m venv .venv" in asked(checkout)


def test_it_installs_again_only_for_a_change(checkout: Path) -> None:
    set_up(checkout)
    for _ in range(2):
        assert make(checkout, ".venv/test.stamp").returncode == 0
    (install,) = re.findall(r"stub -m pip install .*", asked(checkout))
    assert install.endswith("--editable .[test]")
    future = (checkout / ".venv" / "test.stamp").stat().st_mtime + 2.0
    os.utime(checkout / "constraints.txt", (future, future))
    assert make(checkout, ".venv/test.stamp").returncode == 0
    assert len(re.findall(r"pip install", asked(checkout))) == 2


def test_the_suite_sees_no_outside_data_and_nothing_is_run_twice(checkout: Path) -> None:
    """`make test` is the same in every clone: it unsets the variable, and looks nowhere else."""
    (checkout.parent / "shared" / "data").mkdir(parents=True)
    script = set_up(checkout)
    echo = 'echo "${SEATRIAL_DATA-unset} $*"'
    script.write_text(script.read_text().replace('echo "stub $*"', echo))
    for asked_for in (("test", "SEATRIAL_DATA=/data"), ("test",), ("test-data",),
                      ("test-data", "SEATRIAL_DATA=/data")):  # fmt: skip
        answer = make(checkout, *asked_for)
        assert answer.returncode == 0, answer.stderr
    ran = re.findall(r"^(\S+) -m pytest .* -m (.*)$", asked(checkout), re.M)
    beside = f"{checkout}/../shared/data"
    assert ran == [
        ("unset", "not (slow or nightly or data)"),
        ("unset", "not (slow or nightly or data)"),
        (beside, "data and not (slow or nightly)"),
        ("/data", "data and not (slow or nightly)"),
    ]
