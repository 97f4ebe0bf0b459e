"""Entry point: `python -m runner.compare`, installed as `seatrial-results`.

Exit codes: 0, 1 where a check found something wrong (verify), 2 for bad input, 130 on Ctrl-C.
"""

import os
import sys
from collections.abc import Sequence

from seatrial.models.errors import SeatrialError
from seatrial.runner.database.mask import masked_output
from seatrial.runner.invocation import import_from_working_folder

PROGRAM = "seatrial-results"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit; errors that a user can cause are one line on stderr."""
    import_from_working_folder()
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """The exit code of one command line; None stands for the arguments of this process."""
    with masked_output():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    from typer.main import get_command

    from seatrial.runner.compare import commands, logbook_commands  # noqa: F401 - they add their commands
    from seatrial.runner.compare.cli import app

    try:
        code = get_command(app).main(
            args=None if arguments is None else list(arguments),
            prog_name=PROGRAM,
            standalone_mode=False,
        )
    except SeatrialError as error:
        return complain(str(error))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of a pipe, `head` perhaps, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        message = _usage_message(error)
        if message is None:
            raise
        return complain(message) if message else 2
    return code if isinstance(code, int) else 0


def complain(message: str) -> int:
    """Prints one line and gives the exit code of bad input."""
    print(f"{PROGRAM}: {' '.join(message.split())}", file=sys.stderr)
    return 2


def _usage_message(error: Exception) -> str | None:
    """What the command line parser complains about; None for what is not its exception.

    Typer ships its parser under different names from version to version: it is known by its form.
    """
    describe = getattr(error, "format_message", None)
    if describe is None:
        return "aborted" if type(error).__name__ == "Abort" else None
    return str(describe())


if __name__ == "__main__":
    main()
