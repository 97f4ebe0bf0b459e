"""The reference of the commands, from what their parsers say of themselves."""

from enum import Enum
from pathlib import Path
from typing import Any, get_args, get_origin

import typer.main
from typer.core import TyperArgument

from docs.pages.markdown import code, prose, table
from seatrial.runner.commands import benchmark, data_commands, init, model_command
from seatrial.runner.compare import commands as _commands  # noqa: F401 - adds the commands
from seatrial.runner.compare.cli import app

Command = Any  # of Click, or of the copy of it that newer versions of Typer hold
HEADERS = ("option", "default", "what it does")
COMMON = ("help", "install_completion", "show_completion")


def commands(program: str) -> str:
    """The sections of `results`, `data`, `model`, `benchmark` or `init`."""
    trees = {"results": app, "data": data_commands.app, "init": init.app}
    trees |= {"model": model_command.app, "benchmark": benchmark.app}
    tree = trees[program]
    command: Command = typer.main.get_command(tree)
    if program in ("model", "benchmark"):
        return _section(f"seatrial {program}", command, None)
    context = command.context_class(command, info_name=tree.info.name)
    return "\n".join(
        _section(f"{tree.info.name} {name}", one, context)
        for name, one in command.commands.items()
        if not one.hidden
    )


def _section(title: str, command: Command, parent: Any) -> str:
    context = command.context_class(command, info_name=title.rpartition(" ")[2], parent=parent)
    shown = [one for one in command.get_params(context) if one.name not in COMMON]
    usage = " ".join([title, *command.collect_usage_pieces(context)])
    rows = [_row(one, context) for one in shown]
    help_text = "\n\n".join(map(prose, (command.help or "").split("\n\n")))
    return f"### {title}\n\n```console\n$ {usage}\n```\n\n{help_text}\n\n{table(HEADERS, rows)}"


def _row(one: Any, context: Any) -> list[str]:
    names = ", ".join([*one.opts, *one.secondary_opts])
    if isinstance(one, TyperArgument):
        names = one.metavar or one.name.upper()
    elif not one.is_flag:
        names = f"{names} {one.metavar or _values(one.type_descriptor.annotation)}"
    default = one.get_default(context)
    shown = "" if default in (None, (), [], False) else str(getattr(default, "value", default))
    return [code(names), code(shown), prose(str(getattr(one, "help", "") or ""))]


def _values(annotation: Any) -> str:
    """What an option takes: its choices, or a word for their kind."""
    if get_origin(annotation) is list:
        (annotation,) = get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return "|".join(str(one.value) for one in annotation)
    if choices := get_args(annotation):
        return "|".join(map(str, choices))
    return {str: "TEXT", int: "N", float: "X", Path: "PATH"}.get(annotation, "VALUE")
