"""JSON schema of every option: `python -m docs.schema > schema.json`.

Types and ranges are the classes' own, defaults those of the files in `conf`, descriptions the
comments and docstrings beside them. The root describes a whole configuration, an experiment and
`conf/trial.yaml`; `#/$defs/vessel` any file of the group `vessel`, and so on, for editors;
`#/$defs/vessel.milliampere` one option, with its defaults. Nothing is required, because a file may
inherit from another, and an interpolation `${...}` may stand for any value.
"""

import inspect
import json
import re
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from seatrial.models.vessel.tuning import AUTO, marks_of
from seatrial.runner.configuration.config import Settings
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.configuration.options import CLASS, options, target
from seatrial.runner.record.vocabulary import GROUPS

Schema = dict[str, Any]
DATABASE = "seatrial.runner.configuration.config.Database"
INTERPOLATION: Schema = {"type": "string", "pattern": r"\$\{"}
FROM_VESSEL: Schema = {"const": AUTO}  # taken from the vessel
NODE: Schema = {"type": "object"}  # of a class that may be anybody's
NAMED: Schema = {"type": "object", "required": ["_target_"]}
COMMENT = re.compile(r"^ *(\w+):[^#\n]*# *(.+)$", re.MULTILINE)


def schema() -> Schema:
    """The schema of all options."""
    for path in CONF.rglob("*.yaml"):  # so that the classes of every role are known
        for name in re.findall(r"_target_: (seatrial\.[\w.]+)", path.read_text()):
            target(name)
    classes: dict[str, Schema] = {}
    whole = _described(Settings, classes)
    groups = {group: _group(group, classes) for group in (*GROUPS, "database")}
    trial = _option(CONF / "trial.yaml")["properties"]
    for name, declared in whole["properties"].items():
        if name in groups:
            whole["properties"][name] = {"$ref": f"#/$defs/{name}"}
        elif name != "_target_":
            declared.update(trial.get(name, {}))
    whole["properties"]["hydra"] = {"type": "object"}
    definitions = dict(classes)
    for group, files in groups.items():
        definitions |= {f"{group}.{name}": files[name] for name in files}
        references = {json.dumps(one["allOf"][0]) for one in files.values() if "allOf" in one}
        alternatives = [json.loads(text) for text in sorted(references)]
        definitions[group] = {"anyOf": [*alternatives, {"type": "object", "maxProperties": 0}]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **whole,
        "$defs": definitions,
    }


def _group(group: str, classes: dict[str, Schema]) -> dict[str, Schema]:
    """The options of a group by name, each with the schema of its class beside its defaults."""
    described = {}
    for path in sorted((CONF / group).glob("*.yaml")):
        described[path.stem] = option = _option(path)
        name = DATABASE if group == "database" else _target_of(path)
        if name:
            option["allOf"] = [_reference(name, classes)]
    return described


def _target_of(path: Path) -> str | None:
    """The class of an option, its own or that of the option it inherits from."""
    node: Any = OmegaConf.to_container(OmegaConf.load(path))
    if "_target_" in node:
        return str(node["_target_"])
    parents = [one for one in node.get("defaults", []) if one != "_self_"]
    return _target_of(path.with_name(f"{parents[0]}.yaml")) if parents else None


def _option(path: Path) -> Schema:
    """Defaults and comments of a file."""
    text = path.read_text()
    node: Any = OmegaConf.to_container(OmegaConf.load(path))
    comments = dict(COMMENT.findall(text))
    head = re.match(r"(?:#.*\n)*", text)
    described: Schema = {"title": path.stem, "properties": {}}
    if head and head[0]:
        described["description"] = " ".join(head[0].replace("#", " ").split())
    for name, value in node.items():
        described["properties"][name] = {"default": value}
        if name in comments:
            described["properties"][name]["description"] = comments[name]
    return described


def _reference(name: str, classes: dict[str, Schema]) -> Schema:
    """A reference to the schema of a class, which is added to `classes`."""
    if name not in classes:
        classes[name] = {}  # a class may hold others of its kind
        classes[name] = _described(target(name), classes)
    return {"$ref": f"#/$defs/{name}"}


def _described(cls: type, classes: dict[str, Schema]) -> Schema:
    """The schema of a class: its options, with the comments beside them."""
    comments = dict(COMMENT.findall(inspect.getsource(cls)))
    own = options(cls).json_schema()
    inner = own.pop("$defs", {})  # of options to choose among
    for name in inner:
        own["properties"][name] = {"anyOf": [inner[name], {"type": "null"}]}
    described = _resolved(own, classes)
    described.pop("required", None)
    described["description"] = inspect.getdoc(cls)
    for name, mark in marks_of(cls).marks.items():
        alternative = FROM_VESSEL if mark.entry is None else NODE
        described["properties"][name] = {"anyOf": [described["properties"][name], alternative]}
    for name, option in described["properties"].items():
        if name in comments:
            option["description"] = comments[name]
    described["properties"] |= {"_target_": {"type": "string"}, "defaults": {"type": "array"}}
    return described


def _resolved(part: Any, classes: dict[str, Schema]) -> Any:
    """A schema in which classes are references, and interpolations may stand for values."""
    if isinstance(part, list):
        return [_resolved(one, classes) for one in part]
    if not isinstance(part, dict):
        return part
    if CLASS in part:
        cls = part[CLASS]
        ours = [_reference(name, classes) for name in _classes_of(cls)]
        return {"anyOf": [*ours, NAMED, INTERPOLATION] if ours else [NODE, INTERPOLATION]}
    resolved = {key: _resolved(value, classes) for key, value in part.items()}
    if isinstance(part.get("title"), str):  # pydantic's own: the name once more
        del resolved["title"]
    if "properties" in part or not {"type", "const", "enum"} & set(part):
        return resolved
    return {"anyOf": [resolved, INTERPOLATION]}


def _classes_of(name: str) -> list[str]:
    """The classes of ours that stand for a declared one: itself, or those that fill a role."""
    module, _, attribute = name.rpartition(".")
    pending, classes = [getattr(import_module(module), attribute)], []
    while pending:
        cls = pending.pop()
        pending += cls.__subclasses__() if cls is not object else []
        if is_dataclass(cls) and cls.__module__.startswith("seatrial."):
            classes.append(f"{cls.__module__}.{cls.__qualname__}")
    return sorted(classes)


if __name__ == "__main__":
    print(json.dumps(schema(), indent=1))
