"""The trials of a sweep, handed to Hydra's launcher, and what happens when a worker is lost.

basic    runs them here, one after the other; what ends it ends the sweep
joblib   a killed worker breaks the whole pool (loky's rule), and with it the sweep
others   (submitit, ray) the other trials go on, and those that were lost are launched once more

The logbook knows what came of a trial whose launcher does not, and sees to it that nothing is run
twice: a trial that is launched again while it is under way is left to the process that has it.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field

from hydra.core.utils import JobStatus
from hydra.plugins.launcher import Launcher

from seatrial.models.errors import ConfigurationError
from seatrial.runner.job import ENDED, Outcome, Plan, states

POOL_LOST = (
    "a worker process was killed, or ran out of memory, and that ends the sweep: "
    "finished runs are kept, the same command runs the rest"
)
# Read by the libraries when a worker starts; a trial uses one thread.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
WAIT_S = 0.5
# submitit starts a process a job at once; basic keeps the configurations of all jobs it was given.
AT_ONCE = {"submitit_local": os.cpu_count(), "basic": 32}


@dataclass
class Launched:
    """What came of a sweep's trials, as far as the launcher knows; the logbook knows the rest."""

    outcomes: list[Outcome] = field(default_factory=list)
    bugs: list[Exception] = field(default_factory=list)  # exceptions that no row holds
    error: str | None = None  # why the rest was not launched


def check(choice: str, arguments: Sequence[str]) -> None:
    """ConfigurationError where the launcher would write a password into its files."""
    from seatrial.runner.database import without_passwords

    if choice.startswith("submitit") and any(without_passwords(one) != one for one in arguments):
        raise ConfigurationError(
            f"hydra/launcher={choice} writes its jobs to files, and the password of database.url"
            " with them: expected the address in SEATRIAL_DATABASE, and database=postgresql"
        )


def launch(
    make: Callable[[], Launcher],
    choice: str,
    plans: Sequence[Plan],
    sweep_id: int,
    size: int | None,
) -> Launched:
    """Run the plans with the launcher that `make` makes, at most `size` of them at a time.

    Raises ConfigurationError where the launcher `choice` cannot be used here.
    """
    launched = Launched()
    if not plans:
        return launched
    launcher = make()
    if choice == "submitit_slurm":
        from seatrial.runner.slurm_queue import watch_the_queue

        watch_the_queue()
    size = size or AT_ONCE.get(choice) or len(plans)
    with _single_threaded_workers():
        for start in range(0, len(plans), size):
            batch = plans[start : start + size]
            try:
                if not _launched(launcher, batch, start, launched):
                    _again(launcher, batch, start, sweep_id, launched)
            except BrokenProcessPool:
                launched.error = POOL_LOST
                break
            except Exception as error:
                said = " ".join(str(error).split()) or type(error).__name__
                raise ConfigurationError(f"hydra/launcher={choice}: {said}") from error
    return launched


def _launched(launcher: Launcher, batch: Sequence[Plan], start: int, launched: Launched) -> bool:
    """Launch a batch; False where the launcher lost one of its workers."""
    overrides = [list(plan.order.overrides) for plan in batch]
    try:
        returns = launcher.launch(overrides, initial_job_idx=start)
    except Exception as error:
        if _is_loss(error):
            return False
        raise
    for one in returns:
        done = one.status is JobStatus.COMPLETED
        (launched.outcomes if done else launched.bugs).append(one._return_value)
    return True


def _is_loss(error: Exception) -> bool:
    """Whether a launcher says that a worker died, and not that it cannot work at all."""
    kinds = {(kind.__module__.partition(".")[0], kind.__name__) for kind in type(error).__mro__}
    return ("submitit", "UncompletedJobError") in kinds or ("ray", "RayError") in kinds


def _again(
    launcher: Launcher, batch: Sequence[Plan], start: int, sweep_id: int, launched: Launched
) -> None:
    """Launch once more what was lost of a batch, once the rest of it has ended."""
    undone = _settled(batch, sweep_id)
    if undone:
        _launched(launcher, undone, start, launched)  # lost again: then it is left at that
        _settled(undone, sweep_id)


def _settled(batch: Sequence[Plan], sweep_id: int) -> list[Plan]:
    """Wait until nothing of a batch is under way any more; the answer is what did not end."""
    url = batch[0].trial.database_url
    while "running" in (known := states(url, sweep_id, batch)).values():
        time.sleep(WAIT_S)
    return [plan for plan in batch if known.get(plan.fingerprint) not in ENDED]


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
