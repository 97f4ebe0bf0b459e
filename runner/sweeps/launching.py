"""Launch of the trials of a sweep with Hydra's launchers, and recovery from lost workers.

basic              runs the trials in this process; a lost process ends the sweep
processes, ray,    the other trials go on, and the lost trials are launched once more
submitit_slurm

The logbook holds the state of trials whose launcher has lost them, and prevents that a trial is run
twice: a trial that is launched again while it is running remains with its process.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass, field

from hydra.core.utils import JobStatus
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig

from seatrial.models.errors import ConfigurationError
from seatrial.runner.record.vocabulary import ENDINGS
from seatrial.runner.sweeps.job import Outcome, PlannedTrial, states
from seatrial.runner.sweeps.processes import Processes

# Libraries read these variables when a worker starts; a trial uses one thread.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
WAIT_S = 0.5
BASIC = 32  # jobs that the basic launcher is given at once: it holds their configurations


@dataclass
class LaunchResult:
    """The outcomes of a sweep's trials that the launcher reported; the logbook holds the rest."""

    outcomes: list[Outcome] = field(default_factory=list)
    bugs: list[Outcome] = field(default_factory=list)  # not stored in a row


def check(options: DictConfig) -> None:
    """Raise ConfigurationError for wrong options of the launcher `processes`."""
    number = options.get("n_jobs", -1)
    if isinstance(number, bool) or not isinstance(number, int) or (number < 1 and number != -1):
        expected = "expected a number of processes, or -1 for one on each core"
        raise ConfigurationError(f"hydra.launcher.n_jobs: got {number}, {expected}")


@contextmanager
def ready(make: Callable[[], Launcher], choice: str) -> Iterator[Launcher]:
    """Create the launcher `choice`; its workers end with the block, however it ends."""
    launcher = make()
    workers: AbstractContextManager[object] = nullcontext()
    if isinstance(launcher, Processes):
        workers = closing(launcher)
    elif choice == "submitit_slurm":
        from seatrial.runner.sweeps.slurm_queue import watched_queue

        workers = watched_queue()
    with workers:
        yield launcher


def launch(
    launcher: Launcher, choice: str, plans: Sequence[PlannedTrial], sweep_id: int, size: int | None
) -> LaunchResult:
    """Run the plans with a launcher, at most `size` of them at a time.

    Raises ConfigurationError if the launcher cannot be used here.
    """
    launched = LaunchResult()
    size = size or (BASIC if choice == "basic" else max(len(plans), 1))
    with _one_thread():
        for start in range(0, len(plans), size):
            batch = plans[start : start + size]
            try:
                if _launch_batch(launcher, batch, start, launched):
                    continue
                lost = _wait_for_end(batch, sweep_id)
                if lost:
                    _launch_batch(launcher, lost, start, launched)  # there is no third attempt
                    _wait_for_end(lost, sweep_id)
            except Exception as error:
                message = " ".join(str(error).split()) or type(error).__name__
                raise ConfigurationError(f"hydra/launcher={choice}: {message}") from error
    return launched


def _launch_batch(
    launcher: Launcher, batch: Sequence[PlannedTrial], start: int, launched: LaunchResult
) -> bool:
    """Launch a batch; returns False if the launcher lost one of its workers."""
    try:
        jobs = launcher.launch([list(plan.overrides) for plan in batch], initial_job_idx=start)
    except Exception as error:
        kinds = {(kind.__module__.partition(".")[0], kind.__name__) for kind in type(error).__mro__}
        if kinds & {("submitit", "UncompletedJobError"), ("ray", "RayError")}:
            return False
        raise
    ended = [job.return_value for job in jobs if job.status is not JobStatus.UNKNOWN]
    launched.outcomes += [outcome for outcome in ended if outcome.state != "bug"]
    launched.bugs += [outcome for outcome in ended if outcome.state == "bug"]
    return len(ended) == len(jobs)


def _wait_for_end(batch: Sequence[PlannedTrial], sweep_id: int) -> list[PlannedTrial]:
    """Wait until no trial of a batch is running; returns the trials that did not end."""
    url = batch[0].database_url
    while "running" in (known := states(url, sweep_id, batch)).values():
        time.sleep(WAIT_S)
    return [plan for plan in batch if known.get(plan.fingerprint) not in ENDINGS]


@contextmanager
def _one_thread() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
