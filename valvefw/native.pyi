from collections.abc import Callable, MutableSequence
from typing import TypeVar

_F = TypeVar("_F", bound=Callable[..., object])

class _Memory:
    def __new__(cls, memory: object, /) -> _Memory: ...
    def __getitem__(self, at: int, /) -> int: ...
    def __setitem__(self, at: int, value: int, /) -> None: ...

ptr8 = _Memory
ptr16 = _Memory
ptr32 = _Memory

def words(n: int) -> MutableSequence[int]: ...
def const(value: int) -> int: ...

class micropython:
    @staticmethod
    def viper(function: _F) -> _F: ...
