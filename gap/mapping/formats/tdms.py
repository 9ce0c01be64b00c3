"""TDMS files of LabVIEW."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gap.errors import GapError
from gap.mapping.formats.source import Column, first_line, library, missing, plain, texts

_NS = 1e9
_LONGEST_S = 3e9


class TdmsFile:
    """A TDMS file: a column is `group/channel`; `own_ns` are the times of its waveform.

    A dated waveform (`wf_start_time`) puts the channels of all files on one clock.

    Raises:
        GapError: not such a file, or npTDMS is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        reader = library("nptdms", path, "npTDMS")
        try:
            self._file = reader.TdmsFile.read(path)
        except Exception as error:  # npTDMS raises whatever the parser meets
            raise GapError(str(path), f"is not a TDMS file ({first_line(error)})") from None
        self._channels = {
            f"{group.name}/{channel.name}": channel
            for group in self._file.groups()
            for channel in group.channels()
        }

    def names(self) -> list[str]:
        """Group and name of each channel."""
        return list(self._channels)

    def column(self, name: str) -> Column:
        """A channel with its values as scaled by LabVIEW."""
        where = f"{self._path}, column {name}"
        if name not in self._channels:
            raise missing(str(self._path), name, self.names())
        channel = self._channels[name]
        values = np.asarray(channel[:])
        if values.dtype.kind == "O":
            return texts(where, values.tolist())
        step = channel.properties.get("wf_increment")
        if not isinstance(step, (int, float)) or not step > 0.0:
            return plain(where, values)
        begin = float(channel.properties.get("wf_start_offset", 0.0))
        if abs(begin) + len(values) * float(step) > _LONGEST_S:
            raise GapError(
                where, f"its waveform has steps of {step:g} s", "state column or rate_hz"
            )
        own = np.round((begin + np.arange(len(values)) * float(step)) * _NS).astype(np.int64)
        start = channel.properties.get("wf_start_time")
        if isinstance(start, np.datetime64) and start.astype("datetime64[s]").astype(int) > 0:
            own = own + start.astype("datetime64[ns]").astype(np.int64)
            return plain(where, values, own_ns=own, dated=True)
        return plain(where, values, own_ns=own)
