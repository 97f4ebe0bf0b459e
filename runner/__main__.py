"""The command line: `python -m runner`, installed as `seatrial`.

`seatrial init` writes files to start from (`init`); everything else is Hydra's command line.

Exit codes: 0 all is well; 1 a run failed or diverged; 2 the command cannot be carried out (a wrong
option, an unreadable file, an unusable database); 130 interrupted (143 by SIGTERM, 129 by SIGHUP).
An error is reported in one line; HYDRA_FULL_ERROR=1 shows the traceback as well.

These private parts of Hydra 1.3.8, submitit 1.5.4 and others are used, and no others:

get_args_parser     Hydra's command-line parser prints a usage message and ends the process by
                    itself, instead of reporting one line (tests/runner/test_command_line.py).
_instances          A call from Python has singletons of its own, so that those of a program with a
                    Hydra of its own are as before (tests/runner/interface/test_calls.py).
class_name_to_class Hydra's public `Plugins.register` names a plugin after its module, which must be
                    in the name space `hydra_plugins`; seatrial installs no other name than its own
                    (tests/runner/test_sweep.py).
file_config_source, A vessel may also be a file of the working folder, or the model of a run
SourcesRegistry     (tests/runner/test_yaml_files.py); so _get_header_dict and
                    _normalize_file_name of the source are called.
get_sanitized_cfg,  What `--cfg` prints has the numbers that options take from the vessel
Hydra               (tests/runner/test_vessel_options.py).
get_mode            Hydra composes everything once more for hydra.mode, which only experiments and
                    a user's own files can set (tests/runner/test_experiments.py).
SlurmInfoWatcher,   submitit asks the queue of Slurm instead of its accounting, by the command of
SlurmJob            _make_command (tests/runner/test_slurm.py).
_get_node,          OmegaConf's interpolations are looked at as they are written, without an
_is_interpolation,  error, and one node is written to (tests/runner/test_composition.py).
_set_flag
_option_string_actions  The flags of Hydra's parser, for `did you mean`
                    (tests/runner/test_command_line.py).
_left_title         matplotlib's title at the left of an axis has no public name
                    (tests/runner/compare/test_figures.py).
"""

import os
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from importlib import import_module
from io import TextIOWrapper
from itertools import pairwise
from typing import NoReturn

import hydra
from hydra._internal.hydra import Hydra
from hydra._internal.utils import get_args_parser
from omegaconf import DictConfig

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.hydra_errors import EXPECTED, one_line, refuse_unused
from seatrial.runner.configuration.invocation import (
    import_from_working_folder,
    program_version,
    replaced,
    results_program,
    trial_program,
)
from seatrial.runner.configuration.overrides import left_to_jobs
from seatrial.runner.configuration.search_path import CONF, UserFolders, hidden, is_group
from seatrial.runner.database.terminal import error_line, refuse_passwords
from seatrial.runner.sweeps.composition import with_numbers
from seatrial.runner.sweeps.console import NewWarnings
from seatrial.runner.sweeps.in_process import register
from seatrial.runner.sweeps.stop_signals import StopSignals
from seatrial.runner.sweeps.sweep import Session

WELCOME = """\
seatrial {version}: sea trials for models and controllers of marine vessels

  {trial} disturbance=noise identifier=auto
      one trial: excite the vessel, identify it, validate the model, sail with it, store it all
  {trial} -m identifier=none,ls,auto disturbance=noise seed=0,1,2
      a sweep of them; the same command goes on where it was stopped
  {results} table
      what came of it

{trial} vessel=NAME runs a trial that suits the vessel; {trial} --help names what can be chosen."""
# What a first word may be meant as that is neither an option nor a command.
MEANT = {"run": "{trial} option=value ...", "help": "{trial} --help", "list": "{results} runs"}
VARIANT = "--variant"  # options that change together in a sweep
SANITIZED, MODE = Hydra.get_sanitized_cfg, Hydra.get_mode
SET_MODE = ("experiment", "hydra", "--config")  # beginnings of words with which it can be set
FULL_ERROR = "HYDRA_FULL_ERROR"
INTERRUPTED = "interrupted: finished runs are kept, the same command runs the rest"
# What the first word may ask for beside trials and sweeps: modules with a function `main`.
COMMANDS = {
    "benchmark": "benchmark",
    "data": "data_commands",
    "fits": "fits",
    "init": "init",
    "model": "model_command",
    "next": "next",
}


