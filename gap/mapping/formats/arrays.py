"""Names of columns in files of arrays: `table[2]` is the second column of a matrix."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from gap.errors import GapError

_PART = re.compile(r"^(.*?)\[(\d+)\]$")


def split_name(name: str) -> tuple[str, int | None]:
    """The array's name and the column's number from 1; None where no number is given."""
    found = _PART.match(name)
    return (found[1], int(found[2])) if found else (name, None)


def one_column(array: npt.NDArray[Any], number: int | None, where: str) -> npt.NDArray[Any]:
    """One column of an array of at most two dimensions, shape (n,).

    A row counts as a column, and so does an array with a single column.

    Raises:
        GapError: the array has several columns and no number says which, or no such column.
    """
    if array.ndim == 0:
        array = array.reshape(1)
    if array.ndim == 1:
        if number not in (None, 1):
            raise GapError(where, "is missing: the array has one column")
        return array
    if array.ndim > 2:
        raise GapError(where, f"has {array.ndim} dimensions, expected one or two")
    if number is None:
        if 1 not in array.shape:
            shape = " x ".join(str(n) for n in array.shape)
            raise GapError(where, f"is a matrix of {shape}", "name one column of it: NAME[1]")
        return np.asarray(array).reshape(-1)
    if not 1 <= number <= array.shape[1]:
        raise GapError(where, f"is missing: the matrix has {array.shape[1]} columns")
    return np.asarray(array[:, number - 1])
