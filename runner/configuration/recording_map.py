"""Maps of recordings: YAML files with the keys of `excitation.columns`, which they replace.

Other options of `excitation=recording`, such as `resample_hz`, may stand beside them. A map of the
files for testing has `format` and `text` beside the columns. A converted file holds its map.
"""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import ColumnMap
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.runner.configuration import options
from seatrial.runner.configuration.invocation import in_words
from seatrial.runner.configuration.search_path import CONF, located

DEFAULT = CONF / "excitation" / "recording.yaml"
OTHERS: dict[str, object] = {"heading_deg": 0.0}  # by default of other files
KEY = b"seatrial"  # of the metadata of a converted file


def with_map(node: object) -> object:
    """The options of a recording with the content of its map, or of the one in the file."""
    if not isinstance(node, Mapping):
        return node
    maps = {key: str(located(str(node[key]))) for key in ("map", "test_map") if node.get(key)}
    files = filter(None, (node.get("path"), *(node.get("train") or ())))
    known = read_map(maps["map"]) if "map" in maps else own_map(Path(str(next(files, ""))))
    tested = {"tested": read_map(maps["test_map"])} if "test_map" in maps else {}
    return {**node, **OTHERS, **maps, **known, **tested} if known else node


def own_map(path: Path) -> dict[str, object]:
    """The options that a converted file holds; empty for any other."""
    from pyarrow import parquet  # slow to import

    path = path.expanduser()
    if path.suffix == ".parquet" and path.is_file():
        with suppress(OSError, ValueError, KeyError, TypeError):  # which reading it says
            return options_of(json.loads(parquet.read_schema(path).metadata[KEY])["map"])
    return {}


def read_map(path: str | Path) -> dict[str, object]:
    """Options of a recording from a map: `columns`, and those that stand beside them.

    Raises ConfigurationError if there is no such file or it is no map.
    """
    path = Path(path).expanduser()
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        told = (getattr(error, name, None) for name in ("strerror", "problem"))
        reason = in_words(next(filter(None, told), str(error).splitlines()[0]))
        raise ConfigurationError(f"excitation.map: {path}: {reason}, expected YAML") from error
    if not isinstance(content, dict) or "time" not in content:
        expected = "expected the columns of a recording, such as time: t, velocity: {surge: u}"
        raise ConfigurationError(f"excitation.map: {path}: got no time, {expected}")
    return options_of(content)


def options_of(content: dict[str, Any]) -> dict[str, object]:
    """Options of a recording from the content of a map."""
    keys = {field.name for field in fields(ColumnMap)}
    columns = {key: value for key, value in content.items() if key in keys}
    others = {key: value for key, value in content.items() if key not in keys}
    if "heading" in others:
        position = columns.get("position")
        known = position if isinstance(position, Mapping) else {}
        columns["position"] = {**known, "yaw": others.pop("heading")}
    return {**others, "columns": columns}


def reader_of(file: Path, node: Mapping[str, object]) -> RecordedFile:
    """The reader of a file with the options of a map; raises ConfigurationError."""
    default = yaml.safe_load(DEFAULT.read_text(encoding="utf-8")) | {"path": str(file)}
    own = {**default, **OTHERS, **node} if node else with_map(default)
    try:
        reader = options.part(RecordedFile, own)
    except options.OptionError as error:
        raise ConfigurationError(error.at("excitation")) from error
    assert isinstance(reader, RecordedFile)
    return reader
