"""Launch of the trials of a sweep with Hydra's launchers, and recovery from lost workers.

basic    runs the trials in this process, one after the other; a lost process ends the sweep
joblib   a killed worker breaks the pool of workers, and ends the sweep
others   (submitit, ray) the other trials go on, and the lost trials are launched once more

The logbook holds the state of trials whose launcher has lost them, and prevents that a trial is run
twice: a trial that is launched again while it is running remains with its process.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

from hydra.core.utils import JobStatus
from hydra.plugins.launcher import Launcher

from seatrial.models.errors import ConfigurationError
from seatrial.runner.job import Outcome, Plan, states
from seatrial.runner.joblib_workers import joblib_workers
from seatrial.runner.stop_signals import shielded_children
from seatrial.runner.vocabulary import ENDINGS

POOL_LOST = (
    "a worker process was killed or ran out of memory, which ends the sweep: "
    "finished runs are kept, the same command runs the rest"
)
# Libraries read these variables when a worker starts; a trial uses one thread.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
WAIT_S = 0.5
# submitit starts one process per job at once; basic holds the configurations of all its jobs.
AT_ONCE = {"submitit_local": os.cpu_count(), "basic": 32}


@dataclass
class LaunchResult:
    """The outcomes of a sweep's trials that the launcher reported; the logbook holds the rest."""

    outcomes: list[Outcome] = field(default_factory=list)
    bugs: list[Exception] = field(default_factory=list)  # exceptions that are not stored in a row
    error: str | None = None  # why the rest was not launched


def launch(
    make: Callable[[], Launcher],
    choice: str,
    plans: Sequence[Plan],
    sweep_id: int,
    size: int | None,
) -> LaunchResult:
    """Run the plans with the launcher that `make` creates, at most `size` of them at a time.

    Raises ConfigurationError if the launcher `choice` cannot be used here.
    """
    launched = LaunchResult()
    if not plans:
        return launched
    launcher = make()
    if choice == "submitit_slurm":
        from seatrial.runner.slurm_queue import watch_the_queue

        watch_the_queue()
    size = size or AT_ONCE.get(choice) or len(plans)
    with _single_threaded_workers(), _workers(choice, launcher):
        for start in range(0, len(plans), size):
            batch = plans[start : start + size]
            try:
                if not _launch_batch(launcher, batch, start, launched):
                    _relaunch_lost(launcher, batch, start, sweep_id, launched)
            except BrokenProcessPool:
                launched.error = POOL_LOST
                break
            except Exception as error:
                message = " ".join(str(error).split()) or type(error).__name__
                raise ConfigurationError(f"hydra/launcher={choice}: {message}") from error
    return launched


def _workers(choice: str, launcher: Launcher) -> AbstractContextManager[object]:
    """Around the workers of a launcher on this machine: who gets signals, and what ends them."""
    if choice == "joblib":
        return joblib_workers(launcher)
    # submitit starts a process for each trial, which gets signals, and one that waits for it
    return shielded_children() if choice == "submitit_local" else nullcontext()


def _launch_batch(
    launcher: Launcher, batch: Sequence[Plan], start: int, launched: LaunchResult
) -> bool:
    """Launch a batch; returns False if the launcher lost one of its workers."""
    overrides = [list(plan.overrides) for plan in batch]
    try:
        returns = launcher.launch(overrides, initial_job_idx=start)
    except Exception as error:
        if _is_loss(error):
            return False
        raise
    for job in returns:
        completed = job.status is JobStatus.COMPLETED
        (launched.outcomes if completed else launched.bugs).append(job._return_value)
    return True


def _is_loss(error: Exception) -> bool:
    """Return whether an error of a launcher means that a worker was lost."""
    kinds = {(kind.__module__.partition(".")[0], kind.__name__) for kind in type(error).__mro__}
    return ("submitit", "UncompletedJobError") in kinds or ("ray", "RayError") in kinds


def _relaunch_lost(
    launcher: Launcher, batch: Sequence[Plan], start: int, sweep_id: int, launched: LaunchResult
) -> None:
    """Launch the lost trials of a batch once more, after the other trials have ended."""
    lost = _wait_for_end(batch, sweep_id)
    if lost:
        _launch_batch(launcher, lost, start, launched)  # there is no third attempt
        _wait_for_end(lost, sweep_id)


def _wait_for_end(batch: Sequence[Plan], sweep_id: int) -> list[Plan]:
    """Wait until no trial of a batch is running; returns the trials that did not end."""
    url = batch[0].database_url
    while "running" in (known := states(url, sweep_id, batch)).values():
        time.sleep(WAIT_S)
    return [plan for plan in batch if known.get(plan.fingerprint) not in ENDINGS]


@contextmanager
def _single_threaded_workers() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
