"""Parquet files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from daq.errors import PamrigError
from daq.store.tablefile import read_parquet
from gap.errors import GapError
from gap.mapping.formats.source import Column, missing, numbered, plain, texts


class ParquetFile:
    """A Parquet file with columns of numbers, times or texts. Raises `GapError`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._frame = read_parquet(path)
        except PamrigError as error:
            raise GapError(error.where, error.what, error.remedy) from None
        except OSError as error:
            raise GapError(str(path), f"cannot be read: {error.strerror}") from None
        self._frame.columns = [str(name) for name in self._frame.columns]

    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self._frame.columns)

    def column(self, name: str) -> Column:
        """A column; null is NaN, or an empty text."""
        where = f"{self._path}, column {name.removeprefix('#')}"
        at = numbered(name, self.names(), str(self._path))
        if at is None:
            if self.names().count(name) > 1:
                raise GapError(where, "appears twice")
            if name not in self._frame:
                raise missing(str(self._path), name, self.names())
            at = self.names().index(name)
        series = self._frame.iloc[:, at]
        if pd.api.types.is_datetime64_any_dtype(series):
            if series.isna().any():
                row = int(np.flatnonzero(series.isna())[0]) + 1
                raise GapError(f"{where}, row {row}", "is empty", "every row needs a time")
            utc = series.dt.tz_convert("UTC").dt.tz_localize(None) if series.dt.tz else series
            return plain(where, utc.to_numpy())
        if pd.api.types.is_bool_dtype(series):
            series = series.astype("int64")
        if pd.api.types.is_integer_dtype(series) and not series.isna().any():
            return plain(where, series.to_numpy(dtype=np.int64))
        if pd.api.types.is_numeric_dtype(series):
            return plain(where, series.to_numpy(dtype=np.float64, na_value=np.nan))
        return texts(where, series.astype(object).where(series.notna(), None).tolist())
