"""Maps of recordings: YAML files that say which column is what.

The keys of a map are those of `excitation.columns`; other options of `excitation=recording`, such
as `resample_hz`, may stand beside them. A map replaces the columns of the configuration.
"""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import ColumnMap
from seatrial.runner.yaml_files import LOADER, check_file

COLUMNS = tuple(field.name for field in fields(ColumnMap))
NONE: dict[str, object] = {
    "position": {}, "velocity": {}, "acceleration": {}, "force": {}, "actual_force": {},
    "orientation": None,
}  # fmt: skip
ALIASES = {"heading": "yaw", "roll": "roll", "pitch": "pitch"}  # of an angle of the position


def with_map(node: object) -> object:
    """The options of a recording with the content of its map, if it names one."""
    if not isinstance(node, Mapping) or not node.get("map"):
        return node
    # Those of the configuration are for other files.
    return {**node, "heading_deg": 0.0, "statistics": [], **read_map(Path(str(node["map"])))}


def read_map(path: Path) -> dict[str, object]:
    """Options of a recording from a map: `columns`, and those that stand beside them.

    Raises ConfigurationError if there is no such file or it is no map.
    """
    path = path.expanduser()
    check_file(path)
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), LOADER)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise ConfigurationError(
            f"excitation.map: {path}: {reason}, expected a YAML file of columns"
        ) from error
    if not isinstance(content, dict) or "time" not in content:
        raise ConfigurationError(
            f"excitation.map: {path}: got no time, expected the columns of a recording, such as "
            "time: t and velocity: {surge: u}"
        )
    return options_of(content)


def options_of(content: dict[str, object]) -> dict[str, object]:
    """Options of a recording from the content of a map."""
    columns = {**NONE, **{key: content.pop(key) for key in COLUMNS if key in content}}
    position = dict(columns["position"] if isinstance(columns["position"], dict) else {})
    for alias, dof in ALIASES.items():
        if alias in content:
            position[dof] = content.pop(alias)
    if position:
        columns["position"] = position
    return {**content, "columns": columns}
