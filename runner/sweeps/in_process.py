"""Trials and sweeps that are called from Python, in the caller's process.

They take the path of the command line: the same composition, checks, launchers and logbook. Hydra
keeps its state in singletons, which are as before afterwards; so is the working folder. Ctrl-C ends
a trial once, by KeyboardInterrupt, and the same call runs it again.
"""

import shlex
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from itertools import chain
from threading import current_thread, main_thread
from typing import TYPE_CHECKING

from hydra import initialize_config_dir
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.core.utils import JobRuntime
from hydra.plugins.plugin import Plugin
from hydra.types import RunMode
from hydra.version import VersionBase

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner.configuration.fingerprint import Provenance, collect
from seatrial.runner.configuration.hydra_errors import EXPECTED, one_line, refuse_gone
from seatrial.runner.configuration.invocation import import_from_working_folder, trial_program
from seatrial.runner.configuration.overrides import left_to_jobs
from seatrial.runner.configuration.search_path import CONF, UserFolders
from seatrial.runner.database.terminal import error_line, refuse_passwords
from seatrial.runner.sweeps.composition import order_of
from seatrial.runner.sweeps.job import Order
from seatrial.runner.sweeps.processes import Processes
from seatrial.runner.sweeps.search import SearchSweeper
from seatrial.runner.sweeps.stop_signals import StopSignal, StopSignals
from seatrial.runner.sweeps.sweep import SeatrialSweeper, Session
from seatrial.runner.sweeps.yaml_files import FileConfigSource

if TYPE_CHECKING:
    from hydra._internal.hydra import Hydra

# As the files of conf/hydra/sweeper and conf/hydra/launcher name them.
PLUGINS: dict[str, type[Plugin]] = {
    "hydra_plugins.seatrial.Processes": Processes,
    "hydra_plugins.seatrial.Search": SearchSweeper,
    "hydra_plugins.seatrial.Sweeper": SeatrialSweeper,
}
# Launchers configure the logging of the process that they run in; the caller's stays as it is.
QUIET = ("hydra/job_logging=none", "hydra/hydra_logging=none")


class Call(Session):
    """A call from Python: it prints nothing, and is stored as the command that does the same.

    `words` are those of the command, `variants` the overrides of each of its variants.
    """

    def __init__(self, words: Sequence[str], variants: Sequence[Sequence[str]] = ()) -> None:
        super().__init__()
        named = (("--variant", shlex.join(variant)) for variant in variants)
        self._words = [*words, *chain.from_iterable(named)]
        self.variants = [*map(list, variants)]
        self.lines: list[str] = []
        self.lists = False  # whether it may be a dry run, which has no results to return

    def say(self, lines: Iterable[str]) -> None:
        """Keep the lines that the command prints."""
        self.lines += lines

    def show_table(self, url: str, sweep_id: int, factors: Sequence[str]) -> None:
        """Leave the table to the caller, who asks for it."""

    def provenance(self) -> Provenance:
        """Return where the results come from, with the command line that gives them as well."""
        return replace(collect(), command=f"{trial_program()} {shlex.join(self._words)}")


def run_trial(overrides: Sequence[str]) -> Call:
    """Run one trial; returns the call with its outcome.

    Raises SeatrialError, in one line, if the trial cannot be run; an error of the trial itself is
    in the outcome.
    """
    call = Call(overrides)
    with _hydra(overrides, call) as hydra:
        sweeps = any(text.startswith(("experiment=", "hydra.mode=")) for text in overrides)
        if sweeps and hydra.get_mode("trial", list(overrides)) is RunMode.MULTIRUN:
            raise ConfigurationError(f"{' '.join(overrides)}: got a sweep, expected one trial")
        hydra.run("trial", call, list(overrides), with_log_configuration=False)
        if isinstance(call.error, Exception):
            raise call.error
    _refuse_dry_run(call)
    return call


