"""Compilation of the readable equations to machine code, cached on disk for every process.

numba's own cache looks at the file of the compiled function only, so the caller of a changed
function would use outdated machine code. Here the name of the cache folder depends on the syntax
trees of all source files under `models/`: a change of code starts an empty folder, a change of
comments does not. In the folder every kernel has a file for each signature. The name of the file
depends on the signature, so that processes that save at the same time never overwrite each other's
code with that of another signature.

Only what Python calls becomes machine code. A kernel that another kernel calls is linked into that
one as it was translated, and the whole is optimised once (`_Fragment`). numba itself would
optimise, compile and wrap every callee, although it is inlined into its callers. Because this
depends on undocumented parts of numba, its version is capped in `pyproject.toml`. Fragments are not
kept: another vessel or controller needs few of them again, since loops call its steps through an
address (`bound`).
"""

# mypy: disallow-untyped-calls=False
# (numba is typed in part only: contexts and what it has compiled are `Any`)
import hashlib
import json
import logging
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from time import perf_counter
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
from numba.core import config
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.environment import lookup_environment
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.core.types import BaseNamedTuple, BaseTuple, Type

from seatrial.models.source_digest import (
    MODELS_FOLDER,
    cache_home,
    folder_digest,
    replace_file,
    source,
)

numba_config: Any = config
# What LLVM does beyond its first level costs a quarter of the time of compiling, and brings the
# loop nothing: its vectors are those of `packs`.
if "NUMBA_OPT" not in os.environ:
    numba_config.OPT = type(numba_config.OPT)(1)
    numba_config.LOOP_VECTORIZE = 0
log = logging.getLogger(__name__)
Signature = tuple[Type, ...]  # types of the arguments
F = TypeVar("F", bound=Callable[..., object])
TIMES = "compilation-times.json"  # seconds that each kernel took last time, by its name
NOTED_S = 1.0  # kernels that took less are compiled without a message


@cache
def cache_folder() -> Path:
    """The folder that holds the machine code compiled from the current sources."""
    folder = cache_home() / _folder_name()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def _folder_name() -> str:
    return f"numba-{numba.__version__}-{folder_digest(MODELS_FOLDER)[:16]}"


