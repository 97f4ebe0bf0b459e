"""`seatrial init SUBJECT NAME`: files to start from, in the working folder.

Their templates are in the folder `templates`.
"""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Annotated

import typer

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.configuration.invocation import trial_program
from seatrial.runner.configuration.search_path import CONF

if TYPE_CHECKING:  # what is slow to import
    import yaml

    from seatrial.models.vessel import scales
else:
    import lazy_loader

    yaml = lazy_loader.load("yaml")
    scales = lazy_loader.load("seatrial.models.vessel.scales", suppress_warning=True)

TEMPLATES = Path(__file__).parent / "templates"
app = typer.Typer(
    name="seatrial init", pretty_exceptions_enable=False, add_completion=False,
    help="Write files to start from.",
)  # fmt: skip
Name = Annotated[str, typer.Argument(metavar="NAME", help="Name of the files.")]


def main(words: Sequence[str]) -> int:
    """Write the files that `seatrial init WORDS` asks for; return the exit code.

    Raises ConfigurationError for a wrong command, and if a file exists already.
    """
    if not words:
        subjects = " or ".join(f"seatrial init {name} NAME" for name in ("vessel", "plugin"))
        raise ConfigurationError(f"init: got nothing to start, expected {subjects}")
    return run_typer(app, words)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise typer.BadParameter(f"got {text!r}, expected a number") from error


Size = partial(typer.Option, parser=_number, metavar="X")


@app.command("vessel")
def _vessel(
    name: Name,
    length: Annotated[float, Size(help="[m] between perpendiculars")] = 5.0,
    beam: Annotated[
        float | None, Size(help="[m] at the waterline (default: a third of the length)")
    ] = None,
    draught: Annotated[
        float | None, Size(help="[m] (default: that of the mass, or a third of the beam)")
    ] = None,
    mass: Annotated[float | None, Size(help="[kg] displacement (default: of the draught)")] = None,
) -> None:
    """A vessel as a YAML file, every number with its symbol, unit and where to find it."""
    given = {"length": length, "beam": beam, "draught": draught, "mass": mass}
    path = new_option("vessel", name)
    _write({path: draft_vessel(name, given)}, f"{trial_program()} vessel={path.as_posix()}")


@app.command("plugin")
def _plugin(name: Name) -> None:
    """An identifier, its options and a test: a plug-in to change."""
    options = new_option("identifier", name)
    if iskeyword(name) or not name.islower():
        raise ConfigurationError(f"init plugin: got {name!r}, expected small letters, digits and _")
    spec = find_spec(name)  # what an import would find in place of the new file
    elsewhere = spec is not None and Path(spec.origin or "").parent != Path.cwd()
    if elsewhere:
        raise ConfigurationError(f"init plugin: {name} is a module of Python, expected a new name")
    values = {"name": name, "class_name": "".join(map(str.capitalize, name.split("_")))}
    files = {
        Path(f"{name}.py"): _filled("plugin.py.template", values),
        options: _filled("plugin.yaml.template", values),
        Path(f"test_{name}.py"): _filled("plugin_test.py.template", values),
    }
    _write(files, f"{trial_program()} identifier={name}, python -m pytest test_{name}.py")


def new_option(group: str, name: str) -> Path:
    """Return the file of a new option; raises ConfigurationError for a name that it cannot have."""
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        raise ConfigurationError(f"init: NAME: got {name!r}, expected letters, digits and _")
    path = Path(group, f"{name}.yaml")
    if (CONF / path).is_file():
        raise ConfigurationError(f"{group} {name} is seatrial's own, expected a new name")
    return "conf" / path


def _write(files: Mapping[Path, str], use: str) -> None:
    """Write all files or, if one of them exists, none; print what to do with them."""
    for path in files:
        if path.exists() or path.is_symlink():
            raise ConfigurationError(f"{path.as_posix()} exists, expected a new name")
    for path, text in files.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(f"{path.as_posix()}: {error.strerror}") from error
    print(*(f"wrote {path.as_posix()}" for path in files), f"try: {use}", sep="\n")


def _filled(template: str, values: Mapping[str, object]) -> str:
    """The text of a template; its numbers are those of YAML with four digits."""
    shown = {
        key: yaml.safe_dump(float(f"{value:.4g}")).split()[0] if isinstance(value, float) else value
        for key, value in values.items()
    }
    return Template((TEMPLATES / template).read_text(encoding="utf-8")).substitute(shown)


def draft_vessel(name: str, given: Mapping[str, float | None]) -> str:
    """A planar vessel of some dimensions (length, beam, draught, mass) as a YAML file."""
    known = {key: value for key, value in given.items() if value is not None}
    hull = scales.hull(known["length"], *map(known.get, ("beam", "draught", "mass")))
    forces, thrust = scales.derivatives(hull), scales.limits(hull)
    values = {
        "name": name, "path": f"conf/vessel/{name}.yaml",
        "given": "".join(f" --{key} {value:g}" for key, value in known.items()),
        "length": hull.length_m, "beam": hull.beam_m, "draught": hull.draught_m,
        "mass": hull.mass_kg, **scales.rigid_body(hull),
        **{key.replace("|", ""): value for key, value in forces.items()},
        "surge_n": thrust[0], "sway_n": thrust[1], "yaw_nm": thrust[2],
    }  # fmt: skip
    return _filled("vessel.yaml", values)
