"""Limits for CSV and Parquet files of other programs, checked before the file is loaded.

A Parquet file of a few kilobytes can expand to billions of cells, and a CSV can have a million
columns. The limits are far above the size of laboratory data.
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
"""1.6 GB as numbers; two hours at 1 kHz with all channels need a third of it."""
FREE_CELLS = 20_000_000
"""160 MB as numbers: as much a file may declare whatever its size."""
CELLS_PER_BYTE = 16
"""What more than that must have at least a byte for so many cells; measured noise needs more."""
LARGEST_CSV = 2 << 30
LARGEST_HEAD = 100_000
MOST_TEXT = 64 << 20
"""Total bytes of all distinct texts of a column."""
_REMEDY = "no test records that much; split the file, or do not trust it"


def check_csv(path: Path) -> None:
    """Refuse a CSV that is not a regular file, is too large, or has too long a header.

    Raises:
        PamrigError: names the reason.
    """
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):
        raise PamrigError(str(path), "is not a regular file", "give a file")
    if about.st_size > LARGEST_CSV:
        raise PamrigError(str(path), f"has {about.st_size} bytes, allowed {LARGEST_CSV}", _REMEDY)
    with open(path, "rb") as file:
        head = file.readline(LARGEST_HEAD + 1)
    if len(head) > LARGEST_HEAD or head.count(b",") >= MOST_COLUMNS:
        what = f"its header has more than {MOST_COLUMNS} columns or {LARGEST_HEAD} bytes"
        raise PamrigError(f"{path}, row 1", what, _REMEDY)


def read_parquet(path: Path) -> pd.DataFrame:
    """Read a Parquet file with columns of numbers, times or text.

    Text columns are read as dictionaries, so that a repeated text needs memory only once.

    Raises:
        PamrigError: not such a file, or it declares more than ``MOST_CELLS``.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not stat.S_ISREG(os.stat(path).st_mode):
        raise PamrigError(str(path), "is not a regular file", "give a file")
    try:
        with pq.ParquetFile(path, memory_map=True) as file:
            _check_declared_size(path, file.metadata)
            texts = _text_columns(path, file.schema_arrow)
        table = pq.read_table(path, read_dictionary=texts, use_threads=False)
        for name in texts:
            _check_text_size(path, name, table.column(name))
        frame: pd.DataFrame = table.to_pandas(
            use_threads=False, split_blocks=True, self_destruct=True
        )
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise PamrigError(str(path), f"is not a Parquet file: {first}") from error
    for name in texts:
        frame[name] = frame[name].astype(object)
    return frame


def _check_declared_size(path: Path, about: Any) -> None:
    cells = about.num_rows * max(1, about.num_columns)
    if about.num_columns > MOST_COLUMNS or cells > MOST_CELLS:
        what = f"declares {about.num_rows} rows of {about.num_columns} columns"
        raise PamrigError(str(path), what, _REMEDY)
    if cells > max(FREE_CELLS, CELLS_PER_BYTE * path.stat().st_size):
        what = f"declares {cells} cells in {path.stat().st_size} bytes"
        raise PamrigError(str(path), what, _REMEDY)
    groups = range(about.num_row_groups)
    declared = sum(about.row_group(k).total_byte_size for k in groups)
    held = sum(about.row_group(k).num_rows for k in groups)
    if declared > 8 * MOST_CELLS or held != about.num_rows:
        raise PamrigError(str(path), f"declares {held} rows in {declared} bytes", _REMEDY)


def _text_columns(path: Path, schema: Any) -> list[str]:
    """Names of text columns; the other columns must hold numbers, times or nothing."""
    import pyarrow.types as t

    out = []
    for field in schema:
        kind = field.type.value_type if t.is_dictionary(field.type) else field.type
        if t.is_string(kind) or t.is_large_string(kind):
            out.append(field.name)
        elif not (t.is_primitive(kind) or t.is_null(kind)) or t.is_dictionary(field.type):
            raise PamrigError(
                f"{path}, column {field.name}", f"holds {field.type}", "use numbers or text"
            )
    return out


def _check_text_size(path: Path, name: str, column: Any) -> None:
    held = sum(chunk.dictionary.nbytes for chunk in column.chunks if hasattr(chunk, "dictionary"))
    if held > MOST_TEXT:
        raise PamrigError(f"{path}, column {name}", f"holds {held} bytes of text", _REMEDY)
