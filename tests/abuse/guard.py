"""A process that removes what the tries leave however they end: processes, disks and files."""

import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.runner.programs import ROOT, belonging_to

NAME = "SEATRIAL_ABUSE_SESSION"
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PATIENCE_S = 2.0  # for a database server, to give back its shared memory
SHARED = Path("/dev/shm")


@contextmanager
def guarded() -> Iterator[Path]:
    """A folder for everything; when this process ends, also by a signal, nothing of it is left.

    All programs that are started in the block inherit a variable, by which they are known.
    """
    began = time.time()
    for number in ENDS:  # they end this process at once; the guard does the rest
        signal.signal(number, signal.SIG_DFL)
    # Root's own temporary folder may be closed to the account of the database server.
    place = "/tmp" if os.geteuid() == 0 else None
    folder = Path(tempfile.mkdtemp(prefix="seatrial-abuse-", dir=place))
    folder.chmod(0o711)
    temporary = folder / "tmp"
    temporary.mkdir()
    variable = f"{NAME}={secrets.token_hex(16)}"
    guard = subprocess.Popen(
        [sys.executable, "-m", "tests.abuse.guard", folder, variable, str(os.getpid())],
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.environ[NAME] = variable.partition("=")[2]
    os.environ["TMPDIR"] = os.environ["JOBLIB_TEMP_FOLDER"] = str(temporary)
    try:
        yield folder
    finally:
        clean(folder, variable, began)
        guard.kill()
        guard.wait()


def clean(folder: Path, variable: str, began: float) -> None:
    """End the processes with a variable, and remove a folder and the disks below it.

    Semaphores that ended processes have left since `began` [s since the epoch] are removed, too.
    """
    until = time.monotonic() + PATIENCE_S
    number = signal.SIGQUIT
    while pids := belonging_to(variable):
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        time.sleep(0.1)
        number = signal.SIGQUIT if time.monotonic() < until else signal.SIGKILL
    mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
    for mount in reversed(mounts):
        if mount.startswith(f"{folder}/"):
            subprocess.run(["umount", "--lazy", mount], check=False)
    shutil.rmtree(folder, ignore_errors=True)
    for file in SHARED.glob("sem.loky-*"):  # named by the process that made it
        pid = file.name.split("-")[1]
        with suppress(OSError):
            if not Path("/proc", pid).exists() and file.stat().st_mtime >= began:
                file.unlink()


def main(folder: str, variable: str, parent: str) -> None:
    """Wait for the end of the parent, and clean up after it."""
    began = time.time()
    while os.getppid() == int(parent):
        time.sleep(0.2)
    clean(Path(folder), variable, began)


if __name__ == "__main__":
    main(*sys.argv[1:])
