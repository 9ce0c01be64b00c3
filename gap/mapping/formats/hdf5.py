"""HDF5 files, which MATLAB files of version 7.3 are as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gap.errors import GapError
from gap.mapping.formats.arrays import one_column, split_name
from gap.mapping.formats.source import (
    MOST_VALUES,
    Column,
    first_line,
    library,
    missing,
    plain,
    texts,
)


class Hdf5File:
    """An HDF5 file: a column is a dataset's path, `table/name` of a compound, or `matrix[2]`.

    Links into other files and datasets stored elsewhere are refused: a file must hold its data.

    Raises:
        GapError: not such a file, or h5py is not installed.
    """

    def __init__(self, path: Path, matlab: bool = False) -> None:
        self._path = path
        self._h5 = library("h5py", path, "h5py")
        self._matlab = matlab
        try:
            self._file = self._h5.File(path, "r")
        except OSError as error:
            raise GapError(str(path), f"is not an HDF5 file ({first_line(error)})") from None

    def names(self) -> list[str]:
        """Paths of the datasets; fields of compounds behind a slash."""
        found: list[str] = []
        self._walk(self._file, "", found, 0)
        return sorted(found)

    def column(self, name: str) -> Column:
        """A dataset of one column, a field, or a column of a matrix."""
        base, number = split_name(name)
        where = f"{self._path}, column {name}"
        steps = [step for step in base.split("/") if step]
        node: Any = self._file
        while steps and isinstance(node, self._h5.Group):
            node = self._step(node, steps.pop(0), where, name)
        if not isinstance(node, self._h5.Dataset):
            raise missing(str(self._path), name, self.names())
        self._check(node, where)
        try:
            array = self._array(node, steps, where, name)
        except (OSError, TypeError, ValueError) as error:
            raise GapError(where, f"cannot be read ({first_line(error)})") from None
        if self._matlab and array.ndim == 2:
            array = array.T  # MATLAB stores columns first
        chosen = one_column(array, number, where)
        if chosen.dtype.kind == "O":
            return texts(where, list(chosen))
        return plain(where, chosen)

    def _array(self, node: Any, steps: list[str], where: str, name: str) -> Any:
        if node.dtype.names:
            if len(steps) != 1 or steps[0] not in node.dtype.names:
                raise missing(str(self._path), name, self.names())
            return np.asarray(node.fields(steps[0])[()])
        if steps:
            raise missing(str(self._path), name, self.names())
        if node.dtype.kind == "O" and self._h5.check_string_dtype(node.dtype) is None:
            raise GapError(where, "holds objects, neither numbers nor texts")
        return np.asarray(node[()])

    def _step(self, group: Any, name: str, where: str, whole: str) -> Any:
        link = group.get(name, getlink=True)
        if link is None:
            raise missing(str(self._path), whole, self.names())
        if isinstance(link, self._h5.ExternalLink):
            raise GapError(where, f"is a link into another file ({link.filename})", "copy the data")
        try:
            return group[name]
        except (KeyError, OSError):
            raise missing(str(self._path), whole, self.names()) from None

    def _check(self, node: Any, where: str) -> None:
        real = node.file.filename == self._file.filename
        if not real or node.external or node.is_virtual:
            raise GapError(where, "is stored in another file", "copy the data into this one")
        if node.size is None or node.size > MOST_VALUES:
            raise GapError(where, f"declares {node.size} values, allowed {MOST_VALUES}")

    def _walk(self, group: Any, prefix: str, found: list[str], depth: int) -> None:
        if depth > 8 or len(found) > 500:
            return
        for key in group:
            link = group.get(key, getlink=True)
            if not isinstance(link, self._h5.HardLink):
                continue
            node = group[key]
            path = f"{prefix}/{key}" if prefix else key
            if isinstance(node, self._h5.Group):
                self._walk(node, path, found, depth + 1)
            elif node.dtype.names:
                found += [f"{path}/{field}" for field in node.dtype.names]
            elif not path.startswith("#refs#"):
                found.append(path)
