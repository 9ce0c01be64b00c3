"""How far a long computation is: functions deep inside report, who started it may listen."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol, TypeVar

T_co = TypeVar("T_co", covariant=True)
T = TypeVar("T")

Listener = Callable[[str], None]
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


class _Counted(Iterable[T_co], Sized, Protocol[T_co]):
    """Items whose number is known."""


@contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Give `listener` every stage that is reported inside; others hear nothing of it."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def stage(text: str) -> None:
    """Report what begins now. Without a listener it costs nothing."""
    listener = _listener.get()
    if listener is not None:
        listener(text)


def counted(text: str, items: _Counted[T]) -> Iterator[T]:
    """The items, each reported by its number."""
    for number, item in enumerate(items, 1):
        stage(f"{text} {number} of {len(items)}")
        yield item
