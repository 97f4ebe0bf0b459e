"""The command line: `python -m runner`, installed as `seatrial`.

`seatrial init` writes files to start from (`init`); everything else is Hydra's command line.

Exit codes: 0 all is well; 1 a run failed or diverged; 2 the command cannot be carried out (a wrong
option, an unreadable file, an unusable database); 130 interrupted (143 by SIGTERM, 129 by SIGHUP).
An error is reported in one line; HYDRA_FULL_ERROR=1 shows the traceback as well.

These private parts of Hydra 1.3.8, submitit 1.5.4 and others are used, and no others:

get_args_parser, _run_hydra, _option_string_actions: to report wrong flags in one line, and not to
    print a usage message and end (tests/runner/test_command_line.py)
_instances: for singletons of a call from Python (tests/runner/interface/test_calls.py)
class_name_to_class: for plugins outside of `hydra_plugins` (tests/runner/test_sweep.py)
file_config_source, SourcesRegistry, _get_header_dict, _normalize_file_name: for vessels that are a
    file or the model of a run (tests/runner/test_yaml_files.py)
get_sanitized_cfg, Hydra: for the vessel's numbers in --cfg (tests/runner/test_vessel_options.py)
get_mode: to compose once less (tests/runner/test_experiments.py)
SlurmInfoWatcher, SlurmJob, _make_command: to ask Slurm's queue (tests/runner/test_slurm.py)
_get_node, _is_interpolation, _set_flag, _value: for interpolations and quotes as they are written,
    and to write to a node (tests/runner/test_composition.py, interface/test_shell.py)
_left_title: of an axis in matplotlib (tests/runner/compare/test_figures.py)
"""

import os
import shlex
import signal
import sys
from argparse import ArgumentTypeError, Namespace
from importlib import import_module
from io import TextIOWrapper
from typing import Any, NoReturn

from hydra import version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import _run_hydra, get_args_parser

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration import invocation, search_path
from seatrial.runner.configuration.hydra_errors import EXPECTED, one_line, refuse_gone
from seatrial.runner.configuration.search_path import CONF, UserFolders, hidden, is_group
from seatrial.runner.database.terminal import error_line, refuse_passwords
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.sweeps.composition import left_to_jobs, spread, with_numbers
from seatrial.runner.sweeps.console import NewWarnings
from seatrial.runner.sweeps.in_process import register
from seatrial.runner.sweeps.stop_signals import StopSignals
from seatrial.runner.sweeps.sweep import Session

WELCOME = """\
seatrial {version}: sea trials for models and controllers of marine vessels

  {trial} disturbance=noise  one trial: excite, identify, validate, sail, store
  {trial} -m identifier=none,ls,auto disturbance=noise seed=0,1,2  a sweep, which can be resumed
  {results} table  compare the results

{trial} vessel=NAME runs a trial that suits the vessel; {trial} --help names what can be chosen."""
# What a first word may be meant as that is neither an option nor a command.
MEANT = {
    "run": "{trial} option=value ...",
    "help": "{trial} --help",
    "list": "{results} runs",
    "sweep": "{trial} -m option=a,b ...",
    "version": "{trial} --version",
}
VARIANT = "--variant"  # options that change together in a sweep
SANITIZED, MODE = Hydra.get_sanitized_cfg, Hydra.get_mode
SET_MODE = ("experiment", "hydra")  # beginnings of overrides with which it can be set
FULL_ERROR = "HYDRA_FULL_ERROR"
INTERRUPTED = "interrupted: finished runs are kept, the same command runs the rest"
# What the first word may ask for beside trials and sweeps: modules with a function `main`.
COMMANDS = {
    "benchmark": "benchmark", "data": "data_commands", "fits": "fits", "init": "init",
    "model": "model_command", "next": "next",
}  # fmt: skip


