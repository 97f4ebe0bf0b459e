"""Maps of recordings: YAML files that say which column is what.

The keys of a map are those of `excitation.columns`; other options of `excitation=recording`, such
as `resample_hz`, may stand beside them. A map replaces the columns of the configuration. Files for
testing may have a map of their own, with `format` and `text` beside the columns. A file that was
written by `seatrial data convert` holds its map.
"""

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import ColumnMap
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.runner.configuration import options
from seatrial.runner.configuration.search_path import CONF, located

DEFAULT = CONF / "excitation" / "recording.yaml"
MAP_COLUMNS = tuple(field.name for field in fields(ColumnMap))
OTHERS: dict[str, object] = {"heading_deg": 0.0, "statistics": []}  # by default of other files
KEY = "seatrial"  # of the metadata of a converted file


def with_map(node: object) -> object:
    """The options of a recording with the content of its map, or of the one in the file."""
    if not isinstance(node, Mapping):
        return node
    if not node.get("map"):
        files = [node.get("path"), *(node.get("train") or ())]
        known = own_map(Path(str(next(filter(None, files), ""))))
        return {**node, **OTHERS, **known} if known else node
    path = located(str(node["map"]))
    own = {**node, **OTHERS, "map": str(path), **read_map(path)}
    if node.get("test_map"):
        path = located(str(node["test_map"]))
        own |= {"test_map": str(path), "tested": read_map(path)}
    return own


def own_map(path: Path) -> dict[str, object]:
    """The options that a converted file holds; empty for any other."""
    from pyarrow import parquet  # slow to import

    path = path.expanduser()
    if path.suffix != ".parquet" or not path.is_file():
        return {}
    try:
        content = (parquet.read_schema(path).metadata or {}).get(KEY.encode(), b"{}")
        known = json.loads(content).get("map")
    except (OSError, ValueError, AttributeError):  # which reading it says
        return {}
    return options_of(known) if isinstance(known, dict) else {}


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
    if "heading" in content:
        written = columns.get("position")
        position = written if isinstance(written, dict) else {}
        columns["position"] = {**position, "yaw": content.pop("heading")}
    return {**content, "columns": columns}


def reader_of(file: Path, node: Mapping[str, object]) -> RecordedFile:
    """The reader of a file with the options of a map; raises ConfigurationError."""
    default = yaml.safe_load(DEFAULT.read_text(encoding="utf-8"))
    own = {**default, **OTHERS, "path": str(file), **(node or own_map(file))}
    try:
        reader = options.part(RecordedFile, own)
    except options.OptionError as error:
        raise ConfigurationError(error.at("excitation")) from error
    assert isinstance(reader, RecordedFile)
    return reader
