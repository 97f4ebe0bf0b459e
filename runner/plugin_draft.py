"""What `seatrial init plugin NAME` writes: an identifier, its options and its test."""

import sys
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path

from seatrial.models.errors import ConfigurationError
from seatrial.runner.search_path import CONF


def values(name: str) -> dict[str, str]:
    """Return what the templates need; raises ConfigurationError for a name that cannot be used."""
    if iskeyword(name) or not name.islower():
        raise ConfigurationError(f"init plugin: got {name!r}, expected small letters, digits and _")
    if (CONF / "identifier" / f"{name}.yaml").is_file():
        raise ConfigurationError(f"identifier {name} is seatrial's own, expected a new name")
    if name in sys.stdlib_module_names or _is_installed(name):
        raise ConfigurationError(f"init plugin: {name} is a module of Python, expected a new name")
    return {"name": name, "class_name": "".join(map(str.capitalize, name.split("_")))}


def _is_installed(name: str) -> bool:
    """Whether an import of this name would find something else than the new file."""
    spec = find_spec(name)
    return spec is not None and Path(spec.origin or "").parent != Path.cwd()


def files(name: str) -> dict[Path, str]:
    """Return the files, from the working folder, and their templates."""
    return {
        Path(f"{name}.py"): "plugin.py.template",
        Path("conf", "identifier", f"{name}.yaml"): "plugin.yaml.template",
        Path(f"test_{name}.py"): "plugin_test.py.template",
    }
