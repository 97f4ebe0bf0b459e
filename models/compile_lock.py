"""One process compiles a kernel, the others wait for it and then load what it wrote.

A lock a kernel, as an advisory lock (flock) on a file that names its holder: the system releases
it whatever ends the process. While a process holds any lock a thread of it touches the files
every second. A holder that does not for ten seconds is suspended, or its machine is gone: then the
waiting process compiles as well, and does not wait for that holder again.
"""

import errno
import fcntl
import logging
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock, Thread

log = logging.getLogger(__name__)
BEAT_S = 1.0  # between two signs of life of a holder
STALLED_S = 10.0  # without one: the holder is suspended
POLL_S = 0.05
_held: set[int] = set()  # file descriptors of the locks that this process has
_beating: list[Thread] = []  # the thread that touches them, while there is one
_guard = Lock()  # of both: a descriptor must not be closed while the thread touches its file
_stalled: set[str] = set()  # holders that are not waited for any more
_named: set[str] = set()  # holders that a message named


class CompileLock:
    """The right to compile one kernel; a process may take it again while it has it."""

    def __init__(self, path: Path, kernel: str) -> None:
        self._path, self._kernel = path, kernel
        self._depth = 0
        self._descriptor: int | None = None  # of the file, while it is open

    @contextmanager
    def scope(self) -> Iterator[None]:
        """Release on leaving, however that happens, what was taken inside."""
        before = self._depth
        try:
            yield
        finally:
            while self._depth > before:
                self._release()

    def acquire(self) -> None:
        """Return when the kernel may be compiled: with the lock, or in spite of a stalled holder.

        To be called within `scope`.
        """
        self._depth += 1
        if self._depth > 1:
            return
        _stopwatch.begin()
        with suppress(OSError):  # a folder that cannot be written: nothing is shared
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


def seconds_compiled() -> float:
    """Time [s] that this process has spent on compiling, waiting for other compilers included."""
    return _stopwatch.seconds()


class _Stopwatch:
    """The time between the first lock taken and the last one released, summed up."""

    def __init__(self) -> None:
        self._total_s, self._since_s, self._depth = 0.0, 0.0, 0

    def begin(self) -> None:
        if self._depth == 0:
            self._since_s = time.monotonic()
        self._depth += 1

    def end(self) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._total_s += time.monotonic() - self._since_s

    def seconds(self) -> float:
        running = time.monotonic() - self._since_s if self._depth else 0.0
        return self._total_s + running


_stopwatch = _Stopwatch()


def _lock(descriptor: int) -> bool:
    """Wait for the lock; False where its holder is stalled, or the file system has no locks."""
    last: tuple[str, int] | None = None
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
        seen = (holder, os.fstat(descriptor).st_mtime_ns)
        if seen != last:
            last, since = seen, time.monotonic()
        if holder in _stalled:
            return False
        if time.monotonic() - since > STALLED_S:
            _stalled.add(holder)
            log.warning(
                "%s, which compiles %s, shows no sign of life for %g s: compiling without it",
                holder, kernel, STALLED_S,
            )  # fmt: skip
            return False
        if kernel and holder not in _named:
            _named.add(holder)
            log.info("waiting for %s, which compiles %s", holder, kernel)
        time.sleep(POLL_S)


def _holder(descriptor: int) -> tuple[str, str]:
    """The process that a lock file names, and the kernel; before it has written, unknown."""
    text = os.pread(descriptor, 1000, 0).decode(errors="replace")
    holder, _, kernel = text.partition("\n")
    return holder or "another process", kernel


def _hold(descriptor: int, kernel: str) -> None:
    """Name this process in its lock file and keep the file fresh."""
    with suppress(OSError):  # a full disk: the lock holds all the same, without a name
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"process {os.getpid()} on {platform.node()}\n{kernel}".encode(), 0)
    with _guard:
        _held.add(descriptor)
        if not _beating:
            _beating.append(Thread(target=_beat, name="compile-lock", daemon=True))
            _beating[0].start()


def _close(descriptor: int) -> None:
    """Close a lock file, which releases the lock where it is held."""
    with _guard:
        if descriptor in _held:
            _held.remove(descriptor)
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
        os.close(descriptor)


def _beat() -> None:
    """Touch the files of the locks that this process holds, until it holds none."""
    while True:
        time.sleep(BEAT_S)
        with _guard:
            for descriptor in _held:
                with suppress(OSError):
                    os.utime(descriptor)
            if not _held:
                _beating.clear()
                return
