"""Digests of source files by what they compute: comments, docstrings and layout are left out.

The folder of the machine code (`compiled.py`) and the fingerprint of a trial are both made from
these. Parsing every file takes a second, so what was read of a file is kept on disk, by the
SHA-256 of its bytes, beside the machine code.

The folder on disk is `$SEATRIAL_CACHE`, else `$XDG_CACHE_HOME/seatrial`, else
`~/.cache/seatrial`, else (when none can be written) one in the system's temporary folder.
"""

import ast
import hashlib
import importlib.util
import json
import os
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import astuple, dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

MODELS = Path(__file__).parent
KEPT_FILE = "sources-1.json"  # a new number when `_text` or `Source` changes
MOST_KEPT = 2000  # sources; the oldest are forgotten
TYPES_ONLY = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
_parsed: set[str] = set()  # keys of what is not on disk yet


@dataclass(frozen=True)
class Source:
    """One file of Python: the SHA-256 of its syntax tree, and the modules that it imports.

    `from a import b` counts as `a` and `a.b`; imports for type checking alone are left out.
    """

    digest: str
    imports: tuple[str, ...]


def folder_digest(folder: Path) -> str:
    """SHA-256 of the relative names and syntax trees of all Python files under a folder."""
    return files_digest(folder, folder.rglob("*.py"))


def files_digest(root: Path, files: Iterable[Path]) -> str:
    """SHA-256 of the names relative to `root` and the syntax trees of some Python files."""
    rows = sorted((path.relative_to(root).as_posix(), source(path).digest) for path in files)
    _keep()
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def imported_files(
    start: Path, folder: Path, package: str, left_out: Collection[str] = ()
) -> set[Path]:
    """The Python files of a package that one of them runs with: itself and what it imports.

    Args:
        start: the file to begin at.
        folder: the folder of the package.
        package: its dotted name, as imports say it; empty for modules beside each other.
        left_out: names of subpackages and modules, directly in the package, not to follow.
    """
    reached: set[Path] = set()
    waiting = [start]
    while waiting:
        path = waiting.pop()
        if path in reached:
            continue
        reached.add(path)
        parts = path.relative_to(folder).with_suffix("").parts
        within = ".".join([package, *parts[:-1]]).strip(".")
        prefix = f"{package}." if package else ""
        for name in source(path).imports:
            full = importlib.util.resolve_name(name, within) if name.startswith(".") else name
            if full.startswith(prefix):
                inside = full.removeprefix(prefix).split(".")
                if inside[0] not in left_out:
                    waiting += _files_of(folder, inside)
    _keep()
    return reached


def _files_of(folder: Path, parts: list[str]) -> Iterator[Path]:
    """The files that run when a module of a package is imported, its parents' included."""
    for depth, _ in enumerate(parts, 1):
        place = folder.joinpath(*parts[:depth])
        yield from filter(Path.is_file, (place.with_suffix(".py"), place / "__init__.py"))


def source(path: Path) -> Source:
    """What a file of Python computes, read again when the file has changed."""
    stat = path.stat()
    return _source(path, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=4096)
def _source(path: Path, _changed_ns: int, _size: int) -> Source:
    content = path.read_bytes()
    key = hashlib.sha256(content).hexdigest()
    known = _known()
    if key not in known:
        known[key] = parse(content)
        _parsed.add(key)
    return known[key]


def parse(content: bytes) -> Source:
    """Read a source file; SyntaxError where it is no Python."""
    tree = ast.parse(content)
    digest = hashlib.sha256(_text(tree).encode("utf-8", "surrogatepass")).hexdigest()
    return Source(digest, tuple(sorted(set(_imports(tree)))))


def _text(node: Any) -> str:
    """A syntax tree as text, the same for every version of Python that has the syntax."""
    if isinstance(node, ast.AST):
        fields = ((name, getattr(node, name, None)) for name in node._fields)
        inside = (f"{k}={_text(v)}" for k, v in fields if v is not None and v != [])
        return f"{type(node).__name__}({','.join(inside)})"
    if isinstance(node, list):
        return f"[{','.join(_text(item) for item in node if not _is_docstring(item))}]"
    return repr(node)


def _is_docstring(node: Any) -> bool:
    """Whether a node is a string that stands alone as a statement."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _imports(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = "." * node.level + (node.module or "")
        yield base
        dot = "" if base.endswith(".") else "."
        yield from (f"{base}{dot}{alias.name}" for alias in node.names)
    elif isinstance(node, ast.If) and ast.unparse(node.test) in TYPES_ONLY:
        for inner in node.orelse:
            yield from _imports(inner)
    else:
        for child in ast.iter_child_nodes(node):
            yield from _imports(child)


def cache_home() -> Path:
    """The folder for what can be made again; the last resort where none can be written."""
    cache_folder, xdg_folder = os.environ.get("SEATRIAL_CACHE"), os.environ.get("XDG_CACHE_HOME")
    candidates = [Path(cache_folder)] if cache_folder else []
    candidates += [Path(xdg_folder) / "seatrial"] if xdg_folder else []
    candidates += [Path("~/.cache/seatrial").expanduser()]
    candidates += [Path(tempfile.gettempdir()) / f"seatrial-{os.getuid()}"]
    return next(filter(_writable, candidates), candidates[-1])


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


@cache
def _known() -> dict[str, Source]:
    """What was read of sources before, by the SHA-256 of their bytes; empty where unreadable."""
    try:
        rows = json.loads((cache_home() / KEPT_FILE).read_bytes())
        return {key: Source(digest, tuple(imports)) for key, (digest, imports) in rows.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def _keep() -> None:
    """Write what was parsed since the last time; a disk that takes nothing is no error."""
    if not _parsed:
        return
    _parsed.clear()
    rows = {key: astuple(value) for key, value in list(_known().items())[-MOST_KEPT:]}
    temporary = cache_home() / f"{KEPT_FILE}.{os.getpid()}"
    with suppress(OSError):
        temporary.write_text(json.dumps(rows))
        temporary.replace(cache_home() / KEPT_FILE)
