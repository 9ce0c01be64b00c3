"""Decorators for compiled code, and a fingerprint that invalidates the compiler's cache."""

from __future__ import annotations

import zlib
from collections.abc import Callable, MutableSequence
from importlib import resources
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])
Slots = MutableSequence[float]
"""A state or parameter array in compiled code: float64, contiguous."""

# Functions below an entry point do not allocate, so they need no reference counting of arrays.
# With counting, views of rows took more than half of the time of a scene.
_LEAN: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

_ALWAYS = ("compiled.py", "constants.py", "physics")


def inlined(function: F) -> F:
    """Compile a small function into each place that uses it.

    A division by zero gives inf as in numpy, without a check at every division.
    """
    return cast(F, njit(forceinline=True, **_LEAN)(function))


def called(function: F) -> F:
    """Compile a large function once; inlining it everywhere would take seconds to compile."""
    return cast(F, njit(**_LEAN)(function))


def entry_point(signature: str) -> Callable[[F], F]:
    """Compile for one signature, once per installation: the machine code is cached on disk.

    The function must close over the result of `fingerprint`, see there.
    """

    def decorate(function: F) -> F:
        return cast(F, njit(signature, cache=True, error_model="numpy")(function))

    return decorate


def fingerprint(*more: str) -> int:
    """CRC of the source files of the compiled code.

    numba updates its cache when the file of the compiled function changes, but not when a called
    function in another file changes. Closure variables are part of the cache key, so an entry point
    that closes over this number is compiled again after a change of any of the files.

    Args:
        more: folders or files of `plant` in addition to the physics, such as "links/kernel.py".
    """
    crc = 0
    for name in (*_ALWAYS, *more):
        place = resources.files("plant").joinpath(*name.split("/"))
        files = [place] if place.is_file() else sorted(place.iterdir(), key=lambda f: f.name)
        for file in files:
            if file.name.endswith(".py"):
                crc = zlib.crc32(file.read_bytes(), crc)
    return crc
