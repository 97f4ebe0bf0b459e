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
    answer = seatrial.succeeds("-sc", "query=bash")
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
    """What the program of the results answers Typer's script in bash for a line of words."""

    def answer(words: str) -> list[str]:
        monkeypatch.setenv("_SEATRIAL_RESULTS_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", f"seatrial-results {words}")
        monkeypatch.setenv("COMP_CWORD", str(len(words.split(" "))))
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
