"""The law that judges hostile tries catches what it is there for; and a part of the tries."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.abuse import isolated, ledger
from tests.abuse.inputs import nothing
from tests.abuse.isolated import Answer, Order
from tests.abuse.ledger import Entry
from tests.runner.programs import ROOT, program, wait


def answer(code: int = 2, err: str = "seatrial: no\n", **changes: object) -> Answer:
    values = {"out": b"", "err": err.encode(), "seconds": 1.0, "new": ()} | changes
    return Answer(Order("seatrial", (), nothing), Path(), code, **values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (answer(), None),
        (answer(0, "", out=b"\tdone\n", new=("results/results.db",)), None),
        (answer(3), "exit code 3"),
        (answer(-9), "ended by SIGKILL"),
        (answer(-24), "took longer"),
        (answer(0, "", seconds=1e4), "took longer"),
        (answer(1, "Traceback (most recent call last):\n  here\nValueError: no\n"), "ValueError"),
        (answer(2, ""), "without a message"),
        (answer(2, "one\ntwo\n"), "2 lines"),
        (answer(2, "x" * 1001), "1001 characters"),
        (answer(2, "seatrial: got \x1b[31m\n"), "U+001B"),
        (answer(0, "\x9b"), "U+009B"),
        (answer(2, new=("results/results.db",)), "left behind"),
        (answer(0, "", new=("series/.a.parquet.7.tmp",)), "left behind"),
    ],
)
def test_the_law_tells_what_is_wrong(given: Answer, said: str | None) -> None:
    broken = isolated.broken(given)
    assert broken is None if said is None else said in (broken or "")


@pytest.mark.slow
def test_limits_end_a_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Endless work, endless waiting, too much memory, a crash: each is told from the others."""

    def endless() -> int:
        while True:
            pass

    bodies = {
        "work": endless,
        "wait": lambda: time.sleep(60.0),
        "memory": lambda: len(bytearray(2 * isolated.MEMORY)),
        "bug": lambda: 1 // 0,
        "none": lambda: 0,
    }
    monkeypatch.setattr(isolated, "PROCESSOR_S", 1.0)
    monkeypatch.setattr(isolated, "WALL_S", 10.0)
    monkeypatch.setattr(isolated, "_call", lambda order: bodies[order.arguments[0]]())
    orders = [(n, Order("seatrial", (name,), nothing)) for n, name in enumerate(bodies)]
    said = {
        a.order.arguments[0]: isolated.broken(a) or "" for _, a in isolated.run(orders, tmp_path)
    }
    assert "took longer" in said["work"]
    assert "took longer" in said["wait"]
    assert "MemoryError" in said["memory"]
    assert "ZeroDivisionError" in said["bug"]
    assert said["none"] == ""


def test_what_does_not_hold_is_counted_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = Entry("storms")
    for height in (1, 9):
        with entry.attempt(f"wave {height}", "python again"):
            assert height < 5, "too high"
    assert (entry.tried, entry.held) == (2, 1)
    assert [violation.partition("\n")[0] for violation in entry.violations] == ["wave 9: too high"]
    assert "repeat: python again" in capsys.readouterr().out
    assert "| storms | 2 | 1 | 1 |" in ledger.table([entry])
    ledger.write([entry], 1, tmp_path / "new" / "abuse.json")
    assert json.loads((tmp_path / "new" / "abuse.json").read_text())["entries"][0]["violated"] == 1


GUARDED = """
import subprocess, sys, time
from tests.abuse.guard import guarded
with guarded() as folder:
    children = [subprocess.Popen(["sleep", "60"], start_new_session=True) for _ in range(2)]
    disk = folder / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", disk], stderr=subprocess.DEVNULL)
    print(folder, *(child.pid for child in children), flush=True)
    time.sleep(60.0 if sys.argv[1] == "waits" else 0.0)
"""


@pytest.mark.parametrize("number", [None, signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_nothing_is_left_however_the_tries_end(tmp_path: Path, number: int | None) -> None:
    with program("-c", GUARDED, "waits" if number else "ends", folder=tmp_path) as process:
        assert process.stdout is not None
        folder, *pids = process.stdout.readline().split()
        assert len(pids) == 2
        if number:
            process.send_signal(number)
        assert process.wait(20.0) == -(number or 0)
    wait(lambda: number is None or not Path(folder).exists())
    assert not any(Path("/proc", pid, "exe").exists() for pid in pids)
    assert folder not in Path("/proc/mounts").read_text()
    assert not Path(folder).exists()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_part_of_the_hostile_tries_holds(tmp_path: Path) -> None:
    """`make abuse` tries all of it."""
    said = subprocess.run(
        [sys.executable, "-m", "tests.abuse", "--quick", "--output", tmp_path / "abuse.json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    print(said.stdout)
    assert said.returncode == 0, said.stdout + said.stderr
    entries = json.loads((tmp_path / "abuse.json").read_text())["entries"]
    assert all(entry["tried"] > 0 or entry["skipped"] for entry in entries)