def main() -> int:
    """Run the command in sys.argv and return its exit code."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # what its encoding does not have
    stop, before = StopSignals(), os.environ.get(FULL_ERROR)
    with stop.listening():
        try:
            return _main(stop, sys.argv[1:], traceback_wanted=before == "1")
        finally:
            os.environ.pop(FULL_ERROR, None)
            os.environ |= {} if before is None else {FULL_ERROR: before}


def _main(stop: StopSignals, words: list[str], traceback_wanted: bool) -> int:
    invocation.collect_garbage_seldom()
    invocation.import_from_working_folder()
    NewWarnings.known.clear()
    session, arguments = Session(), Namespace(overrides=[])
    command = COMMANDS.get(words[0]) if words else None
    try:
        refuse_passwords(words)
        if not words or words[0] == "--version":
            print(_named("seatrial {version}" if words else WELCOME))
            return 0
        if command:
            session.started = True
            module = import_module(f"seatrial.runner.commands.{command}")
            return int(module.main(words[1:]))
        arguments = _parsed(words, session)
        for warning in hidden():
            _say(warning)
        _run(session, arguments)
        if isinstance(session.error, Exception):
            raise session.error
    except (Exception, KeyboardInterrupt) as error:
        # What a signal has interrupted may fail by any exception.
        if stop.number is not None or isinstance(error, KeyboardInterrupt):
            line = INTERRUPTED if command in (None, "benchmark") else "interrupted"
            return _say(line, 128 + (stop.number or signal.SIGINT))
        # Before the start, any exception of Hydra is about the command line; later it is a bug.
        if isinstance(error, BrokenPipeError) and (command or not session.started):  # | head
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        if traceback_wanted or (session.started and not isinstance(error, EXPECTED)):
            raise
        return _say(one_line(error, arguments.overrides), 2)
    if session.error and stop.number is not None:
        return _say(INTERRUPTED, 128 + stop.number)
    return _say(session.error, session.exit_code) if session.error else session.exit_code


def _parsed(words: list[str], session: Session) -> Namespace:
    """Return the arguments of a trial or a sweep, whose variants are noted in the session.

    Raises ConfigurationError for those that are wrong.
    """
    parser = get_args_parser()
    parser.error, parser.allow_abbrev = _refuse, False  # type: ignore[method-assign]
    parser.add_argument(VARIANT, action="append", default=[], type=variant)
    arguments, unknown = parser.parse_known_intermixed_args(words)
    for flag in [] if words[0].isidentifier() else unknown:
        name, equals, value = flag.lstrip("-").replace("-", "_").partition("=")
        value = value if equals else [*words, "..."][words.index(flag) + 1]
        hint = invocation.meant(flag, ["--version", *parser._option_string_actions]).rstrip()
        hint = f"did you mean {name}={value}?" if search_path.is_option(name) else hint
        raise ConfigurationError(f"unknown flag {flag}, {hint or 'see --help'}")
    if arguments.experimental_rerun:
        _refuse(_named("--experimental-rerun: see {results} show RUN --command"))
    refuse_gone(arguments.overrides)
    for word in filter(str.isidentifier, arguments.overrides):
        raise ConfigurationError(f"{word!r} cannot be read, {_meant(word)}")
    session.variants = arguments.variant
    if arguments.multirun:
        arguments.overrides, session.variants = left_to_jobs(arguments.overrides, session.variants)
    elif session.variants:
        raise ConfigurationError(f"{VARIANT}: got one trial, expected a sweep (-m)")
    else:
        arguments.overrides = spread(arguments.overrides)
    UserFolders.config_dir = arguments.config_dir
    return arguments


def variant(text: str) -> list[str]:
    """Return the overrides of a --variant; raises ArgumentTypeError or ValueError."""
    overrides = shlex.split(text)
    if not overrides or not all("=" in override for override in overrides):
        expected = "expected overrides such as 'identifier=ls seed=1'"
        raise ArgumentTypeError(f"got {text!r}, {expected}")
    return overrides


def _refuse(message: str) -> NoReturn:
    raise ConfigurationError(invocation.in_words(message))


def _run(session: Session, arguments: Namespace) -> None:
    """Let Hydra run the command, and raise its errors instead of printing them.

    What `--cfg` prints has the numbers that options take from the vessel. Without what can set
    hydra.mode, nothing is composed to know it.
    """
    os.environ[FULL_ERROR] = "1"
    register(arguments.overrides)
    own = arguments.config_dir or arguments.config_name or arguments.config_path
    patched: Any = Hydra
    if arguments.cfg:
        patched.get_sanitized_cfg = lambda *given: with_numbers(SANITIZED(*given))
    if not own and not any(w.lstrip("+~").startswith(SET_MODE) for w in arguments.overrides):
        patched.get_mode = lambda *_, **__: None
    version.setbase("1.3")
    try:
        _run_hydra(arguments, get_args_parser(), session, str(CONF), "trial")
    finally:  # calls from Python in the same process are as before
        patched.get_sanitized_cfg, patched.get_mode = SANITIZED, MODE


def _named(text: str) -> str:
    """Return a text with the names of the two programs and the version in their places."""
    return text.format(
        trial=invocation.trial_program(),
        results=invocation.results_program(),
        version=invocation.program_version(),
    )


def _say(line: str, code: int = 0) -> int:
    print(f"seatrial: {error_line(line)}", file=sys.stderr)
    return code


def _meant(word: str) -> str:
    """Return what a word that is no option is meant as: a command, a group, or an option."""
    group = word if is_group(word) else word.removesuffix("s")
    if is_group(group):
        return _named(f"expected {group}=NAME; {{trial}} --help lists the names")
    if word not in MEANT and search_path.is_option(word):
        return f"expected {word}=..."
    from seatrial.runner.compare.__main__ import names  # slow to import

    known = {name: f"{group}={name}" for group in GROUPS for name in search_path.options(group)}
    known |= {name: f"{{results}} {name}" for name in names()}
    known |= {name: f"{{trial}} {name}" for name in COMMANDS} | MEANT
    hint = invocation.meant(word, known, shown=known.__getitem__).rstrip()
    return _named(hint or "expected option=value")


if __name__ == "__main__":
    sys.exit(main())
