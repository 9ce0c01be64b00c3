"""What every format gives: columns of one file, with the row each value stands in."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from gap.errors import GapError

MOST_VALUES = 200_000_000
"""Values of one column; more is no record of a test."""
LARGEST = 8 << 30
"""Bytes of a file."""
Whole = npt.NDArray[np.int64]
EXTRA = "pip install 'pamrig[import]'"


@dataclass(frozen=True)
class Column:
    """One column of a file, all arrays of shape (n,).

    Attributes:
        where: file and column, for messages.
        values: float64, int64, object (texts), or datetime64[ns] in UTC.
        rows: where each value stands, as a person counts (lines of a text file, else from 1).
        own_ns: times that the file itself has for these values, ns; None where it has none.
        unit: of the values as the file states it; "" where it states none.
        dated: whether `own_ns` counts from 1970 (UTC), so that files share one clock.
    """

    where: str
    values: npt.NDArray[Any]
    rows: Whole
    own_ns: Whole | None = None
    dated: bool = False
    unit: str = ""

    def __len__(self) -> int:
        return len(self.values)

    @property
    def is_text(self) -> bool:
        """Whether the values are texts."""
        return bool(self.values.dtype.kind == "O")

    def error(self, index: int, what: str, remedy: str = "") -> GapError:
        """The error that names file, column and row of one value."""
        return GapError(f"{self.where}, row {int(self.rows[index])}", what, remedy)


class Source(Protocol):
    """One opened file."""

    def names(self) -> list[str]:
        """Names of its columns, for messages."""
        ...

    def column(self, name: str) -> Column:
        """A column by name, or by its number from 1 ("#3"). Raises `GapError`."""
        ...


def plain(where: str, values: npt.NDArray[Any], **more: Any) -> Column:
    """A column whose rows count from 1; numbers become float64 or int64, texts objects.

    Raises:
        GapError: values that are neither numbers, texts nor times, or far too many of them.
    """
    if len(values) > MOST_VALUES:
        raise GapError(where, f"has {len(values)} values, allowed {MOST_VALUES}")
    rows = np.arange(1, len(values) + 1, dtype=np.int64)
    kind = values.dtype.kind
    if kind in "bui":
        made = values.astype(np.int64)
    elif kind == "f":
        made = values.astype(np.float64)
    elif kind == "M":
        made = values.astype("datetime64[ns]")
    elif kind in "US":
        made = np.array([_text(value) for value in values.tolist()], dtype=object)
    else:
        raise GapError(where, f"holds {values.dtype}, neither numbers nor texts")
    return Column(where, made, rows, **more)


def _text(value: str | bytes) -> str:
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else value


def texts(where: str, values: list[Any]) -> Column:
    """A column of texts; None is an empty one. Raises `GapError` for anything else."""
    rows = np.arange(1, len(values) + 1, dtype=np.int64)
    words = np.empty(len(values), dtype=object)
    for k, value in enumerate(values):
        if value is not None and not isinstance(value, (str, bytes)):
            raise GapError(where, f"holds {type(value).__name__}, neither numbers nor texts")
        words[k] = "" if value is None else _text(value)
    return Column(where, words, rows)


def library(name: str, path: Path, package: str) -> Any:
    """A library that only some formats need, imported when the first such file is read.

    Raises:
        GapError: it is not installed; the remedy names the extra.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise GapError(str(path), f"needs the package {package}", EXTRA) from None


def numbered(name: str, names: list[str], where: str) -> int | None:
    """Index of a column given by its number ("#3"); None for a name. Raises `GapError`."""
    if not name.startswith("#"):
        return None
    number = int(name[1:])
    if number > len(names):
        raise GapError(f"{where}, column {number}", f"is missing: there are {len(names)} columns")
    return number - 1


def missing(where: str, name: str, names: list[str]) -> GapError:
    """The error for a column that is not there, with those that are."""
    shown = ", ".join(names[:12]) + (" ..." if len(names) > 12 else "")
    return GapError(f"{where}, column {name}", "is missing", f"there are: {shown or 'none'}")


def first_line(error: Exception) -> str:
    """First line of an error's text."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
