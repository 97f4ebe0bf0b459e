"""Completion of both command lines, as a shell asks for it."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from seatrial.runner.compare.__main__ import run as run_results
from seatrial.runner.record.catalogue import all_declared
from tests.runner.command import Command

ROOT = Path(__file__).parents[2]
ENTRY = {
    "seatrial": "from seatrial.runner.__main__ import main; sys.exit(main())",
    "seatrial-results": "from seatrial.runner.compare.__main__ import main; sys.exit(main())",
}


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home folder with both programs in bin, as pip installs them."""
    folder = tmp_path_factory.mktemp("home")
    (folder / "bin").mkdir()
    for name, text in ENTRY.items():
        script = folder / "bin" / name
        script.write_text(f"#!{sys.executable}\nimport sys\n{text}\n")
        script.chmod(0o755)
    return folder


def run(home: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    path = os.environ.get("PYTHONPATH", str(ROOT))
    own = {"HOME": str(home), "PATH": f"{home}/bin:{os.environ['PATH']}", "PYTHONPATH": path}
    return subprocess.run(
        words, env={**os.environ, **own, **variables}, cwd=home, capture_output=True, text=True,
        timeout=120, check=False,
    )  # fmt: skip


def completed(seatrial: Command, monkeypatch: pytest.MonkeyPatch, line: str) -> list[str]:
    """What Hydra's script in a shell is answered for a line."""
    monkeypatch.setenv("COMP_LINE", line)
    monkeypatch.setenv("COMP_POINT", str(len(line)))
    answer = seatrial("-sc", "query=bash")
    assert answer.code == 0, answer
    return answer.out.split()


def test_groups_and_options(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Options are those of the chosen part."""
    for line, expected in (
        ("seatrial vess", "vessel="),
        ("seatrial -m controller.k", "controller.kp="),
        ("seatrial controller=mpc_standard controller.h", "controller.horizon="),
        ("seatrial -m identifier=ls,pl", "identifier=ls,plsr"),
        ("seatrial -m disturbance=[noise,wi", "disturbance=[noise,wind"),
        ("seatrial -m --variant 'identifier=ls seed=1' hydra/laun", "hydra/launcher="),
        ("seatrial -m disturbance=[noise,wind],calm controller.k", "controller.kd="),
    ):
        assert expected in completed(seatrial, monkeypatch, line), line
    assert completed(seatrial, monkeypatch, "seatrial controller=pid_ff controller.h") == []


@pytest.fixture
def answered(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., list[str]]:
    """What the program of the results answers a shell that completes its words, line by line."""

    def answer(words: str, shell: str = "bash") -> list[str]:
        for name, value in asked(words, shell).items():
            monkeypatch.setenv(name, value)
        with suppress(SystemExit):
            run_results([])
        said = capsys.readouterr()
        assert said.err == ""
        return said.out.strip().splitlines()

    return answer


def test_commands_figures_and_metrics(answered: Callable[..., list[str]]) -> None:
    for words, expected in (
        ("plo", {"plot"}),
        ("plot tra", {"track"}),
        ("table --metric e_pos_m", {"e_pos_mae", "e_pos_mse"}),
        ("table --metric force_mse,e_pos_ma", {"force_mse,e_pos_mae"}),
        ("table --metric ", {metric.name for metric in all_declared()}),
    ):
        assert {*answered(words)} == expected, words


def asked(words: str, shell: str = "bash") -> dict[str, str]:
    """The variables by which Typer's script in a shell asks for a line and its last word."""
    return {
        "_SEATRIAL_RESULTS_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": f"seatrial-results {words}", "COMP_CWORD": str(len(words.split(" "))),
        "_TYPER_COMPLETE_ARGS": f"seatrial-results {words}",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        "_TYPER_COMPLETE_WORD_TO_COMPLETE": words.rpartition(" ")[2],
    }  # fmt: skip


LINE = "seatrial -m identifier=ls,pl"
INSTALLED = {  # shell: its file, what that has once, and what the shell does at the tab key
    "bash": (
        ".bashrc", "source", f"COMP_LINE='{LINE}' COMP_POINT={len(LINE)} COMP_CWORD=2; "
        "hydra_bash_completion; echo $PS1 ${COMPREPLY[@]}", "--norc",
    ),
    "zsh": (  # without compinit
        ".zshrc", "bashcompinit && source", f"words=({LINE}); CURRENT=3; export COMP_LINE='{LINE}' "
        f"COMP_POINT={len(LINE)} COMP_CWORD=2; word=$(compgen -F hydra_bash_completion -- "
        "${words[3]}); echo $PS1 $word; [[ $_comps[seatrial] = *hydra_bash_completion ]]", "-f",
    ),
}  # fmt: skip


@pytest.mark.parametrize("shell", INSTALLED)
def test_installed_once_it_completes(home: Path, shell: str) -> None:
    program = shutil.which(shell) or pytest.skip(f"no {shell} here: apt-get install {shell}")
    name, once, script, alone = INSTALLED[shell]
    (home / name).write_text("PS1=here")  # without a line end
    for _ in range(2):
        answer = run(home, "seatrial", "--install-completion", SHELL=f"/usr/bin/{shell}")
        assert answer.returncode == 0, answer.stderr
    assert (home / name).read_text().count(once) == 1
    answer = run(home, program, alone, "-c", f". ~/{name}; {script}")
    assert (answer.returncode, answer.stdout) == (0, "here identifier=ls,plsr\n")
    assert "command not found" not in answer.stderr


def test_another_shell_and_a_checkout_are_refused(home: Path) -> None:
    answer = run(home, "seatrial", "--install-completion", "csh")
    assert answer.returncode == 2
    assert "expected one of bash, zsh, fish" in answer.stderr
    answer = run(home, sys.executable, "-m", "seatrial.runner", "--install-completion", "bash")
    assert answer.returncode == 2
    assert "pip install -e ." in answer.stderr
