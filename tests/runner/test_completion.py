"""Completion of both command lines, as a shell asks for it."""

from collections.abc import Callable
from contextlib import suppress

import pytest

from seatrial.runner.compare.__main__ import run as run_results
from seatrial.runner.record.catalogue import all_declared
from tests.runner.command import Command


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
        ("seatrial -m hydra/laun", "hydra/launcher="),
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
