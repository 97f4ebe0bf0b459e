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

# By shell: the file of its completions, its start file, and the line that this one needs.
SHELLS = {
    "bash": (".bash_completions/seatrial.sh", ".bashrc", "source {}"),
    "zsh": (
        ".bash_completions/seatrial.sh",
        ".zshrc",
        "(( $+functions[compdef] )) || {{ autoload -Uz compinit && compinit }}; "
        "autoload -Uz bashcompinit && bashcompinit && source {}",
    ),
    "fish": (".config/fish/completions/seatrial.fish", "", ""),
}
VARIANT = re.compile(r"--variant[ =]('[^']*'|\"[^\"]*\"|\S*)\s?")
QUOTES = str.maketrans("", "", "'\"")
SWEPT = re.compile(r"=\s*\w+\(")  # range(0,20), choice(a,b), ...


def completions(line: str, query: Callable[[str], list[str]]) -> list[str]:
    """Complete the last word of a line without the program's name.

    `query` completes the line of one trial. Earlier words with several values are shown to it with
    the first one, without functions of values; of the last word the value after the last comma or
    bracket is completed.
    """
    words = VARIANT.sub("", line).translate(QUOTES).split(" ")
    *before, last = words
    trial = [_first_value(word) for word in before if not SWEPT.search(word)]
    key, equals, value = last.partition("=")
    end = max(value.rfind(","), value.rfind("[")) + 1
    if not equals or not end:
        return query(" ".join([*trial, last]))
    own = query(" ".join([*trial, f"{key}={value[end:]}"]))
    return [f"{key}={value[:end]}{text.partition('=')[2]}" for text in own]


def _first_value(word: str) -> str:
    """An override with the first of its values: up to a comma in no list or mapping."""
    depth = 0
    for i, letter in enumerate(word):
        depth += (letter in "[{") - (letter in "]}")
        if letter == "," and not depth:
            return word[:i]
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
    name, start, line = SHELLS[shell]
    family = "fish" if shell == "fish" else "bash"
    script = subprocess.run(
        [sys.argv[0], "-sc", f"install={family}"], check=True, capture_output=True, text=True
    ).stdout
    file = Path.home() / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(script, encoding="utf-8")
    print(f"completion of {shell}: {file}")
    if start:
        path, wanted = Path.home() / start, line.format(shlex.quote(str(file)))
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        if wanted not in text.splitlines():
            separator = "" if not text or text.endswith("\n") else "\n"
            with path.open("a", encoding="utf-8") as file_of_start:
                file_of_start.write(f"{separator}{wanted}\n")
            print(f"read by {path}")
    print("it works in the next shell that you open")
    return 0
