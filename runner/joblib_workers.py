"""Worker processes of joblib: signals of the terminal, and the end of a sweep or of a worker."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

from hydra.plugins.launcher import Launcher

from seatrial.runner.background import in_background
from seatrial.runner.stop_signals import shielded_children

POLL_S = 0.5
STUCK_S = 5.0  # after the loss of a worker: joblib notices it at once unless it waits for the rest


@contextmanager
def joblib_workers(launcher: Launcher) -> Iterator[None]:
    """Let the workers that Hydra's joblib launcher starts in the block end with this process.

    A terminal does not interrupt them, and the loss of one ends them all.
    """
    ends = {"initializer": end_with, "initargs": (os.getpid(),)}
    launcher.joblib = {**launcher.joblib, **ends}  # type: ignore[attr-defined]
    with shielded_workers(), broken_if_stuck():
        yield


@contextmanager
def broken_if_stuck() -> Iterator[None]:
    """Break the pool of workers in the block if it waits for ever after the loss of a worker.

    joblib waits for the rest of a message, and another worker for its turn, if a worker is killed
    while it sends a result. Without any process that could send it, the message ends.
    """
    with in_background(_break_if_stuck):
        yield


def _break_if_stuck(ended: Event) -> None:
    from joblib.externals.loky import reusable_executor

    lost_at: float | None = None
    while not ended.wait(POLL_S):
        pool = reusable_executor._executor
        processes = [] if pool is None else list(pool._processes.values())
        if pool is None or pool._flags.broken or not any(p.exitcode for p in processes):
            lost_at = None
            continue
        lost_at = lost_at or time.monotonic()
        if time.monotonic() - lost_at > STUCK_S:
            for process in processes:
                process.terminate()
            pool._result_queue._writer.close()
            return


@contextmanager
def shielded_workers() -> Iterator[None]:
    """Keep Ctrl-C and SIGHUP of the terminal from worker processes started in the block.

    joblib ends them when this process is interrupted.
    """
    from multiprocessing import resource_tracker

    from joblib.externals.loky.backend import resource_tracker as joblib_tracker

    with shielded_children() as shield:
        resource_tracker.ensure_running()  # both now, since they unblock SIGINT after their start
        joblib_tracker.ensure_running()
        shield()
        yield


def end_with(parent: int) -> None:
    """End this process soon after its parent, the process of the sweep, has ended.

    A worker of joblib would wait in a pipe that the other workers keep open, also one that has not
    had a trial yet.
    """
    Thread(target=_end_with, args=(parent,), name="parent", daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_S)
    os._exit(1)
