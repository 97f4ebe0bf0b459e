"""Compilation of the readable equations to machine code, cached on disk for every process.

numba's own cache looks at the file of the compiled function only, so the caller of a changed
function would use outdated machine code. Here the name of the cache folder depends on the syntax
trees of all source files under `models/`: a change of code starts an empty folder, a change of
comments does not. In the folder every kernel has a file for each signature. The name of the file
depends on the signature, so that processes that save at the same time never overwrite each other's
code with that of another signature.
"""

# mypy: disallow-untyped-calls=False
# (numba is typed in part only: contexts and what it has compiled are `Any`)
import hashlib
import logging
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
from numba.core import config
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps
from numba.core.types import BaseNamedTuple, BaseTuple, NamedTuple, NamedUniTuple, Type

from seatrial.models.source_digest import MODELS, cache_home, folder_digest, replace_file, source

numba_config: Any = config
log = logging.getLogger(__name__)
Signature = tuple[Type, ...]  # types of the arguments
F = TypeVar("F", bound=Callable[..., object])
LEAN: Any = {"_nrt": False, "forceinline": True}  # options of a `lean_kernel`


@cache
def cache_folder() -> Path:
    """The folder that holds the machine code compiled from the current sources."""
    folder = cache_home() / _folder_name()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def _folder_name() -> str:
    return f"numba-{numba.__version__}-{folder_digest(MODELS)[:16]}"


class _Cache(NullCache):
    """The machine code of one kernel in the cache folder: a file for each signature."""

    def __init__(self, function: FunctionType, options: dict[str, bool]) -> None:
        self._function, self._options = function, options

    def load_overload(self, sig: Signature, target_context: Any) -> Any:
        """The machine code from disk; None if this process has to compile it."""
        target_context.refresh()
        try:
            payload = pickle.loads(self._file(sig, target_context.codegen()).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            _announce()
            return None
        return CompileResult._rebuild(target_context, *payload)

    def save_overload(self, sig: Signature, cres: Any) -> None:
        """Write the machine code, unless the sources have changed since the folder was named."""
        with suppress(OSError):  # a full disk only makes the next start slower
            if not cres.library.has_dynamic_globals and _folder_name() == cache_folder().name:
                replace_file(self._file(sig, cres.codegen), dumps(cres._reduce()))

    def _file(self, sig: Signature, codegen: Any) -> Path:
        """The file of a signature; raises OSError for a function that is not in a file."""
        function, code = self._function, self._function.__code__
        cells = dumps([cell.cell_contents for cell in function.__closure__ or ()])
        file = Path(code.co_filename)
        name = f"{function.__module__}.{function.__qualname__}"
        depends_on = (
            name, _outside(file) and (_outside(file), code.co_firstlineno), code.co_code, cells,
            sorted(self._options.items()), [*map(_text_of, sig)], codegen.magic_tuple(),
            sys.implementation.cache_tag,
        )  # fmt: skip
        digest = hashlib.sha256(repr(depends_on).encode()).hexdigest()
        return cache_folder() / f"{name.replace('<', '').replace('>', '')}-{digest[:32]}.nbc"


def _text_of(kind: Type) -> str:
    """A numba type as text, with the classes of named tuples and the digests of their files."""
    if not isinstance(kind, BaseTuple):
        return str(kind)
    members: Any = kind
    named = ""
    if isinstance(kind, BaseNamedTuple):
        cls = tuple_of(kind)
        file = getattr(sys.modules.get(cls.__module__), "__file__", None)
        named = f"{cls.__module__}.{cls.__qualname__} {_outside(Path(file)) if file else ''}"
    return f"{named}({', '.join(map(_text_of, members))})"


def _outside(file: Path) -> str:
    """A file outside of `models/` and its digest; empty for one of `models/`."""
    return "" if file.is_relative_to(MODELS) else f"{file} {source(file).digest}"


@cache
def _announce() -> None:
    """Log, once per process, that kernels are being compiled."""
    log.info("compiling (first run on this machine)")


def kernel(function: F, **options: bool) -> F:
    """Compile `function` for arrays and numbers; `.py_func` stays the readable equation."""
    if numba_config.DISABLE_JIT:
        return function
    cache_folder()  # named now: the sources may change before the function is compiled
    targetoptions = {"nopython": True, "error_model": "numpy", "boundscheck": None, **options}
    compiled: Any = CPUDispatcher(function, targetoptions=targetoptions)
    compiled._cache = _Cache(cast(FunctionType, function), options)
    return cast(F, compiled)


def lean_kernel(function: F) -> F:
    """Compile a function that allocates no array, inlined and without reference counting.

    Reference counting for the arrays of a parameter tuple takes five times as long as the
    arithmetic of a vessel's right-hand side (310 ns against 48 ns measured).
    """
    return kernel(function, **LEAN)


def tuple_of(numba_type: object) -> type:
    """The named-tuple class of a numba type, for use in an `overload`."""
    assert isinstance(numba_type, NamedTuple | NamedUniTuple)
    tuple_class: type = numba_type.instance_class
    return tuple_class


def is_compiled(function: Callable[..., object]) -> bool:
    """Whether a step is machine code; always False when numba is disabled."""
    return isinstance(function, Dispatcher)


def in_python(function: F) -> F:
    """The Python function behind a kernel; a function that is not compiled is returned as it is."""
    return cast(F, function.py_func) if isinstance(function, Dispatcher) else function
