"""The reader of each format."""

from __future__ import annotations

import stat
from pathlib import Path

from gap.errors import GapError
from gap.mapping.formats.hdf5 import Hdf5File
from gap.mapping.formats.mat import open_mat
from gap.mapping.formats.mcap_file import McapFile
from gap.mapping.formats.parquet import ParquetFile
from gap.mapping.formats.source import LARGEST, Source
from gap.mapping.formats.tdms import TdmsFile
from gap.mapping.formats.text import TextFile, TextLayout

FORMATS = ("csv", "parquet", "mat", "hdf5", "tdms", "mcap")
BY_SUFFIX = {
    ".csv": "csv", ".tsv": "csv", ".txt": "csv", ".dat": "csv", ".parquet": "parquet",
    ".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5", ".hdf": "hdf5", ".tdms": "tdms", ".mcap": "mcap",
}  # fmt: skip
"""Format that a file's name stands for."""


def open_source(path: Path, kind: str, layout: TextLayout) -> Source:
    """Open a file.

    Args:
        path: the file.
        kind: one of `FORMATS`, or "" to go by the name.
        layout: of text files.

    Raises:
        GapError: no regular file, too large, of no known format, or not what its name says.
    """
    kind = kind or BY_SUFFIX.get(path.suffix.lower(), "")
    if not kind:
        raise GapError(str(path), "has an unknown format", f"state source.type: {list(FORMATS)}")
    try:
        about = path.stat()
    except OSError as error:
        raise GapError(str(path), f"cannot be read: {error.strerror}") from None
    if not stat.S_ISREG(about.st_mode):
        raise GapError(str(path), "is not a regular file")
    if not 0 < about.st_size <= LARGEST:
        raise GapError(str(path), "is empty" if not about.st_size else f"is above {LARGEST} bytes")
    if kind == "csv":
        return TextFile(path, layout)
    readers = {"parquet": ParquetFile, "hdf5": Hdf5File, "tdms": TdmsFile, "mcap": McapFile}
    return open_mat(path) if kind == "mat" else readers[kind](path)
