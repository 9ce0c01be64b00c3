"""CSV and other text files with separated columns."""

from __future__ import annotations

import csv
import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from daq.errors import PamrigError
from daq.store.tablefile import check_csv
from gap.errors import GapError
from gap.mapping.formats.source import Column, missing, numbered

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": " "}
"""Words for the delimiters; "space" is any number of blanks and tabs."""


@dataclass(frozen=True)
class TextLayout:
    """How a text file is laid out.

    Attributes:
        delimiter: a key of `DELIMITERS`; "" for a comma, or a tab in files named .tsv.
        decimal: "point" or "comma".
        header: whether the first line of the table names the columns.
        comment: lines that begin with this text are not read; "" for none.
        skip_lines: lines before the table.
        skip_after_header: lines between the header and the numbers (often units).
        encoding: of the file.
        missing: texts that stand for no value, besides an empty cell.
        header_begins: the header is the first line that begins with this text (quotes aside).
        units: the line after the header holds the units of the columns.
    """

    delimiter: str = ""
    decimal: str = "point"
    header: bool = True
    comment: str = ""
    skip_lines: int = 0
    skip_after_header: int = 0
    encoding: str = "utf-8"
    missing: tuple[str, ...] = ("nan", "NaN")
    header_begins: str = ""
    units: bool = False


class TextFile:
    """A text file; cells stay texts until a column is asked for.

    Raises:
        GapError: not such a file, a row with another number of cells, or no row at all.
    """

    def __init__(self, path: Path, layout: TextLayout) -> None:
        self._path = path
        self._layout = layout
        self._delimiter = layout.delimiter or ("tab" if path.suffix == ".tsv" else "comma")
        lines, numbers = self._lines()
        self._names: list[str] = []
        self._units: list[str] = []
        if layout.header and lines:
            self._names = [cell.strip() for cell in self._cells(lines[0])]
            after = 1 + int(layout.units) + layout.skip_after_header
            if layout.units and len(lines) > 1:
                self._units = [cell.strip().strip("()[]") for cell in self._cells(lines[1])]
            lines, numbers = lines[after:], numbers[after:]
        if not lines:
            raise GapError(str(path), "has no rows")
        width = len(self._names) or len(self._cells(lines[0]))
        self._rows = np.array(numbers, dtype=np.int64)
        self._check_width(lines, width)
        self._frame = self._parsed(lines, width)

    def names(self) -> list[str]:
        """Names in the header; numbers from 1 where there is none."""
        return self._names or [str(k + 1) for k in range(self._frame.shape[1])]

    def column(self, name: str) -> Column:
        """Numbers where every cell is one (empty cells are NaN), else texts."""
        where = f"{self._path}, column {name.removeprefix('#')}"
        if name.startswith("#"):
            at = numbered(name, self.names(), str(self._path))
        else:
            if not self._layout.header:
                raise GapError(where, "is a name, and the file has no header", "give its number")
            if self._names.count(name) > 1:
                raise GapError(where, "appears twice")
            at = self._names.index(name) if name in self._names else None
        if at is None:
            raise missing(str(self._path), name, self.names())
        cells = self._frame[at].str.strip()
        cells = cells.mask(cells.isin(self._layout.missing), "")
        unit = self._units[at] if at < len(self._units) else ""
        return Column(where, self._numbers(cells), self._rows, unit=unit)

    def _numbers(self, cells: pd.Series[Any]) -> np.ndarray[Any, Any]:
        """As float64 if all cells are numbers or empty; as int64 if all are whole; else texts."""
        blank = cells == ""
        words = cells
        if self._layout.decimal == "comma":
            words = words.where(~words.str.contains(".", regex=False), "x")
            words = words.str.replace(",", ".", regex=False)
        plain = words.str.fullmatch(r"[+-]?\d{1,18}")
        if bool(plain.all()):
            return np.asarray(words.astype("int64"), dtype=np.int64)
        value = pd.to_numeric(words.where(~blank, "nan"), errors="coerce")
        if bool((value.isna() & ~blank).any()):
            mixed = cells
            if self._layout.decimal == "comma":  # numbers beside a text are still numbers
                mixed = words.where(~value.isna(), cells)
            return np.asarray(mixed.astype(object))
        return np.asarray(value.to_numpy(dtype=np.float64))

    def _lines(self) -> tuple[list[str], list[int]]:
        """Lines of the table with their numbers; comments and empty lines are left out."""
        layout = self._layout
        try:
            check_csv(self._path)
            text = self._path.read_bytes().decode(layout.encoding)
        except PamrigError as error:
            raise GapError(error.where, error.what, error.remedy) from None
        except UnicodeDecodeError as error:
            what = f"is not {layout.encoding} text (byte {error.start})"
            raise GapError(str(self._path), what, "state source.encoding") from None
        except OSError as error:
            raise GapError(str(self._path), f"cannot be read: {error.strerror}") from None
        kept, numbers = [], []
        for number, line in enumerate(text.removeprefix("\ufeff").split("\n"), start=1):
            line = line.removesuffix("\r")
            if number <= layout.skip_lines or not line.strip():
                continue
            if layout.comment and line.startswith(layout.comment):
                continue
            kept.append(line)
            numbers.append(number)
        return self._from_header(kept, numbers)

    def _from_header(self, lines: list[str], numbers: list[int]) -> tuple[list[str], list[int]]:
        """What stands from the header on, where the layout says how that begins."""
        begins = self._layout.header_begins
        if not begins:
            return lines, numbers
        for k, line in enumerate(lines):
            if line.lstrip().replace('"', "").startswith(begins):
                return lines[k:], numbers[k:]
        raise GapError(
            str(self._path), f"no line begins with {begins!r}", "check source.header_begins"
        )

    def _cells(self, line: str) -> list[str]:
        if self._delimiter == "space":
            return line.split()
        try:
            return next(csv.reader([line], delimiter=DELIMITERS[self._delimiter], strict=True))
        except csv.Error as error:
            raise GapError(str(self._path), f"cannot be read as columns ({error})") from None

    def _check_width(self, lines: list[str], width: int) -> None:
        mark = DELIMITERS[self._delimiter]
        for k, line in enumerate(lines):
            simple = '"' not in line and self._delimiter != "space"
            cells = line.count(mark) + 1 if simple else len(self._cells(line))
            if cells != width:
                raise GapError(
                    f"{self._path}, row {int(self._rows[k])}",
                    f"has {cells} cells, not {width}",
                    "check the delimiter, the decimal sign and whether the file was cut short",
                )

    def _parsed(self, lines: list[str], width: int) -> pd.DataFrame:
        split = r"\s+" if self._delimiter == "space" else DELIMITERS[self._delimiter]
        text = [" ".join(line.split()) for line in lines] if self._delimiter == "space" else lines
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", pd.errors.ParserWarning)
                frame = pd.read_csv(
                    io.StringIO("\n".join(text) + "\n"), sep=split, header=None, dtype=str,
                    names=list(range(width)), na_filter=False, index_col=False,
                )  # fmt: skip
        except (pd.errors.ParserError, ValueError) as error:
            raise GapError(str(self._path), f"cannot be read as columns ({error})") from None
        if len(frame) != len(lines):
            raise GapError(str(self._path), "has a quoted cell over several lines")
        return frame
