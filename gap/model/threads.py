"""Work shared among threads: numpy and the compiled kernels run outside Python's lock."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_MOST = 4
_here = threading.local()
_pools: list[ThreadPoolExecutor] = []


def cores() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def each(make: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """`make` of each item, in order; on several threads, but not from within one of them.

    `make` must not change anything that another call reads. The first error is raised.
    """
    listed = list(items)
    if len(listed) < 2 or cores() < 2 or getattr(_here, "busy", False):
        return [make(item) for item in listed]
    return list(_pool().map(make, listed))


def _pool() -> ThreadPoolExecutor:
    if not _pools:
        _pools.append(ThreadPoolExecutor(min(cores(), _MOST), "gap", _mark))
    return _pools[0]


def _mark() -> None:
    _here.busy = True


if hasattr(os, "register_at_fork"):
    # Threads do not survive a fork.
    os.register_at_fork(after_in_child=_pools.clear)
