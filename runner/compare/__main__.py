"""Entry point: `python -m runner.compare`, installed as `seatrial-results`.

Exit codes: 0 for success, 1 if a check found a problem (verify), 2 for bad input, 130 on Ctrl-C.
"""

import os
import sys
from collections.abc import Sequence
from io import TextIOWrapper
from itertools import pairwise

from typer.main import get_command

from seatrial.models.errors import SeatrialError
from seatrial.runner.compare import commands  # noqa: F401 - adds the commands
from seatrial.runner.compare.cli import app, run_typer
from seatrial.runner.configuration import invocation, plugins
from seatrial.runner.database.terminal import error_line, refuse_passwords

# What a first word may be meant as that is no command, nor similar to one.
MEANT = {"list": "runs", "help": "--help", "vessels": "seatrial --help"}


def main() -> None:
    """Run the command line and exit; a user error is printed as one line on stderr."""
    invocation.collect_garbage_seldom()
    invocation.import_from_working_folder()
    sys.exit(run(sys.argv[1:]))


def run(words: Sequence[str]) -> int:
    """Run one command line and return its exit code."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # what its encoding does not have
    if words and "--help" not in words:
        plugins.load()  # which declare metrics
    try:
        refuse_passwords(words)
        return run_typer(app, words)
    except SeatrialError as error:
        message = str(error)
        for text in (*map(" ".join, pairwise(words)), *words):
            instead = invocation.replaced().get(f"{app.info.name} {text}")
            if instead and text.split()[-1] in message:  # which is about this word
                message = f"{text} is gone: {instead}"
                break
        if message.startswith("no command") and (command := MEANT.get(words[0])):
            message = message.replace("see --help", f"did you mean '{command}'?")
        print(f"{app.info.name}: {error_line(message)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of the pipe, such as `head`, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def names() -> list[str]:
    """Return the names of the commands."""
    return sorted(get_command(app).commands)  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
