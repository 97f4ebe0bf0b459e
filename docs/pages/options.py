"""The reference of the options: `docs/schema.py` says their types, the files of `conf` the rest."""

from dataclasses import replace
from functools import cache

from docs.pages.markdown import code, prose, table
from docs.pages.yaml_options import Option, OptionFile, files, option_file
from docs.schema import Schema, schema
from seatrial.runner.configuration.hydra_errors import CONF

HEADERS = ("option", "default", "type", "unit", "what it is")
VESSEL = "seatrial.models.vessel.parameters.VesselParameters"
DATABASE = "seatrial.runner.configuration.config.Database"  # the only class that files do not name
MOST_NAMED = 5  # alternatives of a type
ANY_CLASS = code("_target_")  # of anybody's
_SYMBOLS = {"minimum": "≥ ", "exclusiveMinimum": "> ", "maximum": "≤ ", "exclusiveMaximum": "< "}


@cache
def _whole() -> Schema:
    return schema()


def group(name: str) -> str:
    """The section of every file of a group: its class, its defaults and its options."""
    return "\n".join(_section(one, name) for one in files(name))


def vessel_class() -> str:
    """What a file of a vessel may hold, and the parts that it may hold in turn."""
    pending, seen = [VESSEL], []
    while pending:
        path = pending.pop(0)
        if path not in seen:
            seen.append(path)
            pending += _references(_whole()["$defs"][path])
    return "\n".join(_class_section(path) for path in (VESSEL, *sorted(seen[1:], key=_last)))


def _references(node: object) -> list[str]:
    """The classes that a schema refers to."""
    if isinstance(node, list):
        return [path for one in node for path in _references(one)]
    if not isinstance(node, dict):
        return []
    own = [_last(node["$ref"], "/")] if "$ref" in node else []
    return own + [path for one in node.values() for path in _references(one)]


def _class_section(path: str) -> str:
    held = _whole()["$defs"][path]
    lines = [f"## {_last(path)}", "", code(path), ""]
    rows = []
    for name, declared in held["properties"].items():
        if name not in ("_target_", "defaults"):
            option = Option(name, path, (name,), "", str(declared.get("description", "")))
            rows.append([code(name), type_text(declared), option.unit, prose(option.description)])
    described = str(held.get("description", "")).partition("\n\n")[0]
    table_text = table(("entry", "type", "unit", "what it is"), rows)
    return "\n".join([*lines, prose(described), "", table_text])


def _last(path: str, sign: str = ".") -> str:
    return path.rpartition(sign)[2]


def trial() -> str:
    """The options of a trial that belong to no group."""
    kept = option_file(CONF / "trial.yaml")
    return _table(kept.options, "")  # of no class: the root of the schema


def _section(file: OptionFile, group: str) -> str:
    lines = [f"## {file.name}", "", prose(file.head), ""]
    if file.parents:
        lines += [f"Begins with {', '.join(map(code, file.parents))}.", ""]
    if file.options:
        lines += [_table(file.options, file.target or DATABASE)]
    return "\n".join(lines)


def _table(options: tuple[Option, ...], target: str) -> str:
    rows = []
    for option in options:
        declared = _declared(option, target) or {}
        if not option.comment:  # then what stands beside the option in its class
            option = replace(option, comment=str(declared.get("description", "")))
        kind, described = type_text(declared), option.description
        if code_list(described) in kind:  # nothing but the values that the type names
            described = ""
        rows.append([code(option.name), code(option.default), kind, option.unit, prose(described)])
    return table(HEADERS, rows)


def _declared(option: Option, target: str) -> Schema | None:
    """What the class of an option declares of it; None if the class is free in it."""
    if not option.path:
        return None
    whole = _whole()
    owner = option.owner or target
    node: Schema | None = whole["$defs"].get(owner) if owner else whole
    for word in option.path:
        held = _resolved(node or {})
        node = held.get("properties", {}).get(word, held.get("additionalProperties"))
    return node if isinstance(node, dict) else None


def _resolved(node: Schema) -> Schema:
    """A schema, or the only class among its alternatives."""
    if "$ref" in node:
        return dict(_whole()["$defs"][_last(node["$ref"], "/")])
    for one in node.get("anyOf", ()):
        resolved = _resolved(one)
        if {"properties", "additionalProperties"} & set(resolved):
            return resolved
    return node


def type_text(node: Schema) -> str:
    """A schema in words: `number > 0 or null`."""
    texts = list(dict.fromkeys(text for text in _alternatives(node) if text))
    named = [text for text in texts if text != ANY_CLASS]
    if len(named) > MOST_NAMED:
        named = [*named[:2], f"{len(named) - 2} more"]
    return " or ".join(named or texts)


def code_list(described: str) -> str:
    """A comment `a | b` as the type of these values is shown."""
    return ", ".join(code(word.strip()) for word in described.split("|")) or "no text"


def _alternatives(node: Schema) -> list[str]:
    if "anyOf" in node:
        return [text for one in node["anyOf"] for text in _alternatives(one)]
    if "$ref" in node:
        return [code(_last(node["$ref"]))]
    if "enum" in node:
        return [", ".join(code(str(value)) for value in node["enum"])]
    if "const" in node:
        return [code(str(node["const"]))]
    match node.get("type"):
        case "string" if "pattern" in node:  # an interpolation, which may stand for anything
            return []
        case "object" if "required" in node or set(node) == {"type"}:
            return [ANY_CLASS] if "required" in node else []
        case "object":
            return ["mapping" + _of(node.get("additionalProperties"))]
        case "array":
            return ["list" + _of(node.get("items"))]
        case "null":
            return [code("null")]
        case str() as kind:
            bounds = "".join(
                f" {sign}{node[key]:g}" for key, sign in _SYMBOLS.items() if key in node
            )
            return [{"string": "text", "boolean": "true or false"}.get(kind, kind) + bounds]
    return []


def _of(node: object) -> str:
    return f" of {text}" if isinstance(node, dict) and (text := type_text(node)) else ""
