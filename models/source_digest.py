"""Digests of the syntax trees of source files, without comments, docstrings and layout.

The folder of the machine code (`compiled.py`) and the fingerprint of a trial depend on these
digests. Parsing all files takes a second, so the digest of each file is cached on disk, with the
SHA-256 of the file as the key, beside the machine code.

The cache folder is the first of `$SEATRIAL_CACHE`, `$XDG_CACHE_HOME/seatrial` and
`~/.cache/seatrial` that can be written, or else a folder in the system's temporary folder.
"""

import ast
import hashlib
import importlib.util
import json
import os
import tempfile
import uuid
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import astuple, dataclass
from functools import cache, lru_cache
from pathlib import Path

MODELS_FOLDER = Path(__file__).parent
KEPT_FILE = "sources-2.json"  # increase the number when `_text` or `Source` changes
MOST_KEPT = 2000  # in the cache file; the oldest are dropped
TYPES_ONLY = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
_parsed: set[str] = set()  # keys that are not on disk yet


@dataclass(frozen=True)
class ParsedSource:
    """A Python file: the SHA-256 of its syntax tree, and the modules that it imports.

    `from a import b` counts as `a` and `a.b`, `lazy_loader.load("a.b")` as `a.b`; imports for type
    checking only are left out.
    """

    digest: str
    imports: tuple[str, ...]


def folder_digest(folder: Path) -> str:
    """SHA-256 of the relative names and syntax trees of all Python files under a folder."""
    return files_digest(folder, folder.rglob("*.py"))


def files_digest(root: Path, files: Iterable[Path]) -> str:
    """SHA-256 of the names relative to `root` and the syntax trees of some Python files."""
    rows = sorted((path.relative_to(root).as_posix(), source(path).digest) for path in files)
    _save()
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def imported_files(
    start: Path, folder: Path, package: str, left_out: Collection[str] = ()
) -> set[Path]:
    """The Python files of a package that a file imports, directly or indirectly, and itself.

    Args:
        start: the file to begin with.
        folder: the folder of the package.
        package: the dotted name of the package; empty for top-level modules in one folder.
        left_out: names of subpackages and modules, directly in the package, that are not followed.

    Returns:
        Paths of the files.
    """
    reached: set[Path] = set()
    pending = [start]
    while pending:
        path = pending.pop()
        if path in reached:
            continue
        reached.add(path)
        parts = path.relative_to(folder).with_suffix("").parts
        parent = ".".join([package, *parts[:-1]]).strip(".")
        prefix = f"{package}." if package else ""
        for name in source(path).imports:
            target = importlib.util.resolve_name(name, parent) if name.startswith(".") else name
            if target.startswith(prefix):
                names = target.removeprefix(prefix).split(".")
                for depth in range(1, len(names) + 1) if names[0] not in left_out else ():
                    place = folder.joinpath(*names[:depth])  # parent packages run as well
                    files = (place.with_suffix(".py"), place / "__init__.py")
                    pending += filter(Path.is_file, files)
    _save()
    return reached


def source(path: Path) -> ParsedSource:
    """Digest and imports of a Python file, read again when the file has changed."""
    stat = path.stat()
    return _source(path, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=4096)
def _source(path: Path, _changed_ns: int, _size: int) -> ParsedSource:
    content = path.read_bytes()
    key = hashlib.sha256(content).hexdigest()
    cached = _cached()
    if key not in cached:
        cached[key] = parse(content)
        _parsed.add(key)
    return cached[key]


def parse(content: bytes) -> ParsedSource:
    """Parse the content of a source file; raises SyntaxError if it is not Python."""
    tree = ast.parse(content)
    digest = hashlib.sha256(_text(tree).encode("utf-8", "surrogatepass")).hexdigest()
    return ParsedSource(digest, tuple(sorted(set(_imports(tree)))))


def _text(node: object) -> str:
    """A syntax tree without docstrings, as text that does not depend on the version of Python."""
    if isinstance(node, ast.AST):
        fields = ((name, getattr(node, name, None)) for name in node._fields)
        inside = (f"{k}={_text(v)}" for k, v in fields if v is not None and v != [])
        return f"{type(node).__name__}({','.join(inside)})"
    if isinstance(node, list):
        return f"[{','.join(_text(item) for item in node if not _is_docstring(item))}]"
    return repr(node)


def _is_docstring(node: object) -> bool:
    """Whether a node is a statement that consists of a string only."""
    return isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str)


def _imports(node: ast.AST) -> Iterator[str]:
    inner: Iterable[ast.AST] = ast.iter_child_nodes(node)
    match node:
        case ast.Import():
            yield from (alias.name for alias in node.names)
        case ast.ImportFrom():
            base = "." * node.level + (node.module or "")
            dot = "" if base.endswith(".") else "."
            yield from (base, *(f"{base}{dot}{alias.name}" for alias in node.names))
        case ast.If() if ast.unparse(node.test) in TYPES_ONLY:
            inner = node.orelse
        case ast.Call(
            func=ast.Attribute(value=ast.Name(id="lazy_loader"), attr="load"),
            args=[ast.Constant(value=str() as name)],
        ):
            yield name
    for child in inner:
        yield from _imports(child)


def cache_home() -> Path:
    """The cache folder: the first candidate that can be written, else the last one."""
    cache_folder, xdg_folder = os.environ.get("SEATRIAL_CACHE"), os.environ.get("XDG_CACHE_HOME")
    candidates = [Path(cache_folder)] if cache_folder else []
    candidates += [Path(xdg_folder) / "seatrial"] if xdg_folder else []
    candidates += [Path("~/.cache/seatrial").expanduser()]
    candidates += [Path(tempfile.gettempdir()) / f"seatrial-{os.getuid()}"]
    for folder in candidates:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder
    return candidates[-1]


def replace_file(path: Path, content: bytes) -> None:
    """Write a file that other processes see complete or not at all; raises OSError."""
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@cache
def _cached() -> dict[str, ParsedSource]:
    """Cached sources by the SHA-256 of their content; empty if the cache file is unreadable."""
    try:
        rows = json.loads((cache_home() / KEPT_FILE).read_bytes())
        return {
            key: ParsedSource(digest, tuple(imports)) for key, (digest, imports) in rows.items()
        }
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def _save() -> None:
    """Write newly parsed sources to the cache file; a failure to write is not an error."""
    if _parsed:
        _parsed.clear()
        rows = {key: astuple(value) for key, value in list(_cached().items())[-MOST_KEPT:]}
        with suppress(OSError):
            replace_file(cache_home() / KEPT_FILE, json.dumps(rows).encode())
