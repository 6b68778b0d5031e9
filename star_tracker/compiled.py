"""How the per-frame path is compiled: numba, with a cache on disk that follows the sources.

numba's own cache notices a change of the file that a function stands in, not of the functions
that it calls in other files: an upgrade could go on running the old machine code. So the cache
lies in a folder named after the sources of all compiled folders (`resources.COMPILED_ROOMS`), and
a changed source means a new folder. It is made below NUMBA_CACHE_DIR, or else in the package's
cache folder (`resources.py`). Where it cannot be written, each process compiles for itself, unless
all is there: a folder that was filled ahead (`star_tracker compile`) serves from a medium that is
read only.
"""

import atexit
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from llvmlite.binding import get_host_cpu_name
from numba.core import config as numba_config
from numba.core import types
from numba.experimental import structref
from numba.extending import intrinsic

from star_tracker.resources import cache_folder, place_digest, sources_digest

#: No exceptions for divisions by zero: what is divided by is checked where it can be zero. Nobody
#: calls the functions from C: without that wrapper they compile faster.
_OPTIONS = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def compiled(function: Callable[..., Any]) -> Any:
    """Return a function compiled at its first call for the types that it is called with.

    Its arguments are arrays, numbers and named tuples of them. The global interpreter lock is
    released while it runs.
    """
    return _compile(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Return a compiled function that becomes a part of each compiled function that calls it.

    For small ones that are called for each star: handing over arrays takes longer than their work.
    """
    return _compile(function, forceinline=True)


def _compile(function: Callable[..., Any], **more: bool) -> Any:
    options: dict[str, Any] = {**_OPTIONS, **more}
    njit: Any = numba.njit
    folder = _cache_folder()
    if folder is None:
        return njit(**options)(function)
    # numba settles where a function is cached when it is decorated.
    config: Any = numba_config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
    try:
        return njit(cache=True, **options)(function)
    finally:
        config.CACHE_DIR = before


def machine_code(function: Any, *like: Any) -> Callable[..., Any]:
    """Return a compiled function for arguments of the very types of these, compiled now.

    It does not look at types any more, which takes longer than a short function: who calls it has
    to hand over what has them.
    """
    kinds = tuple(numba.typeof(one) for one in like)
    there = function.overloads.get(kinds)  # no lock is taken for what this process has already
    code: Callable[..., Any] = there.entry_point if there else function.compile(kinds)
    return code


@dataclass(frozen=True)
class CacheState:
    """The cache of compiled code.

    Attributes:
        folder: where it lies or should lie; None for a user without a home.
        writable: whether compiled code can be kept there.
        warm: whether all code is there, so that a process starts without compiling.
    """

    folder: Path | None
    writable: bool
    warm: bool


def cache_state() -> CacheState:
    """Return where compiled code is kept, whether it can be, and whether it is there."""
    folder = _named_folder()
    if folder is None:
        return CacheState(None, writable=False, warm=False)
    return CacheState(folder, _cache_folder() == folder, (folder / _mark()).exists())


def mark_warm() -> None:
    """Note that this process has compiled all code, or has found it in the cache."""
    folder = _cache_folder()
    if folder is not None:
        with suppress(OSError):  # a disk that is full by now: the next start says that it compiles
            (folder / _mark()).touch()


def _mark() -> str:
    """Name what machine code depends on besides the sources, and whose it is.

    numba keeps that of each copy of the sources apart: a checkout's and an installed package's.
    """
    made_by = f"{sys.implementation.cache_tag}-{numba.__version__}-{get_host_cpu_name()}"
    return f"all-{made_by}-{place_digest()}"


def _named_folder() -> Path | None:
    """Return the folder of the compiled code of exactly these sources, None without a home."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(named) / "star_tracker" if named else cache_folder()
    return None if base is None else base / f"compiled-{sources_digest()}"


@cache
def _cache_folder() -> Path | None:
    """Return the folder that numba is given, None if there is none that can be written."""
    folder = _named_folder()
    if folder is None:
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f"probe-{os.getpid()}"
        probe.write_bytes(bytes(1 << 20))  # a full disk is found out here, not while saving
        probe.unlink()
    except OSError:
        return _linked(folder) if (folder / _mark()).exists() else None
    return folder


def _linked(folder: Path) -> Path | None:
    """Return a folder of this process's own with links to one that cannot be written."""
    try:
        own = Path(tempfile.mkdtemp(prefix="star_tracker-"))
    except OSError:
        return None
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    for path in folder.resolve().glob("*/*"):
        place = own / path.parent.name
        place.mkdir(exist_ok=True)
        (place / path.name).symlink_to(path)
    return own


def struct(name: str, module: str, fields: tuple[str, ...]) -> tuple[Any, Any]:
    """Return (type, constructor) of a struct for compiled code: named fields behind one pointer.

    It is made by calling the constructor in a compiled function: in Python it would be compiled in
    each process. Both must be assigned at the top of `module` as `<name>Type` and `<name>`, as the
    cache looks them up there. Python hands a struct over, and keeps the arrays that it reads: a
    field read by name compiles a function for it first, which is for tests and debugging.
    """

    def widened(_: Any, typed: Any) -> Any:
        return tuple((field, types.unliteral(kind)) for field, kind in typed)

    def named(self: Any, typed: Any) -> None:
        types.StructRef.__init__(self, typed)
        # Its own name spells all fields out, and stands in that of each function that it is handed
        # to: the path had a megabyte of names for 130 kB of code.
        self.name = f"{module}.{name}-{sha256(self.name.encode()).hexdigest()[:16]}"

    kind = type(f"{name}Type", (types.StructRef,), {
        "__module__": module, "__init__": named, "preprocess_fields": widened,
    })
    readers: dict[str, Any] = {field: property(_reader(field)) for field in fields}
    proxy = type(name, (structref.StructRefProxy,), {"__module__": module, **readers})
    structref.define_proxy(proxy, structref.register(kind), list(fields))
    return kind, proxy


def _reader(field: str) -> Callable[[Any], Any]:
    """Return a function that reads a field of a struct in Python."""

    @numba.njit
    def read(one: Any) -> Any:
        return getattr(one, field)

    return read


#: POSIX: writes seconds and nanoseconds of a clock.
_clock_gettime: Any = types.ExternalFunction(
    "clock_gettime", types.int32(types.int32, types.voidptr)
)
_CLOCK = time.CLOCK_MONOTONIC


@compiled
def clock_s() -> float:
    """Return `time.monotonic`, for compiled code that has to end in time."""
    now = np.empty(2, np.int64)
    _clock_gettime(_CLOCK, now.ctypes)
    return now[0] + 1e-9 * now[1]


def _fetched_ahead(typing: Any, array: Any, at: Any) -> Any:
    """Have the element `at` of an array, counted in C order, fetched into the caches.

    For compiled code alone. The tables' part for a frame's place in the sky has mostly left the
    caches since the last frame: what is asked for at once waits for the memory together, and not
    one read after the other. A place outside of the array does no harm.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind_of_array, kind_of_place = signature.args
        start = context.make_array(kind_of_array)(context, builder, args[0]).data
        place = builder.gep(start, [context.cast(builder, args[1], kind_of_place, types.intp)])
        place = builder.bitcast(place, ir.PointerType(ir.IntType(8)))
        number = ir.IntType(32)
        fetch = builder.module.declare_intrinsic(
            "llvm.prefetch", [place.type],
            ir.FunctionType(ir.VoidType(), [place.type, number, number, number]),
        )
        # To read it, soon and more than once, as data.
        builder.call(fetch, [place, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.none(array, at), generate


#: `prefetch(array, at)`; see `_fetched_ahead`.
prefetch: Any = intrinsic(_fetched_ahead)


@compiled
def first_not_below(values: Any, begin: int, end: int, low: float) -> int:
    """Return the first place in ascending values[begin:end] that is not below `low`."""
    while begin < end:
        middle = (begin + end) // 2
        if values[middle] < low:
            begin = middle + 1
        else:
            end = middle
    return begin
