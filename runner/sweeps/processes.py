"""The launcher of worker processes on this machine: `hydra/launcher=processes`.

Each worker has a pipe of its own. When a worker is killed, also while it sends a result, its pipe
ends: its job is lost, and the other workers go on. A worker ends with the process of the sweep.
"""

import logging
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from threading import Thread
from types import ModuleType

from hydra.core.utils import JobReturn, run_job, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from hydra.version import setbase
from omegaconf import DictConfig, open_dict

from seatrial.runner.sweeps.stop_signals import StopSignals

PATIENCE_S = 5.0  # with a worker that is to end, before it is killed
SPAWN = get_context("spawn")  # a fork would copy the locks of this process's threads
TERMINAL = (signal.SIGINT, signal.SIGHUP)  # which a terminal sends to all processes of a command
log = logging.getLogger(__name__)


class Processes(Launcher):
    """Runs the jobs of a sweep in worker processes, which stay for its next batch of jobs.

    Args:
        n_jobs: largest number of processes; -1: one for each core.
    """

    def __init__(self, n_jobs: int = -1) -> None:
        self._n_jobs = n_jobs
        self._workers: dict[Connection, SpawnProcess] = {}

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Store what the workers need."""
        self._context, self._task, self._config = hydra_context, task_function, config

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> list[JobReturn]:
        """Run the jobs; the result of a job whose worker was lost has the status UNKNOWN.

        Raises RuntimeError if a worker ends by itself, as one that cannot start.
        """
        from joblib import cpu_count  # heeds the limits of a container

        most = cpu_count() if self._n_jobs < 0 else self._n_jobs
        results, busy = [JobReturn() for _ in job_overrides], dict[Connection, int]()
        jobs = self._composed(job_overrides, initial_job_idx)
        job = next(jobs, None)
        while job is not None or busy:
            idle = self._workers.keys() - busy.keys()
            if job is not None and (idle or len(self._workers) < most):
                worker = idle.pop() if idle else self._start()
                busy[worker] = job[0]
                with suppress(OSError):  # it was lost, as the end of its pipe will tell
                    worker.send(job[1])
                job = next(jobs, None)  # composed while the workers are busy
                continue
            ready = wait(busy)
            for worker in [one for one in busy if one in ready]:
                number = busy.pop(worker)
                try:
                    results[number] = worker.recv()
                except (EOFError, OSError):
                    self._forget(worker)
        return results

    def _composed(
        self, job_overrides: Sequence[Sequence[str]], first: int
    ) -> Iterator[tuple[int, DictConfig]]:
        """Yield place and configuration of each job; `first` is the number of the first."""
        for place, overrides in enumerate(job_overrides):
            config = self._context.config_loader.load_sweep_config(self._config, list(overrides))
            with open_dict(config):
                config.hydra.job.num = first + place
                config.hydra.job.id = f"{config.hydra.job.name}_{config.hydra.job.num}"
            yield place, config

    def _start(self) -> Connection:
        """Start a worker; it inherits a mask that blocks the signals of the terminal.

        It would import the main module of this program, and so run a user's script again.
        """
        worker, other = SPAWN.Pipe()
        process = SPAWN.Process(target=work, args=(other,))
        before, main = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL), sys.modules["__main__"]
        try:
            resource_tracker.ensure_running()  # a process that the first worker would start
            signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)  # its start has unblocked SIGINT
            sys.modules["__main__"] = ModuleType("__main__")
            process.start()
            self._workers[worker] = process
        finally:
            sys.modules["__main__"] = main
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        other.close()
        with suppress(OSError):
            worker.send((self._context, self._task))
        return worker

    def _forget(self, worker: Connection) -> None:
        """Forget a worker that was lost; raises RuntimeError if it has ended by itself."""
        process = self._workers.pop(worker)
        process.join(PATIENCE_S)
        process.kill()  # has no effect on one that has ended
        process.join()
        worker.close()
        code = process.exitcode
        if code is not None and 0 <= code < 128:
            raise RuntimeError(f"a worker has ended with exit code {code}")
        log.warning("a worker process was killed, or ran out of memory (exit code %s)", code)

    def close(self) -> None:
        """End the workers."""
        for process in self._workers.values():
            process.terminate()
        until = time.monotonic() + PATIENCE_S
        while self._workers:
            worker, process = self._workers.popitem()
            process.join(max(0.0, until - time.monotonic()))
            process.kill()
            process.join()
            worker.close()


def work(pipe: Connection) -> None:
    """Do the jobs that come through the pipe, until SIGTERM comes or the parent process ends."""
    Thread(target=_end_with_parent, name="parent", daemon=True).start()
    stop = StopSignals()
    try:
        with stop.listening(["SIGTERM"]):
            setbase("1.3")
            setup_globals()
            context, task = pipe.recv()
            while True:
                job = run_job(task, pipe.recv(), "hydra.sweep.dir", "hydra.sweep.subdir", context)
                pipe.send(replace(job, cfg=None, hydra_cfg=None))
    except BaseException as error:  # what a signal has interrupted may fail by any exception
        if stop.number is not None:
            sys.exit(128 + stop.number)
        if not isinstance(error, EOFError | ConnectionError):
            raise


def _end_with_parent() -> None:
    """End this process with the process of the sweep, also in the middle of a job."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
