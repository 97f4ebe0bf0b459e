"""Names of the two programs: modules in a checkout, or installed scripts.

Every command that is printed for the user begins with one of these names.
"""

import gc
import re
import shlex
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from seatrial import __version__

if TYPE_CHECKING:
    import yaml
else:
    import lazy_loader

    yaml = lazy_loader.load("yaml")

ROOT = Path(__file__).resolve().parents[2]  # the checkout, or the installed package
SCRIPTS = ("seatrial", "seatrial-results")
DEFAULT_DATABASE = "sqlite:///results/results.db"
COLLECTED_AFTER = 20_000  # new objects; Python's own 700 takes a tenth of the time of a start


def in_words(text: str, key: object = "") -> str:
    """Return a message of another package in our words; `key` is the option that it is about."""
    for pattern, ours in _data("words").items():
        text = re.sub(pattern, ours, text)
    return text.replace("{key}", str(key))


def replaced() -> Mapping[str, str]:
    """Return the commands and options that are gone, each with what replaces it."""
    return _data("replaced")


@cache
def _data(name: str) -> Mapping[str, str]:
    text = Path(__file__).with_name(f"{name}.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def meant(word: str, known: Iterable[str], most: int = 1, shown: Callable[[str], str] = str) -> str:
    """Return the words on the known names that are near to a wrong one; empty without any."""
    close = map(shown, get_close_matches(word, [*known], n=most))
    return f"did you mean {names}? " if (names := " or ".join(close)) else ""


def in_checkout(root: Path = ROOT) -> bool:
    """Return whether the sources are in a checkout, and not installed."""
    return (root / "pyproject.toml").is_file()


def program_version() -> str:
    """Return the version of this seatrial, and whether it is a checkout."""
    return f"{__version__} (checkout)" if in_checkout() else __version__


def by_script(typed: Sequence[str]) -> bool:
    """Return whether a command line (as in `sys.orig_argv`) starts an installed script."""
    return len(typed) > 1 and Path(typed[1]).stem in SCRIPTS


def trial_program() -> str:
    """Return the command that runs trials: `python -m runner` or `seatrial`."""
    return "python -m runner" if _modules() else "seatrial"


def results_program() -> str:
    """Return the command for results: `python -m runner.compare` or `seatrial-results`."""
    return "python -m runner.compare" if _modules() else "seatrial-results"


def typed_command(typed: Sequence[str]) -> str:
    """Quote a command line, as in `sys.orig_argv`, for a shell."""
    return shlex.join([Path(typed[1]).stem, *typed[2:]] if by_script(typed) else typed)


def config_folder(typed: str) -> list[str]:
    """Return the words of a typed command line that name its folder of options."""
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd")
    folder = parser.parse_known_args(shlex.split(typed))[0].config_dir
    return ["--config-dir", folder] if folder else []


def quoted(text: str) -> str:
    """Return a text as the grammar of overrides reads it, in quotes where it needs them."""
    plain = re.fullmatch(r"[A-Za-z_/.][\w/.:+-]*", text, re.ASCII)
    if plain and text.lower() not in ("null", "true", "false", "nan", "inf"):
        return text
    escaped = re.sub(r"(\\*)'", r"\1\1\\'", text)  # backslashes count before a quote only
    trailing = escaped[len(escaped.rstrip("\\")) :]
    return f"'{escaped}{trailing}'"


def collect_garbage_seldom() -> None:
    """Let a program import its modules without a search for garbage in between."""
    gc.set_threshold(COLLECTED_AFTER)


def import_from_working_folder() -> None:
    """Let the parts of the user's own be found, after everything that is installed."""
    folder = str(Path.cwd())
    if not {"", folder} & set(sys.path):
        sys.path.append(folder)


def _modules() -> bool:
    return in_checkout() and not by_script(sys.orig_argv)
