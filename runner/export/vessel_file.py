"""A stored model as a vessel of the configuration: YAML with comments, and JSON."""

import json

import yaml

from seatrial.runner.export.stored_model import StoredModel

HEAD = """\
# {source}.
# Sail it with vessel=PATH-OF-THIS-FILE, or with vessel=run:{run} and the database of the run.
# Thrusters, limits and tuning are those of the vessel {vessel}. The terms of the equation of motion
# are listed one by one: coriolis is false because its terms are among the derivatives.
"""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes lists of numbers in a line, and floats so that YAML reads the same numbers."""

    def ignore_aliases(self, data: object) -> bool:
        """Write everything in full."""
        return True


def _list(dumper: yaml.SafeDumper, values: list[object]) -> yaml.SequenceNode:
    flat = not any(isinstance(value, dict | list) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flat)


def _float(dumper: yaml.SafeDumper, value: float) -> yaml.ScalarNode:
    text = repr(value)  # the shortest that gives the same number; YAML takes `1e+20` for a text
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_Dumper.add_representer(float, _float)
_Dumper.add_representer(list, _list)


def as_yaml(model: StoredModel) -> str:
    """The vessel as a file of the group `vessel`."""
    head = HEAD.format(
        source=model.source, run=model.run.summary.run_id, vessel=model.run.summary.vessel
    )
    return head + str(
        yaml.dump(model.node, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)
    )


def as_json(model: StoredModel) -> str:
    """The same node as data."""
    return json.dumps(model.node, indent=2, ensure_ascii=False) + "\n"
