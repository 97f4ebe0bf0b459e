"""Maps of recordings: YAML files that say which column is what.

The keys of a map are those of `excitation.columns`; other options of `excitation=recording`, such
as `resample_hz`, may stand beside them. A map replaces the columns of the configuration. Files for
testing may have a map of their own, with `format` and `text` beside the columns.
"""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import ColumnMap
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.runner import options
from seatrial.runner.search_path import CONF, located

DEFAULT = CONF / "excitation" / "recording.yaml"
MAP_COLUMNS = tuple(field.name for field in fields(ColumnMap))
ALIASES = {"heading": "yaw", "roll": "roll", "pitch": "pitch"}  # of an angle of the position


def with_map(node: object) -> object:
    """The options of a recording with the content of its map, if it names one."""
    if not isinstance(node, Mapping) or not node.get("map"):
        return node
    path = located(str(node["map"]))
    # Those of the configuration are for other files.
    own = {**node, "heading_deg": 0.0, "statistics": [], "map": str(path), **read_map(path)}
    if node.get("test_map"):
        path = located(str(node["test_map"]))
        own |= {"test_map": str(path), "tested": read_map(path)}
    return own


def read_map(path: Path) -> dict[str, object]:
    """Options of a recording from a map: `columns`, and those that stand beside them.

    Raises ConfigurationError if there is no such file or it is no map.
    """
    path = path.expanduser()
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        known = getattr(error, "strerror", None) or getattr(error, "problem", None)
        reason = known or str(error).splitlines()[0]
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
    columns = {key: content.pop(key) for key in MAP_COLUMNS if key in content}
    written = columns.get("position")
    position = dict(written) if isinstance(written, dict) else {}
    for alias, dof in ALIASES.items():
        if alias in content:
            position[dof] = content.pop(alias)
    if position:
        columns["position"] = position
    return {**content, "columns": columns}


def reader_of(file: Path, node: Mapping[str, object]) -> RecordedFile:
    """The reader of a file with the options of a map; raises ConfigurationError."""
    default = yaml.safe_load(DEFAULT.read_text(encoding="utf-8"))
    own = {**default, "path": str(file), "heading_deg": 0.0, "statistics": [], **node}
    try:
        reader = options.part(RecordedFile, own)
    except options.OptionError as error:
        raise ConfigurationError(error.at("excitation")) from error
    assert isinstance(reader, RecordedFile)
    return reader
