"""Harbours: names and GeoJSON files in the options of a docking become their texts by name."""

from collections.abc import Mapping

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.configuration.search_path import HARBOURS, harbour_file


def with_harbours(node: object) -> object:
    """The options of an evaluation with the texts of its harbours; raises ConfigurationError."""
    names = node.get("harbour") if isinstance(node, Mapping) else None
    if not isinstance(node, Mapping) or not isinstance(names, str | list | tuple):
        return node
    texts: dict[str, str] = {}
    for name in map(str, [names] if isinstance(names, str) else names):
        try:
            texts[name] = harbour_file(name).read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            known = sorted(file.stem for file in HARBOURS.glob("*.geojson"))
            hint = meant(name, known) or f"expected a GeoJSON file or one of {known}; "
            raise ConfigurationError(f"evaluation.harbour: {name}: {hint}{error}") from error
    return {**node, "harbour": texts}
