"""Compilation of the readable equations to machine code, cached on disk for every process.

numba's own cache watches the file of the compiled function only, so a caller of a changed
function would run stale. Here the cache folder is named by the content of every source file
under `models/`: any change begins an empty one. A lock lets one process compile while the
others, started at the same time, wait and then load.

The folder is `$SEATRIAL_CACHE`, else `$XDG_CACHE_HOME/seatrial`, else `~/.cache/seatrial`,
else (when none can be written) one in the system's temporary folder.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from filelock import FileLock, Timeout
from numba.core import config
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

numba_config: Any = config
F = TypeVar("F", bound=Callable[..., Any])
LOCK_TIMEOUT_S = 120.0
LEAN: Any = {"_nrt": False, "forceinline": True}  # options of a `lean_kernel`


@cache
def source_hash() -> str:
    """SHA-256 of every source file under `models/` (relative names and bytes), in hexadecimal."""
    root = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0")
        digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


@cache
def cache_folder() -> Path:
    """The folder that holds the machine code of exactly these sources."""
    homes = [os.environ.get("SEATRIAL_CACHE"), os.environ.get("XDG_CACHE_HOME")]
    candidates = [Path(homes[0])] if homes[0] else []
    candidates += [Path(homes[1]) / "seatrial"] if homes[1] else []
    candidates += [Path("~/.cache/seatrial").expanduser()]
    candidates += [Path(tempfile.gettempdir()) / f"seatrial-{os.getuid()}"]
    name = f"numba-{numba.__version__}-{source_hash()[:16]}"
    return next((c / name for c in candidates if _writable(c / name)), candidates[-1] / name)


class _SharedCache(FunctionCache):
    """numba's function cache, in which one process compiles and the others wait for it."""

    _lock: FileLock | None = None
    _waiting: set[tuple[str, Any]] = set()  # noqa: RUF012 - one set a process

    @classmethod
    def _acquire(cls) -> bool:
        if cls._lock is None:
            cls._lock = FileLock(str(cache_folder() / "compile.lock"))
        try:
            cls._lock.acquire(timeout=LOCK_TIMEOUT_S)
        except (Timeout, OSError):
            return False  # a process that died while holding it must not stop the others
        return True

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The machine code from disk; None when this process is to compile it, lock held."""
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None and self._acquire():
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is None:
                self._waiting.add((self._name, sig))
            else:
                self._release()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the machine code and let the next process go."""
        super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        if (self._name, sig) in self._waiting:
            self._waiting.discard((self._name, sig))
            self._release()

    @classmethod
    def _release(cls) -> None:
        if cls._lock is not None:
            cls._lock.release()


def kernel(function: F) -> F:
    """Compile `function` for arrays and numbers; `.py_func` stays the readable equation."""
    return _compile(function)


def lean_kernel(function: F) -> F:
    """The same for a function that makes no array: without reference counts, inlined.

    Counting references to the arrays of a parameter tuple costs five times the arithmetic of a
    vessel's right-hand side (310 ns against 48 ns measured).
    """
    return _compile(function, **LEAN)


def tuple_of(numba_type: Any) -> type:
    """The named tuple's class behind numba's type of it, in an `overload`."""
    found: type = numba_type.instance_class
    return found


def is_compiled(function: Callable[..., Any]) -> bool:
    """Whether a step is machine code; none is where numba is disabled."""
    return isinstance(function, Dispatcher)


def in_python(function: F) -> F:
    """The readable function behind a kernel; a function that is not compiled is itself."""
    return cast(F, function.py_func) if isinstance(function, Dispatcher) else function


def _compile(function: F, **options: bool) -> F:
    numba_config.CACHE_DIR = str(cache_folder())
    njit: Any = numba.njit
    compiled = njit(error_model="numpy", cache=True, **options)(function)
    compiled._cache = _SharedCache(function)  # type: ignore[no-untyped-call]
    return cast(F, compiled)
