"""The options of a YAML file of `conf`, with their defaults and the comments beside them."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

from seatrial.runner.configuration.hydra_errors import CONF

LONGEST = 90  # characters of a default
_COMMENT = re.compile(r"(?:^|\s)#\s?(.*)$")
_UNIT_WORD = re.compile(r"(?:1|m|s|rad|deg|N|Nm|kg|Hz|GB|L|U|%|-)(?:\^\d)?")
# Of a name that ends so, if no comment says it; longer endings first.
_ENDINGS = {
    "_rad_s": "rad/s", "_m_s": "m/s", "_deg": "deg", "_hz": "Hz", "_nm": "Nm", "_n": "N",
    "_s": "s", "_m": "m",
}  # fmt: skip


@dataclass(frozen=True)
class Option:
    """One option: its name with dots, its class and its place in it, its default and comment."""

    name: str
    owner: str
    path: tuple[str, ...]
    default: str
    comment: str

    @property
    def unit(self) -> str:
        """The units that the comment states in brackets, else that of the name's ending."""
        found = [text for text in re.findall(r"\[([^\[\]]+)\]", self.comment) if _is_unit(text)]
        if found:
            return found[0] if len(set(found)) == 1 else ", ".join(found)
        last = self.name.rpartition(".")[2]
        return next((unit for ending, unit in _ENDINGS.items() if last.endswith(ending)), "")

    @property
    def description(self) -> str:
        """The comment without the unit at its beginning or end."""
        unit = re.escape(f"[{self.unit}]")
        return re.sub(rf"^{unit}[,:;]? ?| ?{unit}$", "", self.comment)


def _is_unit(text: str) -> bool:
    return all(map(_UNIT_WORD.fullmatch, re.split(r"[\s,/]+", text)))


@dataclass(frozen=True)
class OptionFile:
    """One file of a group: what its head says, whom it inherits from, its class and options."""

    name: str
    head: str
    parents: tuple[str, ...]
    target: str
    options: tuple[Option, ...]


@cache
def option_file(path: Path) -> OptionFile:
    """The file at a path below `conf`."""
    text = path.read_text()
    lines = text.splitlines()
    head = []
    for line in lines:
        if not line.startswith("#"):
            break
        head.append(line.lstrip("# "))
    node = yaml.compose(text)
    held = yaml.safe_load(text) or {}
    parents = tuple(
        one for one in held.get("defaults", ()) if isinstance(one, str) and one != "_self_"
    )
    options = _options(node, lines, "", "") if isinstance(node, yaml.MappingNode) else ()
    shown = [line for line in head if "@package" not in line]
    return OptionFile(path.stem, " ".join(shown), parents, _target(held, path), tuple(options))


def files(group: str) -> tuple[OptionFile, ...]:
    """The files of a group, by name."""
    return tuple(option_file(path) for path in sorted((CONF / group).glob("*.yaml")))


def _target(held: dict[str, object], path: Path) -> str:
    if "_target_" in held:
        return str(held["_target_"])
    defaults = held.get("defaults", ())
    assert isinstance(defaults, list | tuple)
    parents = [one for one in defaults if isinstance(one, str) and one != "_self_"]
    return option_file(path.with_name(f"{parents[0]}.yaml")).target if parents else ""


def _options(
    node: yaml.MappingNode, lines: list[str], prefix: str, owner: str, path: tuple[str, ...] = ()
) -> Iterator[Option]:
    for word, (key, value) in _merged(node).items():
        if word in ("_target_", "defaults", "hydra"):
            continue
        name, below, comment = f"{prefix}{word}", (*path, word), _comment(lines, key)
        if not isinstance(value, yaml.MappingNode) or not value.value or value.flow_style:
            yield Option(name, owner, below, _short(_flow(value)), comment)
            continue
        inner = _class_of(value)
        if _is_collection(value) or comment:
            yield Option(name, owner, below, "", comment)
        if _is_collection(value):
            for one, (line, entry) in _merged(value).items():
                kind = _class_of(entry).rpartition(".")[2]
                yield Option(f"{name}.{one}", "", (), kind, _comment(lines, line))
        else:
            yield from _options(value, lines, f"{name}.", inner or owner, () if inner else below)


def _merged(node: yaml.Node) -> dict[str, tuple[int, yaml.Node]]:
    """The values of a mapping with the lines of their keys, those of `<<` included."""
    values: dict[str, tuple[int, yaml.Node]] = {}
    for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
        if key.value == "<<":
            values = _merged(value) | values
        else:
            values[key.value] = (key.start_mark.line, value)
    return values


def _class_of(node: yaml.Node) -> str:
    """The class that a mapping names; empty if it names none."""
    _, value = _merged(node).get("_target_", (0, None))
    return str(value.value) if value is not None else ""


def _is_collection(node: yaml.Node) -> bool:
    """Whether all that a mapping holds are objects, as the candidates of a mix."""
    return all(map(_class_of, (value for _, value in _merged(node).values())))


def _flow(node: yaml.Node) -> str:
    """A value on one line, as it is written."""
    if isinstance(node, yaml.MappingNode):
        held = {word: one for word, (_, one) in _merged(node).items()}
        return "{" + ", ".join(f"{word}: {_flow(one)}" for word, one in held.items()) + "}"
    if isinstance(node, yaml.SequenceNode):
        return "[" + ", ".join(map(_flow, node.value)) + "]"
    return str(node.value)


def _short(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 2]} …"


def _comment(lines: list[str], number: int) -> str:
    """The comment at the end of a line, and the lines below it that are comments alone."""
    found = _COMMENT.search(_without_quotes(lines[number]))
    if found is None:
        return ""
    parts = [found[1]]
    for line in lines[number + 1 :]:
        if not re.match(r"\s+#", line):
            break
        parts.append(line.strip().lstrip("# "))
    return " ".join(parts)


def _without_quotes(line: str) -> str:
    """A line without the quoted texts that may hold a `#`."""
    return re.sub(r"^([^#]*?)\"[^\"]*\"", r"\1", line)
