"""Completion of the command line of `seatrial`.

Hydra completes groups, options and their values for one trial. Here it is shown a sweep as one of
its trials, so that `seatrial -m identifier=ls,pl` is completed as well.
"""

import re
from collections.abc import Callable

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
