"""Trials and sweeps that are called from Python, in the caller's process.

They take the path of the command line: the same composition, checks, launchers and logbook. Hydra
keeps its state in singletons, which are as before afterwards; so is the working folder. Ctrl-C ends
a trial once, by KeyboardInterrupt, and the same call runs it again.
"""

import shlex
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from copy import deepcopy
from dataclasses import replace
from threading import current_thread, main_thread

from hydra import initialize_config_dir
from hydra._internal.hydra import Hydra
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.core.singleton import Singleton
from hydra.types import RunMode
from omegaconf import DictConfig

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner.configuration.fingerprint import Provenance, collect
from seatrial.runner.configuration.hydra_errors import EXPECTED, one_line, refuse_gone
from seatrial.runner.configuration.invocation import import_from_working_folder, trial_program
from seatrial.runner.configuration.search_path import CONF, UserFolders
from seatrial.runner.database.terminal import error_line, refuse_passwords
from seatrial.runner.sweeps.composition import left_to_jobs, order_of, spread
from seatrial.runner.sweeps.job import Order
from seatrial.runner.sweeps.processes import Processes
from seatrial.runner.sweeps.search import SearchSweeper
from seatrial.runner.sweeps.stop_signals import StopSignal, StopSignals
from seatrial.runner.sweeps.sweep import SeatrialSweeper, Session
from seatrial.runner.sweeps.yaml_files import FileConfigSource

# Every composition copies the store, of which nobody writes to the copies.
ConfigStore.__deepcopy__ = lambda store, memo: store  # type: ignore[attr-defined]


class Call(Session):
    """A call from Python, stored as the command of some words and variants that does the same.

    It prints nothing; `lines` are what the command prints.
    """

    def __init__(self, words: Sequence[str], variants: Sequence[Sequence[str]] = ()) -> None:
        super().__init__()
        named = [word for one in variants for word in ("--variant", shlex.join(one))]
        self._command = f"{trial_program()} {shlex.join([*words, *named])}"
        self.variants = [*map(list, variants)]
        self.lines: list[str] = []

    def say(self, lines: Iterable[str]) -> None:
        """Keep the lines."""
        self.lines += lines

    def show_table(self, url: str, sweep_id: int, factors: Sequence[str]) -> None:
        """Leave the table to the caller, who asks for it."""

    def provenance(self) -> Provenance:
        """Return where the results come from, with the command that gives them as well."""
        return replace(collect(), command=self._command)


def run_trial(overrides: Sequence[str]) -> Call:
    """Run one trial; the call has its outcome, errors of the trial included.

    Raises SeatrialError, in one line, if the trial cannot be run.
    """
    call, overrides = Call(overrides), spread(overrides)
    with hydra_of(overrides, call) as hydra:
        config = _composed(hydra, overrides)
        if config.hydra.mode is RunMode.MULTIRUN:
            raise ConfigurationError(f"{' '.join(overrides)}: got a sweep, expected one trial")
        call(config)
        if isinstance(call.error, Exception):
            raise call.error
    return call


def run_sweep(call: Call, overrides: Sequence[str]) -> None:
    """Run the sweep of the overrides and the variants of the call; the call holds the outcome.

    Raises SeatrialError, in one line, if the sweep cannot be run.
    """
    words, call.variants = left_to_jobs(overrides, call.variants)
    # Launchers configure the logging of the process that they run in; the caller's stays as it is.
    words += ["hydra/job_logging=none", "hydra/hydra_logging=none"]
    with hydra_of(overrides, call) as hydra:
        hydra.multirun("trial", call, words, with_log_configuration=False)


def composed(overrides: Sequence[str]) -> Order:
    """Return the resolved configuration of a trial; raises SeatrialError, in one line."""
    overrides = spread(overrides)
    with hydra_of(overrides, Call(overrides)) as hydra:
        config = _composed(hydra, overrides)
        return order_of(config, config.hydra)


def _composed(hydra: Hydra, overrides: Sequence[str]) -> DictConfig:
    """Return the configuration of a trial with Hydra's part, which interpolations find as well."""
    config = hydra.compose_config("trial", list(overrides), run_mode=RunMode.RUN)
    HydraConfig.instance().set_config(config)
    return config


def register(overrides: Sequence[str]) -> None:
    """Make our plugins and source of files known to Hydra; `overrides` are those of the call."""
    plugins = Plugins.instance()
    plugins.class_name_to_class |= {  # as the files of conf/hydra name them
        "hydra_plugins.seatrial.Processes": Processes,
        "hydra_plugins.seatrial.Search": SearchSweeper,
        "hydra_plugins.seatrial.Sweeper": SeatrialSweeper,
    }
    plugins.register(UserFolders)
    SourcesRegistry.instance().types["file"] = FileConfigSource
    FileConfigSource.overrides = overrides


@contextmanager
def hydra_of(overrides: Sequence[str], call: Call) -> Iterator[Hydra]:
    """Provide a Hydra with singletons of its own, and errors in one line."""
    refuse_gone(overrides)
    refuse_passwords(overrides)
    stop, is_main = StopSignals(), current_thread() is main_thread()
    Plugins.instance()  # which searches for plugins, once in a process
    kept, path = Singleton._instances, list(sys.path)
    known = {kind: one for kind, one in kept.items() if kind not in (GlobalHydra, HydraConfig)}
    Singleton._instances = deepcopy(known)
    try:
        with stop.listening(["SIGINT"]) if is_main else nullcontext():
            import_from_working_folder()
            register(overrides)  # before Hydra looks for its sources
            initialize_config_dir(str(CONF), job_name="seatrial", version_base="1.3")
            hydra = GlobalHydra.instance().hydra
            assert hydra is not None
            yield hydra
            if call.trials:
                raise ConfigurationError("dry_run: the command line lists trials, Python runs them")
    except (Exception, StopSignal) as error:
        if stop.number is not None or isinstance(error, StopSignal):
            raise KeyboardInterrupt from None
        # Before the start, any exception of Hydra is about the options; later it is a bug.
        if call.started and not isinstance(error, EXPECTED):
            raise
        line = error_line(one_line(error, overrides))
        if line == str(error) and isinstance(error, SeatrialError):
            raise
        raise ConfigurationError(line) from None
    finally:
        Singleton._instances = kept
        sys.path[:] = path
        FileConfigSource.overrides = ()
