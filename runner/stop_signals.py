"""SIGINT, SIGTERM and SIGHUP end the program once, by an exception in the main thread.

An exception that is raised during an import leaves half a module behind, one in the midst of a
transaction a lock, one between the claim of a run and its note a run that nobody ends; libraries
log one that is raised during their clean-up with its traceback, or raise another in its place.
There the signal is sent again a moment later. So is a signal whose exception was dropped, as Python
does in finalisers and callbacks.

A terminal sends SIGINT and SIGHUP to all processes of a command at once. One that does not run this
program's code, or does not yet, would print a traceback: it inherits a mask that blocks them.
"""

import _thread
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from threading import Event, Lock, current_thread, main_thread
from types import FrameType

from seatrial.runner.background import in_background

ALL = ("SIGINT", "SIGTERM", "SIGHUP")
TERMINAL = {getattr(signal, name) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name)}
AGAIN_S = 0.05
PATIENCE_S = 5.0  # with an import, a transaction or a clean-up
LOST_S = 10.0  # after which the exception of a program that has not ended counts as dropped
DELICATE = (
    "importlib._bootstrap",
    "logging",
    "omegaconf",
    "seatrial.runner.database.liveness",
    "seatrial.runner.database.logbook",
    "sqlalchemy",
)


class StopSignal(KeyboardInterrupt):
    """One of the signals; they end the program in the same way as Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class StopSignals:
    """The handlers of the signals; `number` is that of the one that has stopped the program."""

    def __init__(self) -> None:
        self.number: int | None = None
        self._first: float | None = None  # when the first signal came
        self._ended = False
        self._lock = Lock()  # not taken by a handler: it may interrupt its holder

    @contextmanager
    def listening(self, names: Sequence[str] = ALL) -> Iterator[None]:
        """Handle the signals in the block; an ignored signal (nohup) stays ignored."""
        names = [name for name in names if hasattr(signal, name)]
        before = {number: signal.getsignal(number) for number in (signal.Signals[n] for n in names)}
        hook, sys.unraisablehook = sys.unraisablehook, self._dropped(sys.unraisablehook)
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, self._handle)
        try:
            yield
        finally:
            with self._lock:
                self._ended = True
            sys.unraisablehook = hook
            for number, handler in before.items():
                signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.number is not None and number != signal.SIGINT:
            return  # the clean-up goes on; a second Ctrl-C ends it
        now = time.monotonic()
        self._first = now if self._first is None else self._first
        if _is_delicate(frame) and now < self._first + PATIENCE_S:
            self._send(number, AGAIN_S)
            return
        self.number = number
        self._send(number, LOST_S)
        raise StopSignal(number)

    def _send(self, number: int, later_s: float) -> None:
        """Send a signal later; Thread.start takes a lock that a handler may have interrupted."""
        _thread.start_new_thread(self._send_later, (number, later_s))

    def _send_later(self, number: int, later_s: float) -> None:
        time.sleep(later_s)
        with self._lock:
            if not self._ended:
                self.number = None
                os.kill(os.getpid(), number)

    def _dropped(
        self, hook: Callable[["sys.UnraisableHookArgs"], object]
    ) -> Callable[["sys.UnraisableHookArgs"], None]:
        def unraisable(dropped: "sys.UnraisableHookArgs") -> None:
            if isinstance(dropped.exc_value, StopSignal):
                self._send(dropped.exc_value.number, AGAIN_S)
            else:
                hook(dropped)

        return unraisable


def _is_delicate(frame: FrameType | None) -> bool:
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith(DELICATE):
            return True
        frame = frame.f_back
    return False


@contextmanager
def shielded_children() -> Iterator[Callable[[], object]]:
    """Keep SIGINT and SIGHUP of the terminal from processes that are started in the block.

    They inherit a mask that blocks both, which the yielded function sets again. A thread passes the
    signals on to the handlers of this process.
    """
    if not hasattr(signal, "pthread_sigmask") or current_thread() is not main_thread():
        yield lambda: None
        return
    shield = partial(signal.pthread_sigmask, signal.SIG_BLOCK, TERMINAL)
    before = shield()
    # A signal without effect, which ends a system call that the main thread waits in.
    waking = signal.signal(signal.SIGURG, lambda number, frame: None)
    try:
        with in_background(_pass_on):
            yield shield
    finally:
        signal.signal(signal.SIGURG, waking)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _pass_on(ended: Event) -> None:
    # Not sigtimedwait: after a suspension it returns signals that were not sent.
    main = main_thread().ident or 0
    while not ended.wait(0.1):
        if TERMINAL & signal.sigpending():
            number = signal.Signals(signal.sigwait(TERMINAL))
            _thread.interrupt_main(number)  # does nothing where the signal is ignored
            signal.pthread_kill(main, signal.SIGURG)


def leave_shield() -> None:
    """Let SIGINT and SIGHUP end this process, also those that came before."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINAL)
