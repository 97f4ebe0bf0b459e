"""Harbours: GeoJSON files, whose texts become the option `charts` of a docking."""

from collections.abc import Mapping

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.configuration.search_path import HARBOURS, harbour_file


def with_harbours(node: object) -> object:
    """The options of an evaluation with the texts of its harbours; raises ConfigurationError."""
    if not isinstance(node, Mapping) or "harbour" not in node or "charts" in node:
        return node
    names = node["harbour"] if isinstance(node["harbour"], list | tuple) else [node["harbour"]]
    return {**node, "harbour": [*names], "charts": {str(name): _text(name) for name in names}}


def _text(name: object) -> str:
    try:
        return harbour_file(name).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        known = sorted(file.stem for file in HARBOURS.glob("*.geojson"))
        hint = meant(str(name), known) or f"expected a GeoJSON file or one of {known}; "
        raise ConfigurationError(f"evaluation.harbour: {name}: {hint}{error}") from error
