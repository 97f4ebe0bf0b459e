"""Full and read-only disks: one line, nothing lost, and the same command finishes afterwards."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.abuse.ledger import Entry
from tests.abuse.stage import Program, Stage, quiet
from tests.abuse.storm import SHORT

SWEEP = (*SHORT, "identifier=none", "disturbance=noise", "seed=range(0,4)")
SIZES_KB = (4, 64, 256, 400, 640)
ROOM = "64m"


def disks(folder: Path, seed: int, share: float = 1.0) -> list[Entry]:
    """Sweeps on disks that are too small, and commands on one that cannot be written."""
    full, frozen = Entry("full disk"), Entry("read-only folder")
    reason = _cannot_mount(folder)
    repeat = f"python -m tests.abuse disks --seed {seed}"
    if reason:
        full.skipped = frozen.skipped = reason
        return [full, frozen]
    for size in SIZES_KB if share == 1.0 else SIZES_KB[3:4]:
        with full.attempt(f"a disk of {size} KB", repeat), _stage(folder, f"{size}k") as stage:
            _fill(stage)
    with frozen.attempt("an empty folder", repeat), _stage(folder, ROOM) as stage:
        _remount(stage, "ro")
        refused(stage.sweep())
        refused(stage.start("-m", "runner", *SHORT))
    if share < 1.0:
        return [full, frozen]
    with full.attempt("output to a full disk", repeat), _stage(folder, ROOM) as stage:
        stage.complete()
        _outputs_on_full(stage, folder)
    with frozen.attempt("a logbook in use", repeat), _stage(folder, ROOM) as stage:
        stage.complete()
        _remount(stage, "ro")
        _on_read_only(stage)
        _remount(stage, "rw")
        stage.complete()
    return [full, frozen]


def _cannot_mount(folder: Path) -> str:
    if os.geteuid() != 0:
        return "only root may mount a tmpfs"
    trial = folder / "mount"
    trial.mkdir()
    said = _mount("-t", "tmpfs", "-o", "size=64k", "tmpfs", str(trial))
    if said:
        return f"mount: {said}"
    subprocess.run(["umount", trial], check=True)
    return ""


def _mount(*arguments: str) -> str:
    said = subprocess.run(["mount", *arguments], capture_output=True, text=True, check=False)
    return said.stderr.strip() or ("failed" if said.returncode else "")


@contextmanager
def _stage(folder: Path, size: str) -> Iterator[Stage]:
    """A sweep whose results folder is a disk of this size."""
    own = folder / f"disk-{size}-{len(list(folder.iterdir()))}"
    (own / "results").mkdir(parents=True)
    assert not _mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(own / "results"))
    try:
        yield Stage(own, SWEEP, 4, f"sqlite:///{own}/results/results.db")
    finally:
        subprocess.run(["umount", "--lazy", own / "results"], check=True)


def _remount(stage: Stage, options: str) -> None:
    said = _mount("-o", f"remount,{options}", str(stage.folder / "results"))
    assert not said, said


def refused(program: Program) -> None:
    """Assert that a command is refused in one line."""
    code, _, err = program.ended()
    quiet(err)
    assert code == 2, f"exit code {code}: {err[-300:]!r}"
    assert err.count("\n") == 1, f"more than a line: {err!r}"


def _fill(stage: Stage) -> None:
    code, out, err = stage.sweep().ended()
    quiet(err)
    assert code in (1, 2), f"exit code {code}: {out[-300:]!r} {err[-300:]!r}"
    assert len(err.splitlines()) < 40, err
    finished = stage.check()
    _remount(stage, f"size={ROOM}")
    assert stage.check(finished) == finished
    stage.complete()


def _outputs_on_full(stage: Stage, folder: Path) -> None:
    small = folder / "small"
    small.mkdir()
    assert not _mount("-t", "tmpfs", "-o", "size=8k", "tmpfs", str(small))
    try:
        for words in (
            ("export", f"{small}/exported"),
            ("report", "--output", f"{small}/report.html"),
            ("plot", "bars", "--output", f"{small}/figures"),
        ):
            refused(stage.compare(*words))
            left = [path for path in small.rglob("*") if path.is_file()]
            # What is there under its own name is whole.
            assert not [path for path in left if path.suffix in (".html", ".tmp")], left
            for path in left:
                path.unlink()
    finally:
        subprocess.run(["umount", "--lazy", small], check=True)


def _on_read_only(stage: Stage) -> None:
    for words in (("runs",), ("table",), ("verify",), ("show", "1"), ("export", "exported")):
        code, _, err = stage.compare(*words).ended()
        assert code == 0, f"{words}: exit code {code}: {err[-300:]!r}"
    refused(stage.compare("prune", "--status", "finished", "--yes"))
    refused(stage.compare("report"))
    refused(stage.compare("plot", "bars"))
    refused(stage.start("-m", "runner", *SHORT, "seed=99"))
    program = stage.sweep()
    code, _, err = program.ended()
    quiet(err)
    assert code in (0, 2), f"exit code {code}: {err[-300:]!r}"
    assert code == 0 or err.count("\n") == 1, err
