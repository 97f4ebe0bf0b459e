"""Sweeps of trials whose work is next to nothing, and the same sweeps of a bare Hydra application.

The trial is the cheapest that can be composed: a vessel of one degree of freedom, forty seconds
without a controller, no identification and no evaluation; 5 ms of work, kept apart below. The bare
application composes the same configuration for the same jobs with Hydra's own sweeper, which reads
the files anew for each, and does nothing with it.

    python -m tests.benchmarks.sweeps ours 1000     seconds, and peak memory [MB], as JSON
"""

import io
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

import hydra
from hydra._internal.core_plugins import basic_launcher, file_config_source
from hydra._internal.sources_registry import SourcesRegistry

from seatrial.runner.__main__ import main
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.database import LogbookReader, LogbookWriter
from seatrial.runner.sweeps import job, sweep
from seatrial.runner.sweeps.composition import Composer, SharingLoader
from seatrial.runner.trials import trial
from tests.benchmarks.memory import peak_megabytes
from tests.runner.command import logging_kept

TRIAL = (
    *("vessel=surge_linear", "excitation=single_ramp"),
    *("identifier=none", "controller=none", "evaluation=none"),
)


@contextmanager
def started(*arguments: str) -> Iterator[Path]:
    """A command line, a folder for its results, and nothing of what it prints."""
    with (
        tempfile.TemporaryDirectory() as folder,
        logging_kept(),
        redirect_stdout(io.StringIO()),
        redirect_stderr(io.StringIO()),
        patch.object(sys, "argv", ["seatrial", "-m", *arguments, f"results_dir={folder}"]),
    ):
        yield Path(folder)


def ours(trials: int) -> float:
    """Seconds that a sweep of so many trials takes, start-up left out; all of them finish."""
    with started(*TRIAL, f"seed=range(0,{trials})") as folder:
        begun = time.perf_counter()
        code = main()
        seconds = time.perf_counter() - begun
        with LogbookWriter.read(f"sqlite:///{folder}/results.db") as logbook:
            ended = Counter(run.status for run in logbook.runs())
    assert (code, ended) == (0, {"finished": trials})
    return seconds


def planned(trials: int) -> float:
    """Seconds of CPU that planning so many trials takes, without running them."""
    with started(*TRIAL, f"seed=range(0,{trials})", "dry_run=true"):
        begun = time.process_time()
        assert main() == 0
        return time.process_time() - begun


def bare(trials: int) -> float:
    """Seconds that a bare Hydra application takes for as many jobs."""
    seen = []
    of_hydra = {"file": file_config_source.FileConfigSource}
    with (
        started(*TRIAL, f"seed=range(0,{trials})", "hydra/sweeper=basic"),
        patch.dict(SourcesRegistry.instance().types, of_hydra),
    ):
        begun = time.perf_counter()
        hydra.main(config_path=str(CONF), config_name="trial", version_base="1.3")(
            lambda config: seen.append(config.seed)
        )()
        seconds = time.perf_counter() - begun
    assert seen == list(range(trials))
    return seconds


def parts(trials: int) -> dict[str, float]:
    """Seconds in each step of a sweep, all trials together; `whole` is the sweep."""
    spent: Counter[str] = Counter()

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            begun = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                spent[name] += time.perf_counter() - begun

        return call

    steps = (
        ("planning: compose", Composer, "order"),
        ("planning: check and fingerprint", sweep, "plan_of"),
        ("planning: ask the logbook", sweep, "known"),
        ("job: compose", SharingLoader, "load_sweep_config"),
        ("job in all", basic_launcher, "run_job"),
        ("job of ours", sweep.SweepJob, "__call__"),
        ("job: fingerprint", job, "fingerprint"),
        ("open the logbook", LogbookWriter, "open"),
        ("close the logbook", LogbookWriter, "close"),
        ("begin the run", LogbookWriter, "begin_run"),
        ("store the results", LogbookWriter, "finish_run"),
        ("work", trial, "run"),
        ("progress, in its thread", LogbookReader, "sweep_status"),
    )
    with ExitStack() as patched:
        for what, owner, name in steps:
            call = timed(what, getattr(owner, name))
            patched.enter_context(patch.object(owner, name, call))
        whole = ours(trials)
    job_setup = spent.pop("job in all") - spent.pop("job of ours")
    return {"whole": whole, "Hydra's own job set-up": job_setup, **spent}


if __name__ == "__main__":
    kind, count = sys.argv[1], int(sys.argv[2])
    work = {"ours": ours, "planned": planned, "bare": bare}[kind]
    work(2)  # imports and compiles
    took = work(count)
    print(json.dumps({"seconds": took, "megabytes": peak_megabytes()}))
