"""SIGINT, SIGTERM and SIGHUP end the program once, by an exception in the main thread.

An exception that is raised in the midst of a transaction leaves a lock, one between the claim of a
run and its note a run that nobody ends, one during an import half a module, one at the start of a
worker a process that fails with a traceback; libraries log one that is raised during their clean-up
with its traceback, or raise another in its place. There the signal is handled a moment later, by a
timer. So is a signal whose exception was dropped, as Python does in finalisers and callbacks.
"""

import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

ALL = ("SIGINT", "SIGTERM", "SIGHUP")
AGAIN_S = 0.05
PATIENCE_S = 5.0  # with an import, a transaction or a clean-up
LOST_S = 10.0  # after which the exception of a program that has not ended counts as dropped
DELICATE = (
    *("importlib._bootstrap", "logging", "omegaconf", "sqlalchemy"),
    "multiprocessing.popen_spawn_posix",
    *("seatrial.runner.database.claims", "seatrial.runner.database.logbook"),
)


class StopSignal(KeyboardInterrupt):
    """One of the signals; they end the program in the same way as Ctrl-C."""


class StopSignals:
    """The handlers of the signals; `number` is that of the one that stops the program."""

    def __init__(self) -> None:
        self.number: int | None = None
        self._first_s = 0.0  # when it came
        self._timer: tuple[float, float] | None = None  # the one that ours has replaced

    @contextmanager
    def listening(self, names: Sequence[str] = ALL) -> Iterator[None]:
        """Handle the signals in the block; an ignored signal (nohup) stays ignored."""
        numbers = [signal.Signals[name] for name in names]
        before = {number: signal.getsignal(number) for number in (*numbers, signal.SIGALRM)}
        self._hook, sys.unraisablehook = sys.unraisablehook, self._unraisable
        for number in numbers:
            if before[number] is not signal.SIG_IGN:
                signal.signal(number, self._handle)
        try:
            yield
        finally:
            if self._timer is not None:
                signal.setitimer(signal.ITIMER_REAL, *self._timer)
            sys.unraisablehook = self._hook
            for number, handler in before.items():
                signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number != signal.SIGALRM:
            if self.number is not None and number != signal.SIGINT:
                return  # the clean-up goes on; a second Ctrl-C ends it
            self._first_s = time.monotonic() if self.number is None else self._first_s
            self.number = number
        if _is_delicate(frame) and time.monotonic() < self._first_s + PATIENCE_S:
            self._again(AGAIN_S)
            return
        self._again(LOST_S)
        raise StopSignal(self.number)

    def _again(self, after_s: float) -> None:
        signal.signal(signal.SIGALRM, self._handle)
        timer = signal.setitimer(signal.ITIMER_REAL, after_s)
        self._timer = self._timer or timer

    def _unraisable(self, dropped: "sys.UnraisableHookArgs") -> None:
        if isinstance(dropped.exc_value, StopSignal):
            self._again(AGAIN_S)
        else:
            self._hook(dropped)


def _is_delicate(frame: FrameType | None) -> bool:
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith(DELICATE):
            return True
        frame = frame.f_back
    return False