def run_sweep(call: Call, overrides: Sequence[str]) -> None:
    """Run the sweep of the overrides and the variants of the call; the call holds the outcome.

    Raises SeatrialError, in one line, if the sweep cannot be run.
    """
    words, call.variants = left_to_jobs(overrides, call.variants)
    with _hydra(overrides, call) as hydra:
        hydra.multirun("trial", call, [*words, *QUIET], with_log_configuration=False)
    _refuse_dry_run(call)


def _refuse_dry_run(call: Call) -> None:
    if call.trials and not call.lists:
        raise ConfigurationError("dry_run: the command line lists trials, Python runs them")


def composed(overrides: Sequence[str]) -> Order:
    """Return the resolved configuration of a trial; raises SeatrialError, in one line."""
    with _hydra(overrides, Call(overrides)) as hydra:
        config = hydra.compose_config("trial", list(overrides), run_mode=RunMode.RUN)
        HydraConfig.instance().set_config(config)
        task = config.copy()
        task._set_flag("readonly", False)
        task._set_flag("struct", False)
        del task["hydra"]
        return order_of(task, config.hydra)


def register(overrides: Sequence[str]) -> None:
    """Make our plugins and source of files known to Hydra; `overrides` are those of the call."""
    Plugins.instance().class_name_to_class.update(PLUGINS)
    Plugins.instance().register(UserFolders)
    SourcesRegistry.instance().types["file"] = FileConfigSource
    FileConfigSource.overrides = overrides
    ConfigStore.__deepcopy__ = _itself  # type: ignore[attr-defined]


def _itself(store: ConfigStore, memo: object) -> ConfigStore:
    """The store of Hydra, of which every composition, and each group in --help, makes a copy.

    There is one in a process, nobody writes to the copies, and what is loaded is copied again.
    """
    return store


@contextmanager
def _hydra(overrides: Sequence[str], call: Call) -> Iterator["Hydra"]:
    """Provide a Hydra of our own, and errors in one line; its state is as before afterwards."""
    refuse_gone(overrides)
    refuse_passwords(overrides)
    stop = StopSignals()
    signals = current_thread() is main_thread()
    with _singletons_kept(), stop.listening(["SIGINT"]) if signals else nullcontext():
        import_from_working_folder()
        register(overrides)  # before Hydra looks for its sources
        with initialize_config_dir(str(CONF), job_name="seatrial", version_base="1.3"):
            hydra = GlobalHydra.instance().hydra
            assert hydra is not None
            try:
                yield hydra
            except (Exception, StopSignal) as error:
                # What a signal has interrupted may fail by any exception.
                if stop.number is not None or isinstance(error, StopSignal):
                    raise KeyboardInterrupt from None
                # Before the start, any exception of Hydra is about the options; later it is a bug.
                if call.started and not isinstance(error, EXPECTED):
                    raise
                line = error_line(one_line(error, overrides))
                if line == str(error) and isinstance(error, SeatrialError):
                    raise
                raise ConfigurationError(line) from None


@contextmanager
def _singletons_kept() -> Iterator[None]:
    """Put back what Hydra and the search for modules keep for the whole process."""
    hydra, config = GlobalHydra.instance().hydra, HydraConfig.instance().cfg
    base = VersionBase.instance().getbase()
    plugins, sources = Plugins.instance().class_name_to_class, SourcesRegistry.instance().types
    name, path = JobRuntime.instance().conf.get("name"), list(sys.path)
    known, types = dict(plugins), dict(sources)
    GlobalHydra.instance().clear()
    try:
        yield
    finally:
        GlobalHydra.instance().hydra = hydra
        HydraConfig.instance().cfg = config
        VersionBase.instance().version_base = base
        plugins.clear()
        plugins.update(known)
        sources.clear()
        sources.update(types)
        JobRuntime.instance().set("name", name)
        sys.path[:] = path
        FileConfigSource.overrides = ()
