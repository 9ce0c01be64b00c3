from collections.abc import Callable, MutableSequence
from typing import Protocol, TypeVar

_F = TypeVar("_F", bound=Callable[..., object])

class _Memory(Protocol):
    def __getitem__(self, at: int, /) -> int: ...
    def __setitem__(self, at: int, value: int, /) -> None: ...

ptr8 = _Memory
ptr16 = _Memory
ptr32 = _Memory

def words(n: int) -> MutableSequence[int]: ...
def const(value: int) -> int: ...
def copy(to: object, at: int, source: object, first: int, n: int) -> None: ...

class micropython:
    @staticmethod
    def viper(function: _F) -> _F: ...
