"""The command line: `python -m runner`, installed as `seatrial`.

Exit codes: 0 all is well; 1 a run failed or diverged; 2 the command cannot be carried out (a wrong
option, an unreadable file, an unusable database); 130 interrupted (143 by SIGTERM, 129 by SIGHUP).
An error is reported in one line; HYDRA_FULL_ERROR=1 shows the traceback as well.

Three private parts of Hydra 1.3.8 are used, here and in `yaml_files` alone. The first is its
command-line parser, which by itself prints a usage message and ends the process instead of
reporting one line. The second is its table of plugins: the public `Plugins.register` names a plugin
after its module, which must be in the name space `hydra_plugins`, but seatrial installs no other
name than its own. The third is its source of configuration files, with the table that names it:
files are checked before OmegaConf expands their aliases.
"""

import os
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Timer
from types import FrameType
from typing import NoReturn

import hydra
from hydra._internal.sources_registry import SourcesRegistry
from hydra._internal.utils import get_args_parser
from hydra.core.plugins import Plugins

from seatrial.models.errors import ConfigurationError
from seatrial.runner.database.mask import learn, masked_output, without_passwords
from seatrial.runner.database.terminal import error_line
from seatrial.runner.hydra_errors import CONF, EXPECTED, one_line
from seatrial.runner.invocation import import_from_working_folder
from seatrial.runner.sweep import SeatrialSweeper, Session
from seatrial.runner.yaml_files import FileConfigSource

SWEEPER = "hydra_plugins.seatrial.Sweeper"  # as conf/hydra/sweeper/seatrial.yaml names it
VARIANT = "--variant"  # options that change together in a sweep
AGAIN_S = 0.05  # after which a signal that was lost is sent again
FULL_ERROR = "HYDRA_FULL_ERROR"
INTERRUPTED = "interrupted: finished runs are kept, the same command runs the rest"


class StopSignal(KeyboardInterrupt):
    """SIGTERM or SIGHUP, which end the program in the same way as Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def main() -> int:
    """Run the command in sys.argv and return its exit code."""
    for text in (*sys.argv, os.environ.get("SEATRIAL_DATABASE", "")):
        learn(text)
    with masked_output(), _stoppable():
        return _main()


def _main() -> int:
    import_from_working_folder()
    traceback_wanted = os.environ.get(FULL_ERROR) == "1"
    session = Session()
    overrides: Sequence[str] = ()
    try:
        session.variants = _take_variants()
        overrides = _checked_arguments()
        with _raising():
            Plugins.instance().class_name_to_class[SWEEPER] = SeatrialSweeper
            SourcesRegistry.instance().types["file"] = FileConfigSource
            hydra.main(config_path=str(CONF), config_name="trial", version_base="1.3")(session)()
    except KeyboardInterrupt as stop:
        number = stop.number if isinstance(stop, StopSignal) else signal.SIGINT
        return _complain(INTERRUPTED, 128 + number)
    except EXPECTED as error:
        if traceback_wanted:
            raise
        return _complain(one_line(error, overrides), 2)
    except Exception as error:
        # Before the start, any exception of Hydra is about the command line; later it is a bug.
        if session.started or traceback_wanted:
            raise
        return _complain(one_line(error, overrides), 2)
    if isinstance(session.error, Exception):
        if traceback_wanted:
            raise session.error
        return _complain(one_line(session.error, overrides), session.exit_code)
    if session.error:
        return _complain(session.error, session.exit_code)
    return session.exit_code


def _complain(line: str, code: int) -> int:
    shown = error_line(without_passwords(line), sys.argv[1:])
    print(f"seatrial: {shown}", file=sys.stderr)
    return code


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
    """Return the overrides of the command line; raises ConfigurationError for invalid flags."""
    parser = get_args_parser()
    parser.error = _refuse  # type: ignore[method-assign]
    overrides: list[str] = parser.parse_args().overrides
    return overrides


def _refuse(message: str) -> NoReturn:
    raise ConfigurationError(f"{message} (flags come before or after all options, see --help)")


@contextmanager
def _stoppable() -> Iterator[None]:
    """Make SIGTERM and SIGHUP raise StopSignal once; an ignored signal (nohup) stays ignored."""
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in (signal.Signals[n] for n in names)}
    signals = [number for number, handler in before.items() if handler is not signal.SIG_IGN]

    def stop(number: int, frame: FrameType | None) -> NoReturn:
        for other in signals:  # a second signal must not interrupt the clean-up
            signal.signal(other, signal.SIG_IGN)
        raise StopSignal(number)

    def listen() -> None:
        for number in signals:
            signal.signal(number, stop)

    def unraisable(lost: "sys.UnraisableHookArgs") -> None:
        # Python drops an exception that a handler raises during a finaliser or a callback.
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            hook(lost)
            return
        listen()
        error = lost.exc_value
        number = error.number if isinstance(error, StopSignal) else signal.SIGINT
        Timer(AGAIN_S, os.kill, (os.getpid(), number)).start()

    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    listen()
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number in signals:
            signal.signal(number, before[number])


@contextmanager
def _raising() -> Iterator[None]:
    """Make Hydra raise its errors instead of printing them."""
    before = os.environ.get(FULL_ERROR)
    os.environ[FULL_ERROR] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[FULL_ERROR]
        else:
            os.environ[FULL_ERROR] = before


if __name__ == "__main__":
    sys.exit(main())
