"""Harbours: names and GeoJSON files in the options of a docking become their texts by name."""

from collections.abc import Mapping

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.search_path import HARBOURS, harbour_file


def with_harbours(node: object) -> object:
    """The options of an evaluation with the texts of its harbours; raises ConfigurationError."""
    if not isinstance(node, Mapping) or isinstance(node.get("harbour", {}), Mapping):
        return node
    names = [node["harbour"]] if isinstance(node["harbour"], str) else node["harbour"]
    try:
        texts = {str(name): harbour_file(name).read_text(encoding="utf-8") for name in names}
    except (OSError, ValueError, TypeError) as error:
        known = sorted(file.stem for file in HARBOURS.glob("*.geojson"))
        what = f"got {names}, expected GeoJSON files or some of {known}: {error}"
        raise ConfigurationError(f"evaluation.harbour: {what}") from error
    return {**node, "harbour": texts}
