"""Entry point: `python -m runner.compare`, installed as `seatrial-results`.

Exit codes: 0 for success, 1 if a check found a problem (verify), 2 for bad input, 130 on Ctrl-C.
"""

import os
import sys
from collections.abc import Sequence
from io import TextIOWrapper

from typer.main import get_command

from seatrial.models.errors import SeatrialError
from seatrial.runner.compare import commands, logbook_commands  # noqa: F401 - adds the commands
from seatrial.runner.compare.cli import app
from seatrial.runner.configuration import plugins
from seatrial.runner.configuration.invocation import REPLACED, import_from_working_folder
from seatrial.runner.database.terminal import error_line, refuse_passwords

PROGRAM = "seatrial-results"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit; a user error is printed as one line on stderr."""
    import_from_working_folder()
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code; None takes the arguments of this process."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # what its encoding does not have
    if words and "--help" not in words:
        plugins.load()  # which declare metrics
    try:
        refuse_passwords(words)
        code = get_command(app).main(args=words, prog_name=PROGRAM, standalone_mode=False)
    except SeatrialError as error:
        return complain(_replacement(words) or str(error))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of the pipe, such as `head`, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        message = _usage_message(error)
        if message is None:
            raise
        message = _replacement(words) or message
        return complain(message) if message else 2
    return code if isinstance(code, int) else 0


def names() -> list[str]:
    """Return the names of the commands."""
    return sorted(get_command(app).commands)  # type: ignore[attr-defined]


def complain(message: str) -> int:
    """Print one line on stderr and return the exit code of bad input."""
    print(f"{PROGRAM}: {error_line(message)}", file=sys.stderr)
    return 2


def _replacement(words: Sequence[str]) -> str:
    """Return what replaces a command, figure or option that is gone; empty for any other."""
    for text in (" ".join(words[:2]), *words):
        if replaced := REPLACED.get(f"{PROGRAM} {text}"):
            return f"{text} is gone: {replaced}"
    return ""


def _usage_message(error: Exception) -> str | None:
    """Return the message of a parser error, or None for any other exception.

    The module of the parser differs between versions of Typer, so its exceptions are recognised
    by their attributes.
    """
    describe = getattr(error, "format_message", None)
    if describe is None:
        return "aborted" if type(error).__name__ == "Abort" else None
    return str(describe())


if __name__ == "__main__":
    main()
