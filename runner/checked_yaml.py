"""Checks of YAML files before they are expanded.

Anchors make a file of a few lines as large as the memory. So the nodes that its aliases stand for
are counted in the events of the parser, which holds no copy of them.
"""

from pathlib import Path

import yaml

from seatrial.models.errors import ConfigurationError

LARGEST = 1_000_000  # bytes of a file
MOST_NODES = 100_000  # with those that aliases stand for
DEEPEST = 50  # nested levels

# libyaml is faster by an order of magnitude, where PyYAML is built with it.
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
BEGIN = (yaml.MappingStartEvent, yaml.SequenceStartEvent)
END = (yaml.MappingEndEvent, yaml.SequenceEndEvent)


def check_file(path: Path) -> None:
    """Raise ConfigurationError for a file that is too large, too deep, or no YAML.

    A file that does not exist is left to Hydra, which knows where it looked.
    """
    try:
        size = path.stat().st_size
        if size > LARGEST:
            raise ConfigurationError(f"{path}: got {size} bytes, expected at most {LARGEST}")
        data = path.read_bytes()
    except OSError:
        return
    try:
        check_text(data, str(path))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        reason = getattr(error, "problem", None) or " ".join(str(error).split())
        raise ConfigurationError(f"{path}{line}: {reason}, expected YAML") from error


def check_text(data: bytes, name: str) -> None:
    """Raise ConfigurationError for YAML text of too many nodes or levels; `name` is its file."""
    sizes: dict[str, int] = {}  # of anchored nodes
    open_nodes: list[tuple[str | None, int]] = []  # anchor, number of nodes before it
    count = 0
    for event in yaml.parse(data, Loader=LOADER):
        if isinstance(event, END):
            anchor, before = open_nodes.pop()
            if anchor is not None:
                sizes[anchor] = count - before
            continue
        if isinstance(event, yaml.AliasEvent):
            where = f"{name}, line {event.start_mark.line + 1}"
            if event.anchor in (anchor for anchor, _ in open_nodes):
                raise ConfigurationError(f"{where}: *{event.anchor} stands for a node around it")
            count += sizes.get(event.anchor, 1)
        elif isinstance(event, BEGIN):
            open_nodes.append((event.anchor, count))
            count += 1
        elif isinstance(event, yaml.ScalarEvent):
            count += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
        if count > MOST_NODES or len(open_nodes) > DEEPEST:
            what = f"{MOST_NODES} nodes" if count > MOST_NODES else f"{DEEPEST} levels"
            line = event.start_mark.line + 1
            raise ConfigurationError(f"{name}, line {line}: got more than {what}, with aliases")
