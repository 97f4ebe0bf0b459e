"""The resolved configurations of jobs that set the same options to different values.

Only the values that differ from the job before are set, and only the interpolations that depend on
them are resolved again.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, TypeAlias

from hydra.core.override_parser.types import Override
from omegaconf import Container, DictConfig, ListConfig, OmegaConf

from seatrial.models.errors import ConfigurationError
from seatrial.runner.overrides import Refused, apply, set_value

MOST_NODES = 100_000  # of a resolved configuration
Path = tuple[str | int, ...]
Node: TypeAlias = Any  # of OmegaConf, whose nodes have no public interface
_REFERENCE = re.compile(r"\$\{([A-Za-z_]\w*(?:\.\w+)*)\}")
_COPYING = r"oc\.(?:select|deprecated|dict\.keys|dict\.values)\s*:"  # resolvers of nodes by name
# ${a.b[0]}, ${..a}, ${oc.select:a}, and names that are interpolations themselves, as ${a.${b}}
_ANY_REFERENCE = re.compile(rf"\$\{{\s*(?:{_COPYING}[\s'\"]*)?(\.*)([^{{}}:,'\"]*)[}},'\"]")
_COMPUTED = re.compile(rf"\$\{{\s*(?:{_COPYING})?[^{{}}:,]*\$\{{")
MOST_COMPUTED = 12  # names, of which each may stand for any node
_ENVIRONMENT = re.compile(r"\$\{oc\.env:\w+(?:,[\w./-]*)?\}")
# Resolvers of OmegaConf read the configuration and the environment alone, and so do relative paths.
_PURE = re.compile(r"\$\{(?:oc\.[a-z.]+:|\.)")


def pure(text: str) -> bool:
    """Return whether interpolations in a text depend on the configuration and environment only."""
    rest = _REFERENCE.sub("", text)
    return len(_PURE.findall(rest)) == rest.count("${")


def interpolations(config: DictConfig) -> list[tuple[Container, str | int, Path]]:
    """Return (container, key, path) of every interpolation of a configuration."""
    return list(_interpolations(config, ()))


def _interpolations(node: Container, path: Path) -> Iterator[tuple[Container, str | int, Path]]:
    for key in _keys(node):
        child: Node = node._get_node(key)
        if child._is_interpolation():
            yield node, key, (*path, key)
        elif isinstance(child, Container) and not child._is_none() and not child._is_missing():
            yield from _interpolations(child, (*path, key))


def _keys(node: Node) -> Iterable[str | int]:
    return range(len(node)) if isinstance(node, ListConfig | list) else iter(node)


def text_of(container: Container, key: str | int) -> str:
    """Return the text of an interpolation."""
    node: Node = container._get_node(key)
    return str(node._value())


def check_size(config: DictConfig) -> None:
    """Raise ConfigurationError for a configuration whose interpolations explode.

    Few lines can stand for more nodes than the memory holds, as `b: [${a},${a}]`, `c: [${b},${b}]`.
    So they are counted without being resolved; a text counts for every hundred letters.
    """
    sizes = _Sizes(config)
    try:
        nodes = sizes.of(config)
    except RecursionError:
        raise ConfigurationError("interpolations refer to each other too many times") from None
    if sizes.computed > MOST_COMPUTED:
        raise ConfigurationError(
            f"interpolations within interpolations: got {sizes.computed} such names, "
            f"expected at most {MOST_COMPUTED}"
        )
    if nodes > MOST_NODES:
        raise ConfigurationError(
            f"interpolations stand for {nodes:.2g} nodes, expected at most {MOST_NODES}"
        )


class _Sizes:
    """Numbers of nodes with those that interpolations stand for; each node is visited once."""

    def __init__(self, root: Container) -> None:
        self._root = root
        self._known: dict[int, int] = {}
        self.computed = 0  # names that depend on other nodes

    def of(self, node: Node) -> int:
        """The size of a node; 1 within itself, which OmegaConf refuses later."""
        if node is None:
            return 1
        if id(node) not in self._known:
            self._known[id(node)] = 1
            self._known[id(node)] = self._counted(node)
        return self._known[id(node)]

    def _counted(self, node: Node) -> int:
        plain = not (node._is_none() or node._is_missing() or node._is_interpolation())
        if plain and isinstance(node, Container):
            return 1 + sum(self.of(node._get_node(key)) for key in _keys(node))
        text = str(node._value())
        self.computed += len(_COMPUTED.findall(text))
        targets = (self._target(node, *found) for found in _ANY_REFERENCE.findall(text))
        return 1 + len(text) // 100 + sum(map(self.of, targets))

    def _target(self, node: Node, dots: str, path: str) -> Node:
        """The node that a reference names, or what it is a part of; None if there is none."""
        at: Node = self._root
        if dots:
            at = node._get_parent()
            for _ in dots[1:]:
                at = at and at._get_parent()
        for key in re.findall(r"[^.\[\]\s]+", path):
            at = self._followed(at)
            if at is not None and at._is_interpolation():
                return at
            if isinstance(at, ListConfig):
                at = at._get_node(int(key)) if key.isdigit() and int(key) < len(at) else None
            else:
                at = at._get_node(key) if isinstance(at, DictConfig) and key in _keys(at) else None
        return at

    def _followed(self, node: Node) -> Node:
        """The container that a node is or refers to; the last interpolation if not known."""
        visited: set[int] = set()
        while node is not None and node._is_interpolation() and id(node) not in visited:
            visited.add(id(node))
            found = _ANY_REFERENCE.fullmatch(str(node._value()))
            node = self._target(node, *found.groups()) if found else node
        if node is None or node._is_interpolation():
            return node
        return node if isinstance(node, Container) and not node._is_none() else None


def is_simple(override: Override) -> bool:
    """Return whether an override sets or adds a value that is the same in any configuration."""
    value = override.value()
    values = value if isinstance(value, list) else [value]
    return not override.is_delete() and all(
        item is None
        or isinstance(item, bool | int | float)
        or (isinstance(item, str) and "$" not in item and item != "???")
        for item in values
    )


def shape(values: Sequence[Override]) -> tuple[str, ...] | None:
    """Return what is equal in jobs that share a resolution; None if their order of values counts.

    That is the options of simple values, and the complete text of other overrides.
    """
    paths = sorted(_path(override) for override in values)
    nested = any(after[: len(before)] == before for before, after in pairwise(paths))
    compared = any(override.is_delete() and override.value() is not None for override in values)
    if nested or compared:
        return None
    return tuple(
        override.get_key_element() if is_simple(override) else f"={override.input_line}"
        for override in values
    )


def _path(override: Override) -> tuple[str, ...]:
    return tuple(override.key_or_group.split("."))


def _key(node: object, name: str) -> str | int:
    """Return the key of a node for its name in an override, where lists have numbers."""
    return int(name) if isinstance(node, ListConfig | list) and name.isdecimal() else name


class Resolution:
    """The resolved configuration of jobs of one shape; raises Refused if they cannot share it."""

    def __init__(self, task: DictConfig, values: Sequence[Override]) -> None:
        """Set the values of the first job in `task`, which is not used by others any more."""
        for override in values:
            _require_plain_path(task, override)
        apply(task, values)
        check_size(task)
        self._task = task
        self._plain: Any = OmegaConf.to_container(task, resolve=True, throw_on_missing=True)
        for override in filter(is_simple, values):
            _require_present(self._plain, override)
        self._texts = {override.key_or_group: override.input_line for override in values}
        found = interpolations(task)
        self._affected = {override.key_or_group: _affected(override, found) for override in values}

    def resolved(self, values: Sequence[Override]) -> dict[str, object]:
        """Return the configuration of a job; after an error the resolution must not be used."""
        changed = [item for item in values if self._texts[item.key_or_group] != item.input_line]
        for override in changed:
            set_value(self._task, override)
        for override in changed:
            node: Node = self._task
            path: Path = ()
            for part in _path(override):
                node = node._get_node(path[-1]) if path else node
                path = (*path, _key(node, part))
            self._plain = _with(self._plain, path, _plain(node, path[-1]))
            self._texts[override.key_or_group] = override.input_line
        for override in changed:
            for container, name, place in self._affected[override.key_or_group]:
                self._plain = _with(self._plain, place, _plain(container, name))
        return dict(self._plain)


def _require_plain_path(task: DictConfig, override: Override) -> None:
    """Raise Refused if what an override does may depend on interpolations."""
    node: Node = task
    for name in _path(override):
        if not isinstance(node, Container) or node._is_interpolation():
            raise Refused(override.input_line)
        if node._is_none() or node._is_missing():
            return
        key = _key(node, name)
        if isinstance(node, ListConfig) and (override.is_delete() or key not in range(len(node))):
            raise Refused(override.input_line)
        node = node._get_node(key)
        if node is None:
            return
    if (override.is_add() or override.is_delete()) and node._is_interpolation():
        raise Refused(override.input_line)


def _require_present(plain: Node, override: Override) -> None:
    """Raise Refused if the value of an override is not at its path, e.g. below a number as key."""
    for name in _path(override):
        key = _key(plain, name)
        if key not in (_keys(plain) if isinstance(plain, dict | list) else ()):
            raise Refused(override.input_line)
        plain = plain[key]


def _affected(
    override: Override, found: Sequence[tuple[Container, str | int, Path]]
) -> list[tuple[Container, str | int, Path]]:
    """Return the interpolations that depend on an option, directly or through others."""
    changed: list[tuple[str, ...]] = [_path(override)]
    affected: dict[Path, tuple[Container, str | int, Path]] = {}
    more = True
    while more:
        more = False
        for container, key, path in found:
            if path not in affected and _depends(text_of(container, key), changed):
                affected[path] = container, key, path
                changed.append(tuple(map(str, path)))
                more = True
    return list(affected.values())


def _depends(text: str, changed: Sequence[tuple[str, ...]]) -> bool:
    rest = _ENVIRONMENT.sub("", text)
    if "${" in _REFERENCE.sub("", rest):
        return True  # relative paths and resolvers may refer to anything
    paths = [tuple(match.split(".")) for match in _REFERENCE.findall(rest)]
    return any(path[: len(one)] == one[: len(path)] for path in paths for one in changed)


def _plain(container: Container, key: str | int) -> object:
    """Return the resolved value of a node."""
    node: Node = container._get_node(key, throw_on_missing_value=True)
    node = node._dereference_node()
    if isinstance(node, Container):
        return OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    return node._value()


def _with(node: Node, path: Path, value: object) -> Node:
    """Return a node with the value at a path; parts that do not differ are not copied."""
    if not path:
        return node if repr(node) == repr(value) else value
    before = node[path[0]]
    after = _with(before, path[1:], value)
    if after is before:
        return node
    copy = node.copy()
    copy[path[0]] = after
    return copy
