"""Locks so that one process compiles a kernel while the others wait and then load the result.

Each kernel has an advisory lock (flock) on a file that names the holder. The operating system
releases the lock when the process ends, however it ends. While a process holds a lock, a thread
updates the modification time of the lock file every second. If the time does not change for ten
seconds, the holder is suspended or its machine is down; the waiting process then compiles the
kernel itself and does not wait for that holder again.
"""

import errno
import fcntl
import logging
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock, Thread

log = logging.getLogger(__name__)
BEAT_S = 1.0  # interval at which a holder updates its lock file
STALLED_S = 10.0  # without an update for so long, the holder counts as suspended
POLL_S = 0.05
_held: set[int] = set()  # file descriptors of the locks that this process holds
_heartbeats: list[Thread] = []  # the thread that updates them, empty while none runs
_guard = Lock()  # for both: a descriptor must not be closed while the thread updates its file
_stalled: set[str] = set()  # holders that this process no longer waits for
_reported: set[str] = set()  # holders that a message has named


class CompileLock:
    """Reentrant lock on the compilation of one kernel."""

    def __init__(self, path: Path, kernel: str) -> None:
        self._path, self._kernel = path, kernel
        self._depth = 0
        self._descriptor: int | None = None  # of the lock file while it is open

    @contextmanager
    def scope(self) -> Iterator[None]:
        """Release on exit, also after an exception, every lock acquired inside the scope."""
        before = self._depth
        try:
            yield
        finally:
            while self._depth > before:
                self._release()

    def acquire(self) -> None:
        """Wait until the kernel may be compiled: the lock is held, or its holder is stalled.

        Must be called within `scope`.
        """
        self._depth += 1
        if self._depth > 1:
            return
        _stopwatch.begin()
        with suppress(OSError):  # the folder cannot be written: compile without a lock
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        if self._descriptor is not None and _lock(self._descriptor):
            _hold(self._descriptor, self._kernel)

    def _release(self) -> None:
        self._depth -= 1
        if self._depth == 0:
            descriptor, self._descriptor = self._descriptor, None
            if descriptor is not None:
                _close(descriptor)
            _stopwatch.end()


class _Stopwatch:
    """Total time during which this process held or waited for at least one lock."""

    def __init__(self) -> None:
        self._total_s, self._since_s, self._depth = 0.0, 0.0, 0
        self._report: Path | None = None  # where other processes read the time
        self._unreported_s = 0.0  # total time before this process joined

    def begin(self) -> None:
        if self._depth == 0:
            self._since_s = time.monotonic()
        self._depth += 1
        self._write()

    def end(self) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._total_s += time.monotonic() - self._since_s
            self._write()

    def seconds(self) -> float:
        running = time.monotonic() - self._since_s if self._depth else 0.0
        return self._total_s + running

    def report_to(self, file: Path) -> None:
        if file != self._report:
            self._report, self._unreported_s = file, self._total_s
            self._write()

    def _write(self) -> None:
        if self._report is None:
            return
        since_s = self._since_s if self._depth else 0.0
        temporary = self._report.with_suffix(".tmp")
        with suppress(OSError):  # the folder is on another machine, or has been removed
            temporary.write_text(f"{self._total_s - self._unreported_s} {since_s}")
            temporary.replace(self._report)


_stopwatch = _Stopwatch()


@dataclass(frozen=True)
class CompileTimes:
    """Times that the processes of this machine spend compiling, as files in a folder.

    The file of a process, named by its number, holds the time [s] of its compilations that have
    ended, and the moment [s] when the current one began (0 if there is none). The moments are those
    of the monotonic clock, which all processes of a machine share.
    """

    folder: Path

    def join(self) -> None:
        """Report the time that this process compiles, or waits for a compilation, from now on."""
        _stopwatch.report_to(self.folder / str(os.getpid()))

    def total_s(self) -> float:
        """Time [s] of all processes that have joined, also of those that have ended."""
        with suppress(OSError):
            return sum(_reported_s(path) for path in self.folder.iterdir() if not path.suffix)
        return 0.0


def _reported_s(path: Path) -> float:
    ended_s, since_s = map(float, path.read_text().split())
    if since_s == 0.0 or not _is_alive(int(path.name)):
        return ended_s
    return ended_s + time.monotonic() - since_s


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _lock(descriptor: int) -> bool:
    """Wait for the lock; False if its holder is stalled or the file system has no locks."""
    previous: tuple[str, int] | None = None
    since = 0.0
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                return False
        else:
            return True
        holder, kernel = _holder(descriptor)
        state = (holder, os.fstat(descriptor).st_mtime_ns)
        if state != previous:
            previous, since = state, time.monotonic()
        if holder in _stalled:
            return False
        if time.monotonic() - since > STALLED_S:
            _stalled.add(holder)
            log.warning(
                "%s, which compiles %s, has not responded for %g s: compiling without the lock",
                holder,
                kernel,
                STALLED_S,
            )
            return False
        if kernel and holder not in _reported:
            _reported.add(holder)
            log.info("waiting for %s to compile %s", holder, kernel)
        time.sleep(POLL_S)


def _holder(descriptor: int) -> tuple[str, str]:
    """The process and the kernel named in a lock file; defaults while the file is empty."""
    text = os.pread(descriptor, 1000, 0).decode(errors="replace")
    holder, _, kernel = text.partition("\n")
    return holder or "another process", kernel


def _hold(descriptor: int, kernel: str) -> None:
    """Write the name of this process to its lock file and start updating the file."""
    with suppress(OSError):  # a full disk: the lock is held without a name
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"process {os.getpid()} on {platform.node()}\n{kernel}".encode(), 0)
    with _guard:
        _held.add(descriptor)
        if not _heartbeats:
            _heartbeats.append(Thread(target=_beat, name="compile-lock", daemon=True))
            _heartbeats[0].start()


def _close(descriptor: int) -> None:
    """Close a lock file, which releases its lock."""
    with _guard:
        if descriptor in _held:
            _held.remove(descriptor)
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
        os.close(descriptor)


def _beat() -> None:
    """Update the files of the locks that this process holds, until it holds none."""
    while True:
        time.sleep(BEAT_S)
        with _guard:
            for descriptor in _held:
                with suppress(OSError):
                    os.utime(descriptor)
            if not _held:
                _heartbeats.clear()
                return
