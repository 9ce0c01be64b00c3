"""Verdicts and fits as plain values and arrays, and back; the types of the fields say how.

Nothing that is read names what is made of it: the caller states the class, so data cannot become
code, and what does not fit the class is refused.
"""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Mapping
from enum import Enum
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from gap.effects.candidates import CANDIDATES, Candidate

_TUPLE = "__tuple__"


def encode(hint: Any, value: Any, arrays: list[Any]) -> Any:
    """`value` of type `hint` as values that JSON can carry; its arrays are added to `arrays`."""
    origin = get_origin(hint)
    if hint in (Any, object):
        return _loose(value)
    if hint is Candidate:
        return [value.id, value.option, dict(value.shape)]
    if dataclasses.is_dataclass(hint):
        return {
            name: encode(inner, getattr(value, name), arrays)
            for name, inner in _fields(hint).items()
        }
    if isinstance(hint, type) and issubclass(hint, Enum):
        return value.name
    if origin in (Union, types.UnionType):
        return None if value is None else encode(_chosen(hint, value), value, arrays)
    if origin is np.ndarray:
        arrays.append(np.asarray(value))
        return len(arrays) - 1
    if origin in (tuple, list):
        return [encode(h, v, arrays) for h, v in zip(_inner(hint, len(value)), value, strict=True)]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {str(key): encode(get_args(hint)[1], item, arrays) for key, item in value.items()}
    return _loose(value)


def decode(hint: Any, stored: Any, arrays: list[Any]) -> Any:
    """What `encode` was given.

    Raises:
        ValueError, TypeError, KeyError, IndexError: it does not fit `hint`.
    """
    origin = get_origin(hint)
    if hint in (Any, object):
        return _tight(stored)
    if hint is Candidate:
        return _candidate(*stored)
    if dataclasses.is_dataclass(hint):
        made = {name: decode(h, stored[name], arrays) for name, h in _fields(hint).items()}
        return hint(**made)  # type: ignore[operator]
    if isinstance(hint, type) and issubclass(hint, Enum):
        return hint[stored]
    if origin in (Union, types.UnionType):
        return None if stored is None else decode(_chosen(hint, stored), stored, arrays)
    if origin is np.ndarray:
        return arrays[stored]
    if origin in (tuple, list):
        hints = _inner(hint, len(stored))
        return origin(decode(h, v, arrays) for h, v in zip(hints, stored, strict=True))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {key: decode(get_args(hint)[1], item, arrays) for key, item in stored.items()}
    wanted = (int, float) if hint is float else hint
    if not isinstance(stored, wanted):
        raise ValueError(f"expected {hint}, got {stored!r}")
    return stored


def _fields(cls: Any) -> dict[str, Any]:
    """Types of the fields of a dataclass, without what it keeps for itself."""
    return _hints_of(cls)


@cache
def _hints_of(cls: type) -> dict[str, Any]:
    hints = get_type_hints(cls)
    return {f.name: hints[f.name] for f in dataclasses.fields(cls) if not f.name.startswith("_")}


def _inner(hint: Any, count: int) -> list[Any]:
    """Types of the items of a tuple or list."""
    args = get_args(hint)
    if get_origin(hint) is list or (len(args) == 2 and args[1] is Ellipsis):
        return [args[0]] * count
    return list(args)


def _chosen(hint: Any, value: Any) -> Any:
    """The type of a union that a value other than None has."""
    kinds = [kind for kind in get_args(hint) if kind is not type(None)]
    if len(kinds) > 1 and str in kinds:
        return str if isinstance(value, str) else next(kind for kind in kinds if kind is not str)
    return kinds[0]


def _loose(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _loose(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return {_TUPLE: [_loose(item) for item in value]}
    if isinstance(value, list):
        return [_loose(item) for item in value]
    return _loose(value.tolist()) if hasattr(value, "tolist") else value


def _tight(stored: Any) -> Any:
    if isinstance(stored, dict):
        if stored.keys() == {_TUPLE}:
            return tuple(_tight(item) for item in stored[_TUPLE])
        return {key: _tight(item) for key, item in stored.items()}
    return [_tight(item) for item in stored] if isinstance(stored, list) else stored


def _candidate(name: str, option: str, shape: dict[str, float]) -> Candidate:
    """The candidate itself where it has a listed shape, else one with the shape fitted."""
    own = [one for one in CANDIDATES if one.id == name and one.option == option]
    for one in own:
        if dict(one.shape) == shape:
            return one
    return dataclasses.replace(own[0], shape=shape)
