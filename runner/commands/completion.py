"""Completion of the command line of `seatrial` in bash, zsh and fish.

Hydra completes groups, options and their values for one trial. Here it is shown a sweep as one of
its trials, so that `seatrial -m identifier=ls,pl` is completed as well.
"""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import by_script

SHELLS = ("bash", "zsh", "fish")
START = {  # a line for the shell's start file; fish needs none
    "bash": (".bashrc", "source {}"),
    "zsh": (
        ".zshrc",
        "(( $+functions[compdef] )) || {{ autoload -Uz compinit && compinit }}; "
        "autoload -Uz bashcompinit && bashcompinit && source {}",
    ),
}
VARIANT = re.compile(r"--variant[ =]('[^']*'|\"[^\"]*\"|\S*)\s?")
QUOTES = str.maketrans("", "", "'\"")
FUNCTIONS = re.compile(r"=\s*\w+\(")  # range(0,20), choice(a,b), ...


def completions(line: str, query: Callable[[str], list[str]]) -> list[str]:
    """Complete the last word of a line without the program's name.

    `query` completes the line of one trial. Earlier words with several values are shown to it with
    the first one; of the last word the value after the last comma or bracket is completed.
    """
    words = VARIANT.sub("", line).translate(QUOTES).split(" ")
    *before, last = words
    trial = [first for word in before if (first := _first_value(word))]
    key, equals, value = last.partition("=")
    end = max(value.rfind(","), value.rfind("[")) + 1
    if not equals or not end:
        return query(" ".join([*trial, last]))
    given = value[:end]
    own = query(" ".join([*trial, f"{key}={value[end:]}"]))
    return [f"{key}={given}{text.partition('=')[2]}" for text in own]


def _first_value(word: str) -> str:
    """Return an override with the first of its values; empty for a function of values."""
    key, equals, value = word.partition("=")
    if not equals:
        return word
    if FUNCTIONS.search(word):
        return ""
    depth = 0
    for i, letter in enumerate(value):
        depth += (letter in "[{") - (letter in "]}")
        if letter == "," and not depth:
            return f"{key}={value[:i]}"
    return word


def install(arguments: Sequence[str]) -> int:
    """Install the completion for a shell, by default that of the environment; done once.

    Raises ConfigurationError for an unknown shell, and in a checkout that is not installed.
    """
    shell = arguments[0] if arguments else Path(os.environ.get("SHELL", "")).name
    if shell not in SHELLS or arguments[1:]:
        got = " ".join(arguments) or f"SHELL={shell}"
        raise ConfigurationError(
            f"--install-completion: got {got}, expected one of {', '.join(SHELLS)}"
        )
    if not by_script([sys.executable, sys.argv[0]]):
        raise ConfigurationError(
            "--install-completion: got a module of a checkout, which shells do not complete; "
            "expected the installed program: pip install -e ."
        )
    family = "fish" if shell == "fish" else "bash"
    script = subprocess.run(
        [sys.argv[0], "-sc", f"install={family}"], check=True, capture_output=True, text=True
    ).stdout
    if family == "fish":
        file = Path.home() / ".config" / "fish" / "completions" / "seatrial.fish"
    else:
        file = Path.home() / ".bash_completions" / "seatrial.sh"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(script, encoding="utf-8")
    print(f"completion of {shell}: {file}")
    if shell in START:
        _once(Path.home() / START[shell][0], START[shell][1].format(shlex.quote(str(file))))
    print("it works in the next shell that you open")
    return 0


def _once(start: Path, line: str) -> None:
    """Append a line to a start file, unless it is there."""
    text = start.read_text(encoding="utf-8") if start.exists() else ""
    if line not in text.splitlines():
        with start.open("a", encoding="utf-8") as file:
            file.write(f"{'' if text.endswith(chr(10)) or not text else chr(10)}{line}\n")
        print(f"read by {start}")
