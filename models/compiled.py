"""Compilation of the readable equations to machine code, cached on disk for every process.

numba's own cache checks the file of the compiled function only, so the caller of a changed
function would use outdated machine code. Here the name of the cache folder depends on the syntax
trees of all source files under `models/`: a change of code starts an empty folder, a change of
comments does not.
"""

# mypy: disallow-untyped-calls=False
# (numba's caching is typed in part only)
import hashlib
import logging
import pickle
import sys
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, TypeVar, cast

import numba
from numba.core import config
from numba.core.base import BaseContext
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,
)
from numba.core.codegen import Codegen
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.types import BaseNamedTuple, BaseTuple, NamedTuple, NamedUniTuple, Type
from numba.core.typing.templates import Signature as TypingSignature

from seatrial.models.compile_lock import CompileLock
from seatrial.models.source_digest import MODELS, cache_home, folder_digest, source

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


class _Files(IndexDataCacheFile):
    """numba's cache files of one kernel: an index, and one file of machine code per signature.

    numba numbers these files, so two processes that save at the same time can use one number for
    two signatures. Here every name is unique, and the index lists a file only once it is complete.
    """

    def save(self, key: object, data: object) -> None:
        name = self._data_name(uuid.uuid4().int)
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})

    def _load_index(self) -> dict[object, str]:
        try:
            index: dict[object, str] = super()._load_index()
            return index
        except (EOFError, pickle.UnpicklingError, ImportError, AttributeError):
            return {}


class _Locator(_CacheLocator):
    """Where numba caches a function, and how it detects that the source has changed."""

    def __init__(self, function: FunctionType) -> None:
        self._function = function
        self._py_file = function.__code__.co_filename

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> "_Locator":
        return cls(py_func)

    def get_cache_path(self) -> str:
        return str(cache_folder())

    def get_source_stamp(self) -> str:
        """Digest of the function's file, which may have changed since the folder was named."""
        return source(Path(self._py_file)).digest

    def get_disambiguator(self) -> str:
        """Key that separates functions of one name by their code, and outside `models/` by file."""
        outside = "" if Path(self._py_file).is_relative_to(MODELS) else self._py_file
        parts = (self._function.__module__, outside, *_code_of(self._function))
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def _code_of(function: FunctionType) -> tuple[object, ...]:
    """The code of a function without its docstring and its position in the file."""
    constants = function.__code__.co_consts
    return _content(function.__code__, constants[1:] if function.__doc__ else constants)


def _content(code: CodeType, constants: tuple[object, ...]) -> tuple[object, ...]:
    return code.co_code, code.co_names, code.co_varnames, *map(_constant, constants)


def _constant(value: object) -> object:
    """A constant in a form whose text is the same in every process."""
    if isinstance(value, CodeType):
        return _content(value, value.co_consts)
    return sorted(map(repr, value)) if isinstance(value, frozenset) else value


class _Storage(CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [_Locator]  # noqa: RUF012 - read by numba


class _Cache(FunctionCache):
    """numba's function cache in the shared folder, with a lock."""

    _impl_class = _Storage

    def __init__(self, function: FunctionType, options: Mapping[str, bool]) -> None:
        super().__init__(function)
        self._options = tuple(sorted(options.items()))
        name = self._impl.filename_base
        self._choose_files(())
        kernel = f"{function.__module__}.{function.__qualname__}"
        self.lock = CompileLock(cache_folder() / f"{name}.lock", kernel)

    def _index_key(self, sig: Signature, codegen: Codegen) -> tuple[object, ...]:
        return (*super()._index_key(sig, codegen), self._options)

    def _choose_files(self, sig: Signature) -> None:
        """Files of their own for a signature with types of modules outside `models/`.

        The index holds the types of its signatures: a program without these modules could not
        read it.
        """
        files = sorted({file for kind in sig for file in _outside(kind)})
        stamp = self._impl.locator.get_source_stamp()
        name = self._impl.filename_base
        if files:
            parts = [(str(file), source(file).digest) for file in files]
            name += f".{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"
        self._cache_file = _Files(self._cache_path, name, stamp)

    def load_overload(self, sig: Signature, target_context: BaseContext) -> CompileResult | None:
        """The machine code from disk; None if this process has to compile it."""
        self._choose_files(sig)
        result: CompileResult | None = super().load_overload(sig, target_context)
        if result is None:
            self.lock.acquire()
            result = super().load_overload(sig, target_context)
            if result is None:
                _announce()
        return result

    def save_overload(self, sig: Signature, data: CompileResult) -> None:
        """Write the machine code, unless the sources have changed since the folder was named."""
        with suppress(OSError):  # a full disk only makes the next start slower
            if _folder_name() == cache_folder().name:
                self._choose_files(sig)
                super().save_overload(sig, data)


def _outside(kind: Type) -> Iterator[Path]:
    """The files of the modules outside `models/` that define the named tuples of a type."""
    if isinstance(kind, BaseNamedTuple):
        file = getattr(sys.modules.get(tuple_of(kind).__module__), "__file__", None)
        if file is not None and not Path(file).is_relative_to(MODELS):
            yield Path(file)
    if isinstance(kind, BaseTuple):
        members: Any = kind
        for member in members:
            yield from _outside(member)


@cache
def _announce() -> None:
    """Log, once per process, that kernels are being compiled."""
    log.info("compiling (first run on this machine)")


class _Kernel(CPUDispatcher):
    """numba's dispatcher, which releases the lock also when a compilation fails."""

    _cache: _Cache

    def compile(self, sig: str | Signature | TypingSignature) -> Callable[..., object]:
        with global_compiler_lock, self._cache.lock.scope():
            return super().compile(sig)


def kernel(function: F) -> F:
    """Compile `function` for arrays and numbers; `.py_func` stays the readable equation."""
    return _compile(function)


def lean_kernel(function: F) -> F:
    """Compile a function that allocates no array, inlined and without reference counting.

    Reference counting for the arrays of a parameter tuple takes five times as long as the
    arithmetic of a vessel's right-hand side (310 ns against 48 ns measured).
    """
    return _compile(function, **LEAN)


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


def _compile(function: F, **options: bool) -> F:
    if numba_config.DISABLE_JIT:
        return function
    targetoptions = {"nopython": True, "error_model": "numpy", "boundscheck": None, **options}
    compiled = _Kernel(function, targetoptions=targetoptions)
    compiled._cache = _Cache(cast(FunctionType, function), options)
    return cast(F, compiled)
