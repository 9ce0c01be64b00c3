"""Compile a kernel with numba, keeping its type for the checker."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """The kernel as machine code, cached on disk."""
    return cast(Kernel, numba.njit(cache=True)(kernel))
