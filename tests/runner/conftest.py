from pathlib import Path

import pytest

from tests.runner.command import Command


@pytest.fixture
def seatrial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    return Command(tmp_path, monkeypatch, capsys)
