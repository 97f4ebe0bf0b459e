"""`seatrial init SUBJECT NAME`: files to start from, in the working folder.

A subject is one entry of SUBJECTS: it declares its options and makes the files, whose templates are
in the folder `templates`.
"""

import argparse
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, NoReturn

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import trial_program
from seatrial.runner.configuration.search_path import CONF

if TYPE_CHECKING:  # what is slow to import
    from seatrial.models.vessel import scales
else:
    import lazy_loader

    scales = lazy_loader.load("seatrial.models.vessel.scales", suppress_warning=True)

TEMPLATES = Path(__file__).parent / "templates"
NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)


@dataclass(frozen=True)
class Draft:
    """The files of a subject, their text by path, and the command that uses them."""

    files: Mapping[Path, str]
    use: str


@dataclass(frozen=True)
class Subject:
    """What can be started: its summary, its options, and the draft for given ones."""

    summary: str
    declare: Callable[[argparse.ArgumentParser], None]
    draft: Callable[[argparse.Namespace], Draft]


class _InitParser(argparse.ArgumentParser):
    """A parser that raises its errors."""

    def error(self, message: str) -> NoReturn:
        raise ConfigurationError(f"{message} (see {self.prog} --help)")


def run(words: Sequence[str]) -> int:
    """Write the files that `seatrial init WORDS` asks for; return the exit code.

    Raises ConfigurationError for a wrong command, and if a file exists already.
    """
    parser = _InitParser(prog="seatrial init", description="Write files to start from.")
    subjects = parser.add_subparsers(dest="subject", required=True, metavar="SUBJECT")
    for name, subject in SUBJECTS.items():
        options = subjects.add_parser(name, help=subject.summary, description=subject.summary)
        options.add_argument("name", metavar="NAME", type=_name)
        subject.declare(options)
    if not words:
        drafts = " or ".join(f"{parser.prog} {subject} NAME" for subject in SUBJECTS)
        raise ConfigurationError(f"init: got nothing to start, expected {drafts}")
    arguments = parser.parse_args(words)
    draft = SUBJECTS[arguments.subject].draft(arguments)
    _write(draft.files)
    print(*(f"wrote {path.as_posix()}" for path in draft.files), f"try: {draft.use}", sep="\n")
    return 0


def _write(files: Mapping[Path, str]) -> None:
    """Write all files or, if one of them exists, none."""
    for path in files:
        if path.exists() or path.is_symlink():
            raise ConfigurationError(f"{path.as_posix()} exists, expected a new name")
    for path, text in files.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise ConfigurationError(f"{path.as_posix()}: {error.strerror}") from error


def _name(text: str) -> str:
    if not NAME.fullmatch(text):
        raise argparse.ArgumentTypeError(f"got {text!r}, expected letters, digits and _")
    return text


def _filled(template: str, values: Mapping[str, object]) -> str:
    """The text of a template; its numbers have four digits."""
    shown = {
        key: _number(value) if isinstance(value, float) else value for key, value in values.items()
    }
    return Template((TEMPLATES / template).read_text(encoding="utf-8")).substitute(shown)


def _number(value: float) -> str:
    """Four digits, written as a number of YAML: with a point, also before an exponent."""
    mantissa, e, exponent = repr(float(f"{value:.4g}")).partition("e")
    return f"{mantissa if '.' in mantissa else f'{mantissa}.0'}{e}{exponent}"


# A vessel

DIMENSIONS = {
    "length": ("[m] between perpendiculars (default: 5)", 5.0),
    "beam": ("[m] at the waterline (default: a third of the length)", None),
    "draught": ("[m] (default: that of the mass, or a third of the beam)", None),
    "mass": ("[kg] displacement (default: from the draught)", None),
}


def _declare_vessel(options: argparse.ArgumentParser) -> None:
    for name, (meaning, default) in DIMENSIONS.items():
        options.add_argument(f"--{name}", type=_size, default=default, help=meaning, metavar="X")


def _size(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a positive number")
    return value


def _draft_vessel(arguments: argparse.Namespace) -> Draft:
    given = {option: getattr(arguments, option) for option in DIMENSIONS}
    return draft_vessel(arguments.name, given)


def draft_vessel(name: str, given: Mapping[str, float | None]) -> Draft:
    """A planar vessel of some dimensions (length, beam, draught, mass), in conf/vessel."""
    path = Path("conf", "vessel", f"{name}.yaml")
    if (CONF / "vessel" / path.name).is_file():
        raise ConfigurationError(f"vessel {name} is seatrial's own, expected a new name")
    given = {option: given.get(option) for option in DIMENSIONS}
    words = "".join(f" --{key} {value:g}" for key, value in given.items() if value is not None)
    hull = scales.hull(*given.values())  # type: ignore[arg-type]
    forces = scales.derivatives(hull)
    thrust = scales.limits(hull)
    values = {
        "name": name, "path": path.as_posix(), "given": words,
        "length": hull.length_m, "beam": hull.beam_m, "draught": hull.draught_m,
        "mass": hull.mass_kg, **scales.rigid_body(hull),
        **{key.replace("|", ""): value for key, value in forces.items()},
        "surge_n": thrust[0], "sway_n": thrust[1], "yaw_nm": thrust[2],
    }  # fmt: skip
    text = _filled("vessel.yaml", values)
    return Draft({path: text}, f"{trial_program()} vessel={path.as_posix()}")


# A plug-in


def _draft_plugin(arguments: argparse.Namespace) -> Draft:
    """An identifier, its options in conf/identifier, and its test."""
    name = arguments.name
    if iskeyword(name) or not name.islower():
        raise ConfigurationError(f"init plugin: got {name!r}, expected small letters, digits and _")
    if (CONF / "identifier" / f"{name}.yaml").is_file():
        raise ConfigurationError(f"identifier {name} is seatrial's own, expected a new name")
    spec = find_spec(name)  # what an import would find in place of the new file
    elsewhere = spec is not None and Path(spec.origin or "").parent != Path.cwd()
    if name in sys.stdlib_module_names or elsewhere:
        raise ConfigurationError(f"init plugin: {name} is a module of Python, expected a new name")
    values = {"name": name, "class_name": "".join(map(str.capitalize, name.split("_")))}
    templates = {
        Path(f"{name}.py"): "plugin.py.template",
        Path("conf", "identifier", f"{name}.yaml"): "plugin.yaml.template",
        Path(f"test_{name}.py"): "plugin_test.py.template",
    }
    files = {path: _filled(template, values) for path, template in templates.items()}
    return Draft(files, f"{trial_program()} identifier={name}, python -m pytest test_{name}.py")


SUBJECTS = {
    "vessel": Subject(
        "A vessel as a YAML file, every number with its symbol, unit and where to find it.",
        _declare_vessel,
        _draft_vessel,
    ),
    "plugin": Subject(
        "An identifier, its options and a test: a plug-in to change.",
        lambda options: None,
        _draft_plugin,
    ),
}
