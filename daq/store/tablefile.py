"""CSV and Parquet files of strangers: looked at before they are read into memory.

A few kilobytes of Parquet can stand for billions of cells, a CSV can have a million columns. What
a laboratory has is far from these bounds; what is beyond them is refused with its own words.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.errors import PamrigError

if TYPE_CHECKING:
    import pandas as pd

MOST_COLUMNS = 500
MOST_CELLS = 200_000_000
"""Of numbers: 1.6 GB; two hours at 1 kHz with all channels are a third of it."""
LARGEST_CSV = 2 << 30
LARGEST_HEAD = 100_000
MOST_TEXT = 64 << 20
"""Bytes of all different words of a column together."""
_REMEDY = "no bench records so much; cut the file into several, or do not trust it"


def check_csv(path: Path) -> None:
    """Refuse a CSV that is no plain file, is too large, or has a header without end.

    Raises:
        PamrigError: says which.
    """
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):
        raise PamrigError(str(path), "is no plain file", "give a file")
    if about.st_size > LARGEST_CSV:
        raise PamrigError(str(path), f"has {about.st_size} bytes, allowed {LARGEST_CSV}", _REMEDY)
    with open(path, "rb") as file:
        head = file.readline(LARGEST_HEAD + 1)
    if len(head) > LARGEST_HEAD or head.count(b",") >= MOST_COLUMNS:
        what = f"its header has more than {MOST_COLUMNS} columns or {LARGEST_HEAD} bytes"
        raise PamrigError(f"{path}, row 1", what, _REMEDY)


def read_parquet(path: Path) -> pd.DataFrame:
    """A Parquet file of plain columns; words are kept once each while it is read.

    Raises:
        PamrigError: it is no such file, or claims more than ``MOST_CELLS``.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not stat.S_ISREG(os.stat(path).st_mode):
        raise PamrigError(str(path), "is no plain file", "give a file")
    try:
        with pq.ParquetFile(path, memory_map=True) as file:
            _check_claims(path, file.metadata)
            words = _words(path, file.schema_arrow)
        table = pq.read_table(path, read_dictionary=words, use_threads=False)
        for name in words:
            _check_words(path, name, table.column(name))
        frame: pd.DataFrame = table.to_pandas(use_threads=False)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise PamrigError(str(path), f"is not a Parquet file: {first}") from error
    for name in words:
        frame[name] = frame[name].astype(object)
    return frame


def _check_claims(path: Path, about: Any) -> None:
    cells = about.num_rows * max(1, about.num_columns)
    if about.num_columns > MOST_COLUMNS or cells > MOST_CELLS:
        what = f"claims {about.num_rows} rows of {about.num_columns} columns"
        raise PamrigError(str(path), what, _REMEDY)
    groups = range(about.num_row_groups)
    claimed = sum(about.row_group(k).total_byte_size for k in groups)
    held = sum(about.row_group(k).num_rows for k in groups)
    if claimed > 8 * MOST_CELLS or held != about.num_rows:
        raise PamrigError(str(path), f"claims {held} rows in {claimed} bytes", _REMEDY)


def _words(path: Path, schema: Any) -> list[str]:
    """Columns of text; the others have to be numbers, times or nothing."""
    import pyarrow.types as t

    out = []
    for field in schema:
        kind = field.type.value_type if t.is_dictionary(field.type) else field.type
        if t.is_string(kind) or t.is_large_string(kind):
            out.append(field.name)
        elif not (t.is_primitive(kind) or t.is_null(kind)) or t.is_dictionary(field.type):
            raise PamrigError(f"{path}, column {field.name}", f"holds {field.type}", "numbers only")
    return out


def _check_words(path: Path, name: str, column: Any) -> None:
    held = sum(chunk.dictionary.nbytes for chunk in column.chunks if hasattr(chunk, "dictionary"))
    if held > MOST_TEXT:
        raise PamrigError(f"{path}, column {name}", f"holds {held} bytes of words", _REMEDY)
