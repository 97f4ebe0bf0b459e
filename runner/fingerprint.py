"""What makes two trials the same: their configuration, and the sources of the models."""

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

MODELS = Path(__file__).resolve().parent.parent / "models"
# Where results go and how a trial is started do not change what it computes.
NOT_COMPARED = frozenset({"results_dir", "database", "rerun", "dry_run"})
EXACT_INTEGERS = 2**53  # up to here a float holds every integer


def fingerprint(config: Mapping[str, Any], names: Mapping[str, str], sources: str) -> str:
    """SHA-256 of a resolved configuration, its chosen options' names and a digest of sources.

    The order of keys does not matter, nor whether a whole number is written 1 or 1.0.
    """
    compared = {key: value for key, value in config.items() if key not in NOT_COMPARED}
    compared["excitation"] = _by_content(compared.get("excitation"), "path")
    disturbance = compared.get("disturbance")
    if isinstance(disturbance, Mapping) and "wind" in disturbance:
        compared["disturbance"] = {**disturbance, "wind": _by_content(disturbance["wind"], "file")}
    chosen = {group: name for group, name in names.items() if group not in NOT_COMPARED}
    content = {"config": compared, "names": chosen, "sources": sources}
    return hashlib.sha256(canonical(content).encode()).hexdigest()


def _by_content(node: Any, key: str) -> Any:
    """A measured file stands for what is in it, not for where it lies."""
    path = node.get(key) if isinstance(node, Mapping) else None
    if not isinstance(path, str) or not Path(path).is_file():
        return node
    stat = Path(path).stat()
    return {**node, key: _file_digest(path, stat.st_mtime_ns, stat.st_size)}


@lru_cache(maxsize=16)
def _file_digest(path: str, _changed_ns: int, _size: int) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def canonical(value: Any) -> str:
    """One text for equal values, as JSON; ValueError for NaN and infinity."""
    return json.dumps(
        _plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    )


def source_digest(folder: Path = MODELS) -> str:
    """SHA-256 of the names and bytes of all sources under a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py"), key=lambda path: path.relative_to(folder).as_posix()):
        content = path.read_bytes()
        name = path.relative_to(folder).as_posix().encode()
        digest.update(b"%d %s %d " % (len(name), name, len(content)) + content)
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) <= EXACT_INTEGERS:
        return int(value)
    return value
