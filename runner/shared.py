"""Nodes that the configurations of many trials share, with what has been computed from them."""

from collections.abc import Callable, Hashable, Mapping
from typing import Any, TypeVar

T = TypeVar("T")


class Shared(dict[str, object]):
    """A node of a resolved configuration that is not changed any more."""

    def __init__(self, node: Mapping[str, object]) -> None:
        super().__init__(node)
        self.results: dict[Hashable, Any] = {}  # of `once`


def once(node: object, key: Hashable, compute: Callable[[], T]) -> T:
    """Return `compute()`; for a shared node the result is kept under `key`, errors are not."""
    if not isinstance(node, Shared):
        return compute()
    if key not in node.results:
        node.results[key] = compute()
    result: T = node.results[key]
    return result


class SharedNodes:
    """The shared nodes of a sweep: nodes of equal content become one."""

    KEPT = 1024  # largest number of nodes of one option; the oldest loses its results

    def __init__(self) -> None:
        self._last: dict[str, tuple[object, Shared]] = {}
        self._kept: dict[str, dict[str, Shared]] = {}

    def of(self, config: Mapping[str, object]) -> dict[str, object]:
        """Return a resolved configuration with shared nodes at its top level."""
        return {
            key: self._shared(key, node) if isinstance(node, dict) else node
            for key, node in config.items()
        }

    def _shared(self, key: str, node: dict[str, object]) -> Shared:
        last, shared = self._last.get(key, (None, None))
        if shared is None or last is not node:
            kept, content = self._kept.setdefault(key, {}), repr(node)  # 1 differs from 1.0
            shared = kept.pop(content) if content in kept else Shared(node)
            kept[content] = shared
            if len(kept) > self.KEPT:
                kept.pop(next(iter(kept))).results.clear()
            self._last[key] = node, shared
        return shared