def main() -> int:
    """Run the command in sys.argv and return its exit code."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # what its encoding does not have
    stop = StopSignals()
    with stop.listening():
        return _main(stop)


def _main(stop: StopSignals) -> int:
    import_from_working_folder()
    NewWarnings.forget()
    traceback_wanted = os.environ.get(FULL_ERROR) == "1"
    session = Session()
    overrides: Sequence[str] = ()
    try:
        refuse_passwords(sys.argv)
        if not sys.argv[1:] or sys.argv[1] == "--version":
            print(_named("seatrial {version}" if sys.argv[1:] else WELCOME))
            return 0
        if command := COMMANDS.get(sys.argv[1]):
            session.started = True
            module = import_module(f"seatrial.runner.commands.{command}")
            return int(module.main(sys.argv[2:]))
        refuse_unused(sys.argv[1:])
        session.variants = _take_variants()
        if {"-m", "--multirun"} & set(sys.argv):
            sys.argv[1:], session.variants = left_to_jobs(sys.argv[1:], session.variants)
        overrides = _checked_arguments()
        for warning in hidden():
            _say(warning)
        with _raising():
            register(overrides)
            Hydra.get_sanitized_cfg = _shown_config  # type: ignore[method-assign, assignment]
            Hydra.get_mode = _mode  # type: ignore[method-assign, assignment]
            hydra.main(config_path=str(CONF), config_name="trial", version_base="1.3")(session)()
    except (Exception, KeyboardInterrupt) as error:
        # What a signal has interrupted may fail by any exception.
        if stop.number is not None or isinstance(error, KeyboardInterrupt):
            return _complain(INTERRUPTED, 128 + (stop.number or signal.SIGINT))
        # Before the start, any exception of Hydra is about the command line; later it is a bug.
        if isinstance(error, BrokenPipeError) and not session.started:  # `seatrial --help | head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        is_bug = session.started and not isinstance(error, EXPECTED)
        if is_bug or traceback_wanted:
            raise
        return _complain(one_line(error, overrides), 2)
    if session.error and stop.number is not None:
        return _complain(INTERRUPTED, 128 + stop.number)
    if isinstance(session.error, Exception):
        if traceback_wanted:
            raise session.error
        session.error = one_line(session.error, overrides)
    return _complain(session.error, session.exit_code) if session.error else session.exit_code


def _named(text: str) -> str:
    """Return a text with the names of the two programs and the version in their places."""
    names = {"trial": trial_program(), "results": results_program(), "version": program_version()}
    return text.format(**names)


def _shown_config(hydra: Hydra, config: DictConfig, kind: str) -> DictConfig:
    """Return what `--cfg` prints, with the numbers that options take from the vessel.

    The help shows the configuration as it is written, and so needs no numbers.
    """
    shown = SANITIZED(hydra, config, kind)
    return with_numbers(shown) if {"--cfg", "-c"} & set(sys.argv) else shown


def _mode(hydra: Hydra, config_name: str | None, overrides: list[str]) -> object:
    """Return hydra.mode; None, as by default, without a composition if nothing can have set it."""
    is_set = any(word.lstrip("+~").startswith(SET_MODE) for word in (*sys.argv[1:], *overrides))
    return MODE(hydra, config_name, overrides) if is_set else None


def _complain(line: str, code: int) -> int:
    _say(line)
    return code


def _say(line: str) -> None:
    print(f"seatrial: {error_line(line)}", file=sys.stderr)


def _take_variants() -> list[list[str]]:
    """Take `--variant 'key=value ...'` out of sys.argv; return the overrides of each variant.

    Raises ConfigurationError for an empty variant, and for one without -m.
    """
    variants, rest = [], []
    words = iter(sys.argv[1:])
    for word in words:
        name, equals, text = word.partition("=")
        if name != VARIANT:
            rest.append(word)
            continue
        text = text if equals else next(words, "")
        try:
            overrides = shlex.split(text)
        except ValueError as error:
            raise ConfigurationError(f"{VARIANT}: got {text!r}: {error}") from error
        if not overrides or not all("=" in override for override in overrides):
            raise ConfigurationError(
                f"{VARIANT}: got {text!r}, expected overrides such as 'identifier=ls seed=1'"
            )
        variants.append(overrides)
    if variants and not {"-m", "--multirun"} & set(rest):
        raise ConfigurationError(f"{VARIANT}: got one trial, expected a sweep (-m)")
    sys.argv[1:] = rest
    return variants


def _checked_arguments() -> list[str]:
    """Return the overrides of the command line, and note its folder of configurations.

    Raises ConfigurationError for invalid flags.
    """
    parser = get_args_parser()
    parser.error = _refuse  # type: ignore[method-assign]
    arguments = parser.parse_args()
    UserFolders.config_dir = arguments.config_dir
    overrides: list[str] = arguments.overrides
    for word in overrides:
        if instead := replaced().get(f"seatrial {word}"):
            raise ConfigurationError(f"{word} is gone: {instead}")
        if word.isidentifier():
            raise ConfigurationError(f"{word!r} cannot be read, {_meant(word)}")
    return overrides


def _meant(word: str) -> str:
    """Return what a word that is no option is meant as: a command, a group, or an option."""
    group = word if is_group(word) else word.removesuffix("s")
    if is_group(group):
        return _named(f"expected {group}=NAME; {{trial}} --help lists the names")
    from seatrial.runner.compare.__main__ import names  # slow to import

    meant = {name: f"{{results}} {name}" for name in names()}
    meant |= {name: f"{{trial}} {name}" for name in COMMANDS} | MEANT
    close = get_close_matches(word, meant, n=1, cutoff=0.8)
    return _named(f"did you mean {meant[close[0]]}?" if close else "expected option=value")


def _refuse(message: str) -> NoReturn:
    """Raise ConfigurationError for flags that the parser does not know."""
    flags = ["--version", *get_args_parser()._option_string_actions]
    for flag, following in pairwise([*sys.argv[1:], "NAME"]):
        if not flag.startswith("--") or flag not in message:
            continue
        name, equals, value = flag.removeprefix("--").partition("=")
        option = [f"{name}={value if equals else following}"] if is_group(name) else []
        for meant in option or get_close_matches(flag, flags, n=1):
            raise ConfigurationError(f"unknown flag {flag}, did you mean {meant}?")
    raise ConfigurationError(f"{message} (flags come before or after all options, see --help)")


@contextmanager
def _raising() -> Iterator[None]:
    """Make Hydra raise its errors instead of printing them."""
    before = {name: os.environ[name] for name in {FULL_ERROR} & os.environ.keys()}
    os.environ[FULL_ERROR] = "1"
    try:
        yield
    finally:
        del os.environ[FULL_ERROR]
        os.environ |= before


if __name__ == "__main__":
    sys.exit(main())