class _Cache(NullCache):
    """The machine code of one kernel in the cache folder: a file for each signature."""

    def __init__(self, function: FunctionType, options: dict[str, bool]) -> None:
        self._function, self._options = function, options
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._started: dict[Signature, float] = {}

    def load_overload(self, sig: Signature, target_context: Any) -> Any:
        """The code from disk; None if this process has to compile it.

        numba's registries are not filled for it: that imports what only compiling needs.
        """
        rtsys.initialize(target_context)
        try:
            payload = pickle.loads(self._file(sig, target_context.codegen()).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            self._started[sig] = perf_counter()
            _announce(self._label(sig))
            return None
        return CompileResult._rebuild(target_context, *payload)

    def save_overload(self, sig: Signature, cres: Any) -> None:
        """Write the code, unless the sources have changed since the folder was named."""
        seconds = round(perf_counter() - self._started.pop(sig), 1)
        with suppress(OSError):  # a full disk only makes the next start slower
            if not cres.library.has_dynamic_globals and _folder_name() == cache_folder().name:
                replace_file(self._file(sig, cres.codegen), dumps(cres._reduce()))
                times = _times() | {self._label(sig): seconds}
                replace_file(cache_home() / TIMES, json.dumps(times).encode())

    def _label(self, sig: Signature) -> str:
        """The name of the kernel, and of the parameters in a tuple, see `bound`."""
        parts: Any = sig[-1:]
        while (
            parts and isinstance(parts, tuple | BaseTuple) and not isinstance(parts, BaseNamedTuple)
        ):
            parts = cast(Any, parts)[0]
        named = isinstance(parts, BaseNamedTuple) and parts not in sig
        return f"{self._name} of {tuple_of(parts).__name__}" if named else self._name

    def _file(self, sig: Signature, codegen: Any) -> Path:
        """The file of a signature; raises OSError for a function that is not in a file."""
        function, code = self._function, self._function.__code__
        cells = dumps([cell.cell_contents for cell in function.__closure__ or ()])
        file = Path(code.co_filename)
        name = self._name
        depends_on = (
            name, _outside(file) and (_outside(file), code.co_firstlineno), code.co_code, cells,
            sorted(self._options.items()), [*map(_text_of, sig)], codegen.magic_tuple(),
            sys.implementation.cache_tag,
        )  # fmt: skip
        digest = hashlib.sha256(repr(depends_on).encode()).hexdigest()
        name = name.replace("<", "").replace(">", "")
        return cache_folder() / f"{name}-{digest[:32]}.nbc"


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
    return "" if file.is_relative_to(MODELS_FOLDER) else f"{file} {source(file).digest}"


def _announce(name: str) -> None:
    """Log that a kernel is being compiled, and how long that took last time on this machine."""
    seconds = _times().get(name)
    if seconds is None or seconds >= NOTED_S:
        before = "first time on this machine" if seconds is None else f"{seconds:.0f} s last time"
        log.info("compiling %s (%s)", name.removeprefix(f"{__package__}."), before)


def _times() -> dict[str, float]:
    """Seconds that each kernel took last time; empty if the file is unreadable."""
    try:
        times = json.loads((cache_home() / TIMES).read_bytes())
    except (OSError, ValueError):
        return {}
    return times if isinstance(times, dict) else {}


class _Fragment(JITCodeLibrary):
    """A function that is called by a kernel: linked into it with its callees, not compiled alone.

    There is no machine code, so there is neither an address to call nor one for its environment.
    """

    def finalize(self) -> None:
        """Link the callees; the library that this one is linked into is optimised as a whole."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Zero, numba's sign of a function that cannot be called from Python."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> "_Fragment":
        """What sets the environment, which is this library."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Do nothing: `_OuterCompiler` sets the environments of everything it has linked."""


class _InnerCompiler(Compiler):
    """Compiles a function that is called by a kernel to a fragment."""

    def define_pipelines(self) -> Any:
        """numba's passes, without wrappers for calls from Python."""
        state = self.state
        state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = True
        state.library = _Fragment(state.targetctx.codegen(), "fragment")
        return super().define_pipelines()


class _OuterCompiler(Compiler):
    """Compiles a function that is called from Python, together with its fragments."""

    def compile_extra(self, func: FunctionType) -> Any:
        """Compile to machine code and set the environments of the linked functions."""
        result = super().compile_extra(func)
        for variable in result.library._final_module.global_variables:
            if environment := lookup_environment(variable.name):
                result.library.codegen.set_env(variable.name, environment)
        return result


class _Kernel(CPUDispatcher):
    """A function that is compiled as a whole when Python calls it, to a fragment for a kernel."""

    def __init__(
        self, py_func: Callable[..., object], locals: Any = None, targetoptions: Any = None,
        pipeline_class: type[Compiler] = _OuterCompiler,
    ) -> None:  # fmt: skip
        super().__init__(py_func, locals, targetoptions, pipeline_class)
        self._inner = CPUDispatcher(py_func, locals, targetoptions, _InnerCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile for a call by another kernel; asked for by numba while it types that one."""
        return self._inner.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        """Return what is called by another kernel, when numba translates the call."""
        return self._inner.get_overload(sig)


# options of an `overload` or `register_jitable`: what they make is called by kernels only
INNER: Any = {"pipeline_class": _InnerCompiler}
LEAN: Any = INNER | {"_nrt": False, "forceinline": True}  # as a `lean_kernel`


def kernel(function: F, **options: bool) -> F:
    """Compile `function` for arrays and numbers; `.py_func` stays the readable equation."""
    if numba_config.DISABLE_JIT:
        return function
    cache_folder()  # named now: the sources may change before the function is compiled
    targetoptions = {"nopython": True, "error_model": "numpy", "boundscheck": None, **options}
    compiled: Any = _Kernel(function, targetoptions=targetoptions)
    compiled._cache = _Cache(cast(FunctionType, function), options)
    return cast(F, compiled)


def lean_kernel(function: F) -> F:
    """Compile a function that allocates no array, inlined and without reference counting.

    Reference counting for the arrays of a parameter tuple takes five times as long as the
    arithmetic of a vessel's right-hand side (310 ns against 48 ns measured).
    """
    return kernel(function, _nrt=False, forceinline=True)


def tuple_of(numba_type: object) -> type:
    """The named-tuple class of a numba type, for use in an `overload`."""
    assert isinstance(numba_type, BaseNamedTuple)
    return cast(Any, numba_type).instance_class  # type: ignore[no-any-return]


def is_compiled(function: Callable[..., object]) -> bool:
    """Whether a step is machine code; always False when numba is disabled."""
    return isinstance(function, Dispatcher)


def in_python(function: F) -> F:
    """The Python function behind a kernel; a function that is not compiled is returned as it is."""
    return cast(F, function.py_func) if isinstance(function, Dispatcher) else function
