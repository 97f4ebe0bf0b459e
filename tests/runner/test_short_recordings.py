"""Numbers of a recording are read as floats are written; too few samples are named in time."""

from pathlib import Path

import pytest

from tests.runner.command import Answer, Command


def sail(
    seatrial: Command, path: Path, rows: list[list[str]], *options: str, split: str = "0.5"
) -> Answer:
    lines = ["Time,x,u,X", *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return seatrial(
        "vessel=surge_linear", "excitation=recording", f"excitation.path={path}",
        "~excitation.columns.position", "+excitation.columns.position={surge: x}",
        "~excitation.columns.velocity", "+excitation.columns.velocity={surge: u}",
        "~excitation.columns.force", "+excitation.columns.force={surge: X}",
        "excitation.columns.orientation=null", f"excitation.train_fraction={split}", *options,
    )  # fmt: skip


def rows(count: int) -> list[list[str]]:
    return [
        [f"{0.1 * k:.1f}", f"{0.01 * k:.3f}", f"{0.1 * (-1) ** k:.1f}", str(k % 7)]
        for k in range(count)
    ]


@pytest.fixture
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings") / "short.csv"


def test_numbers_are_read_as_floats_are_written(seatrial: Command, path: Path) -> None:
    recording = rows(40)
    for cell in ("1_000", "١٢", "0x10", "1e400", "1,5", "inf"):
        recording[17][3] = f'"{cell}"'
        answer = sail(seatrial, path, recording, "identifier=none")
        assert (answer.code, answer.err.count("\n")) == (2, 1)
        assert f"{path}, column X, line 19: got {cell!r}, expected a finite number" in answer.err
    assert list(seatrial.folder.iterdir()) == []
    for k, cell in enumerate(("1e3", "-.5", "+2.", "1E-3", " 7 ")):
        recording[17 + k][3] = cell
    assert sail(seatrial, path, recording, "identifier=none", "dry_run=true").code == 0


TOO_FEW = (
    (1, ["identifier=none"], "got 1 samples, expected at least 2"),
    (3, ["identifier=none"], "got 1 samples for testing, expected at least 2"),
    (20, ["identifier=plsr"], "got 10 samples for training, expected at least 12"),
    (60, ["identifier=ls", "identifier.lowpass_hz=1.0"], "too few for a low-pass filter"),
    (4, ["identifier=ls", "identifier.lowpass_hz=null"],
     "got 2 samples for training after the low-pass filters, expected at least 4"),
    (4, ["identifier=ls"], "got 2 samples, too few for a low-pass filter"),
    (40, ["identifier=iv"], "too few for a low-pass filter"),
    (40, ["identifier=robust"], "got 20 samples for training, expected at least 40"),
    (40, ["identifier=none", "excitation.resample_hz=1e9"], "3.9e+09 samples from the 40 rec"),
)  # fmt: skip


def test_too_few_samples(seatrial: Command, path: Path, subtests: pytest.Subtests) -> None:
    for count, options, message in TOO_FEW:
        with subtests.test(message):
            answer = sail(seatrial, path, rows(count), *options)
            assert (answer.code, answer.err.count("\n")) == (2, 1)
            assert str(path) in answer.err
            assert message in answer.err
    assert list(seatrial.folder.iterdir()) == []
