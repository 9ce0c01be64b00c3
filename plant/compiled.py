"""Decorators for compiled code, and a fingerprint that invalidates the compiler's cache."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, MutableSequence
from contextlib import suppress
from importlib import resources
from importlib.metadata import entry_points
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

from numba import njit

from plant.inner import inner

F = TypeVar("F", bound=Callable[..., Any])
Slots = MutableSequence[float]
"""A state or parameter array in compiled code: float64, contiguous."""

# Functions below an entry point do not allocate, so they need no reference counting of arrays.
# With counting, views of rows took more than half of the time of a scene. Nor does C call them:
# what would let it costs a tenth of the time to compile.
_LEAN: dict[str, Any] = {
    "error_model": "numpy",
    "_nrt": False,
    "no_cfunc_wrapper": True,
}

_ALWAYS = ("compiled.py", "inner.py", "constants.py", "effects", "physics")


def inlined(function: F) -> F:
    """Compile a small function into each place that uses it.

    Plain functions of its module that it calls by name are compiled with it, so that a formula can
    stay plain Python for arrays. A division by zero gives inf as in numpy, without a check at every
    division.
    """
    return cast(F, inner(_with_callees(function), forceinline=True, **_LEAN))


def called(function: F) -> F:
    """Compile a large function once; repeating it at each place would cost seconds to compile."""
    return cast(F, inner(_with_callees(function), **_LEAN))


def _with_callees(function: F) -> F:
    """`function` bound to compiled versions of the plain functions that it calls."""
    own = function.__globals__
    named = {name: own.get(name) for name in function.__code__.co_names}
    plain = {name: inlined(f) for name, f in named.items() if isinstance(f, FunctionType)}
    if not plain:
        return function
    code, defaults = function.__code__, function.__defaults__
    bound = FunctionType(code, {**own, **plain}, function.__name__, defaults, function.__closure__)
    return cast(F, bound)


def entry_point(signature: str, threads: bool = False) -> Callable[[F], F]:
    """Compile for one signature, once per installation: the machine code is cached on disk.

    The function must close over the result of `fingerprint`, see there. With `threads` it runs
    outside Python's lock.
    """

    def decorate(function: F) -> F:
        return cast(F, njit(signature, cache=True, error_model="numpy", nogil=threads)(function))

    return decorate


def fingerprint(*more: str) -> int:
    """CRC of the source files of the compiled code.

    numba updates its cache when the file of the compiled function changes, but not when a called
    function in another file changes. Closure variables are part of the cache key, so an entry point
    that closes over this number is compiled again after a change of any of the files.

    Args:
        more: folders or files of `plant` beside physics and effects, such as "links/kernel.py".
    """
    crc = 0
    for name in (*_ALWAYS, *more):
        for file in _sources(resources.files("plant").joinpath(*name.split("/"))):
            crc = zlib.crc32(file.read_bytes(), crc)
    for text in _installed():
        crc = zlib.crc32(text, crc)
    return crc


def _installed() -> Iterator[bytes]:
    """Source of the modules in which installed packages bring effects."""
    for point in sorted(entry_points(group="pamrig.effects"), key=lambda point: point.name):
        with suppress(ImportError, OSError):  # the catalogue says what is wrong with it
            found = find_spec(point.module)
            if found is not None and found.origin is not None:
                yield Path(found.origin).read_bytes()


def _sources(place: Traversable) -> Iterator[Traversable]:
    if place.is_dir():
        for inner in sorted(place.iterdir(), key=lambda f: f.name):
            yield from _sources(inner)
    elif place.name.endswith(".py"):
        yield place
