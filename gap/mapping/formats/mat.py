"""MATLAB files: version 5 to 7.2 by scipy, version 7.3 as HDF5."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from gap.errors import GapError
from gap.mapping.formats.arrays import one_column, split_name
from gap.mapping.formats.hdf5 import Hdf5File
from gap.mapping.formats.source import (
    MOST_VALUES,
    Column,
    Source,
    first_line,
    missing,
    plain,
    texts,
)

_HDF5 = b"\x89HDF\r\n\x1a\n"


def open_mat(path: Path) -> Source:
    """A MATLAB file of any version since 5. Raises `GapError`."""
    try:
        with path.open("rb") as file:
            head = file.read(520)
    except OSError as error:
        raise GapError(str(path), f"cannot be read: {error.strerror}") from None
    if _HDF5 in (head[:8], head[512:520]):
        return Hdf5File(path, matlab=True)
    return MatFile(path)


class MatFile:
    """A MATLAB file of version 5 to 7.2: a column is `name`, `struct.field` or `matrix[2]`.

    Objects of MATLAB classes, functions and tables are refused: only numbers and texts are data.
    """

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat, whosmat

        self._path = path
        try:
            declared = sum(math.prod(shape) for _, shape, _ in whosmat(path))
            if declared > MOST_VALUES:
                raise GapError(str(path), f"declares {declared} values, allowed {MOST_VALUES}")
            content = loadmat(path, struct_as_record=True, squeeze_me=False)
        except GapError:
            raise
        except Exception as error:  # scipy raises whatever the parser meets
            raise GapError(str(path), f"is not a MATLAB file ({first_line(error)})") from None
        self._arrays: dict[str, Any] = {}
        for name, value in content.items():
            if not name.startswith("__"):
                self._take(name, value, 0)

    def names(self) -> list[str]:
        """Names of the arrays; fields of structs behind a dot."""
        return sorted(self._arrays)

    def column(self, name: str) -> Column:
        """An array of one column, or one column of a matrix."""
        base, number = split_name(name)
        where = f"{self._path}, column {name}"
        if base not in self._arrays:
            raise missing(str(self._path), name, self.names())
        array = self._arrays[base]
        if array.dtype.kind == "O":
            cells = [self._cell(cell, where) for cell in one_column(array, number, where)]
            return texts(where, cells)
        return plain(where, one_column(array, number, where))

    def _cell(self, cell: Any, where: str) -> str:
        flat = np.asarray(cell).reshape(-1)
        if flat.dtype.kind != "U" or len(flat) > 1:
            raise GapError(where, "holds objects, neither numbers nor texts", "save arrays of them")
        return str(flat[0]) if len(flat) else ""

    def _take(self, name: str, value: Any, depth: int) -> None:
        from scipy.io.matlab import MatlabFunction, MatlabOpaque

        if isinstance(value, (MatlabFunction, MatlabOpaque)) or not isinstance(value, np.ndarray):
            return  # asked for, it is missing: no data
        if value.dtype.names is None:
            self._arrays[name] = value
            return
        if value.size != 1 or depth > 8:
            return
        record = value.reshape(-1)[0]
        for field in value.dtype.names:
            self._take(f"{name}.{field}", record[field], depth + 1)
