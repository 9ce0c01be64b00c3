"""Writes the record of a run: raw data, append-only, every byte under a CRC.

Layout, integrity rules and how to read it without this package: docs/reference/record-format.md.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from daq.clock import Clock
from daq.errors import RecordError
from daq.record.ahead import AHEAD_BYTES, AheadFile, ahead_entry, ahead_name
from daq.record.chunks import index_line, members
from daq.record.disk import Disk, disk_error
from daq.record.runname import run_name, run_tag, slug
from daq.record.sealed import seal_file, seal_line, sums, sync_folder, write_sealed
from daq.record.segments import END_OF_STREAM, BatchEncoder, Columns, StreamSchema

SCHEMA = "pamrig-run/2"
OUTCOMES = ("clean", "stopped", "aborted", "faulted")
SEGMENT_ROWS = 300_000  # 5 min at 1 kHz
FRAMES_FILE_BYTES = 256 << 20
LONGEST_NAME = 100
"""Characters of the name of a stream or device."""
_DECLARED_S = 1.0
"""Longest wait of a stream's first row until the stream's declaration is written, s."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*\Z")


class _Indexed:
    """State of an index: next line number, current bulk file and its length."""

    def __init__(self, index: str, pattern: str) -> None:
        self.index = index
        self.pattern = pattern
        self.n = 0
        self.file_number = 0
        self.file = ""
        self.offset = 0
        self.rows_in_file = 0

    def next_file(self) -> None:
        self.file_number += 1
        self.file = self.pattern.format(self.file_number)
        self.offset = 0
        self.rows_in_file = 0


class _Stream(_Indexed):
    def __init__(self, schema: StreamSchema, run_id: str) -> None:
        name = schema.name
        super().__init__(f"samples/{name}.index.jsonl", "samples/" + name + "/{:06d}.arrows")
        self.schema = schema
        self.encoder = BatchEncoder(schema)
        self.message = schema.message(run_id)
        self.rows = 0
        self.ahead = 0
        self.ahead_file: AheadFile | None = None
        self.has_seq = "seq" in schema.columns


class RecordWriter:
    """Writes one run folder; safe to call from several threads.

    ``run.json`` is on the medium when the constructor returns. Each batch, frame and event goes to
    the operating system at once; see :mod:`daq.record.disk`.

    Args:
        root: folder of all runs; created if missing.
        manifest: the data known before the run: ``protocol``, ``specimen``, devices, calibrations,
            parameters, software. ``schema``, ``run_id`` and ``started`` are added.
        clock: time stamps of events; its wall time is used for the name and ``started`` only.
        durable: sync at creation, each second and at each event.
        threaded: write and sync in threads; False for the virtual clock.
        segment_rows: number of rows after which a stream starts a new segment file.
        frames_file_bytes: size after which frames start a new file.

    Attributes:
        withheld: streams whose batches are not recorded at present but handed to ``on_withheld``:
            a test of days keeps the readings of some of its cycles only, and says which.
        on_withheld: called with the name of the stream and its batch.
        on_wait: called with a text every few seconds while the end of the record waits for the
            disk.

    Raises:
        RecordError: the folder cannot be created or written.
    """

    def __init__(
        self,
        root: Path | str,
        manifest: Mapping[str, Any],
        clock: Clock,
        durable: bool = True,
        threaded: bool = True,
        *,
        segment_rows: int = SEGMENT_ROWS,
        frames_file_bytes: int = FRAMES_FILE_BYTES,
    ) -> None:
        self._clock = clock
        self._start_ns = clock.now_ns()
        self._segment_rows = segment_rows
        self._frames_file_bytes = frames_file_bytes
        self._lock = threading.RLock()
        self._streams: dict[str, _Stream] = {}
        self._frames = _Indexed("frames.jsonl", "frames/{:06d}.mjpg")
        self._wires: dict[str, _Indexed] = {}
        self._events = 0
        self._final: dict[str, Any] | None = None
        self.withheld: frozenset[str] = frozenset()
        self.on_withheld: Callable[[str, Columns], None] = lambda stream, columns: None
        self.on_wait: Callable[[str], None] = lambda text: None
        self._closed = False
        wall_ns = clock.wall_ns()
        self.folder = self._make_folder(Path(root), manifest, wall_ns)
        self.run_id = self.folder.name
        self._tag = run_tag(self.run_id)
        own = {
            "schema": SCHEMA,
            "run_id": self.run_id,
            "started": {
                "utc": _utc(wall_ns),
                "wall_ns": wall_ns,
                "monotonic_ns": self._start_ns,
                "virtual_clock": clock.virtual,
            },
        }
        known = {**own, **manifest, **own}
        self._known = sums(seal_file(known))
        head = {"schema": SCHEMA, "run_id": self.run_id, "run_json": self._known}
        try:
            # run.json last: a folder with it has all that shows what belongs to the run.
            self._disk = Disk(self.folder, head, durable, threaded)
            self._disk.put("events.jsonl", seal_line({"run_id": self.run_id, "events": 2}))
            self._disk.settle()
            write_sealed(self.folder / "run.json", known, durable)
            if durable:
                sync_folder(self.folder.parent)
        except OSError as error:
            raise disk_error(self.folder, "no run can be recorded here", error) from error

    @staticmethod
    def _make_folder(root: Path, manifest: Mapping[str, Any], wall_ns: int) -> Path:
        names = slug(manifest.get("protocol", "run")), slug(manifest.get("specimen", "none"))
        try:
            root.mkdir(parents=True, exist_ok=True)
            while True:
                folder = root / run_name(wall_ns, *names)
                with contextlib.suppress(FileExistsError):
                    folder.mkdir()
                    return folder
        except OSError as error:
            raise disk_error(root, "no run can be recorded here", error) from error

    @property
    def failed(self) -> RecordError | None:
        """The first write error, else None."""
        return self._disk.failed

    @property
    def start_ns(self) -> int:
        """Monotonic time of the run's start, the zero of ``t_ns`` of events and of ``time_s``."""
        return self._start_ns

    def stream(
        self, name: str, schema: Mapping[str, str], units: Mapping[str, str] | None = None
    ) -> None:
        """Declare a stream of numeric columns before its first batch.

        Args:
            name: file name of the stream, such as ``valve``.
            schema: numpy dtype of each column, in order.
            units: unit of each raw column that has one.
        """
        declared = StreamSchema(_checked_name(name), dict(schema), dict(units or {}))
        with self._lock:
            if name in self._streams:
                if self._streams[name].schema != declared:
                    raise ValueError(f"stream {name} is already declared with other columns")
                return
            stream = _Stream(declared, self.run_id)
            about = {"columns": declared.columns, "units": declared.units}
            head = {"n": 0, "run_id": self.run_id, "stream": name, **about}
            self._disk.put(stream.index, seal_line(head))
            stream.n = 1
            self._streams[name] = stream

    def append(self, stream: str, columns: Columns) -> int:
        """Append one batch; has no effect once the record is finalised.

        A batch of up to 8 kB survives a kill of the process when this returns.

        Returns:
            the number of its first row within the stream.

        Raises:
            RecordError: the disk has failed.
            ValueError: the columns differ from the declared ones.
        """
        with self._lock:
            s = self._streams[stream]
            if self._closed:  # a device may still send while the bench closes
                return s.rows
            if stream in self.withheld:
                self.on_withheld(stream, columns)
                return s.rows
            parts, rows = s.encoder.parts(columns)
            first_row = s.rows
            if rows == 0:
                return first_row
            if self._disk.threaded and not s.ahead:  # until the writer thread has written the batch
                self._put_ahead(s, ahead_entry(parts, first_row, rows), rows)
            if not s.file or 0 < self._segment_rows < s.rows_in_file + rows:
                self._end_segment(s)
                s.next_file()
                self._put_chunk(s, s.message, '"chunk":"schema"')
            more = f'"chunk":"rows","rows":{rows},"first_row":{first_row}'
            if s.has_seq:
                more += f',"first_seq":{int(columns["seq"][0])}'
            self._put_chunk(s, s.encoder.message(parts, rows), more)
            s.rows += rows
            s.rows_in_file += rows
            if s.ahead and s.ahead_file is not None:
                s.ahead = 0
                self._disk.call_after_writes(partial(s.ahead_file.clear, s.ahead_file.next_slot()))
            return first_row

    def write_ahead(self, stream: str, columns: Columns) -> None:
        """Protect rows of the next batch against a kill of the process.

        They count as recorded after :meth:`append`; see :mod:`daq.record.ahead`.

        Raises:
            RecordError, ValueError: as :meth:`append`.
        """
        with self._lock:
            s = self._streams[stream]
            if self._closed or stream in self.withheld:
                return
            parts, rows = s.encoder.parts(columns)
            if rows:
                self._put_ahead(s, ahead_entry(parts, s.rows + s.ahead, rows), rows)

    def write_ahead_row(self, stream: str, entry: bytes) -> None:
        """As :meth:`write_ahead` for one row given as an entry, see :mod:`daq.record.rows`."""
        with self._lock:
            if not self._closed:
                self._put_ahead(self._streams[stream], entry, 1)

    def _put_ahead(self, s: _Stream, entry: bytes, rows: int) -> None:
        if s.ahead_file is None:
            self._disk.drain(_DECLARED_S)  # a row is not readable without its stream's declaration
            name = s.schema.name
            try:
                s.ahead_file = AheadFile(self.folder / ahead_name(name), self.run_id, name)
                self._disk.written.constant(ahead_name(name), AHEAD_BYTES)
            except OSError as error:
                raise disk_error(self.folder, "cannot be written", error) from error
        s.ahead_file.put(entry)
        s.ahead += rows

    def rows(self, stream: str) -> int:
        """Number of rows appended to a stream."""
        return self._streams[stream].rows

    def event(self, kind: str, **fields: Any) -> int:
        """Record one event and sync it at once; returns its number.

        Does not raise after a disk failure, and still tries to write.
        """
        taken = {"n", "t_ns", "run", "crc"} & set(fields)
        if taken:
            raise ValueError(f"event {kind}: the names {sorted(taken)} are taken")
        with self._lock:
            n = self._events
            t_ns = self._clock.now_ns() - self._start_ns
            line = seal_line({"n": n, "t_ns": t_ns, "run": self._tag, "kind": kind, **fields})
            if not self._closed:
                self._disk.put("events.jsonl", line, vital=True)
                self._events += 1
            return n

    def frame(self, jpeg: bytes, host_ns: int, **meta: Any) -> int:
        """Append one encoded camera frame; returns its number, from 0."""
        with self._lock:
            frames = self._frames
            if frames.n == 0:
                head = {"n": 0, "run_id": self.run_id, "frames": "jpeg"}
                self._disk.put(frames.index, seal_line(head))
                frames.n = 1
            if not frames.file or frames.offset + len(jpeg) > self._frames_file_bytes:
                frames.next_file()
            number = frames.n - 1
            more = members({"frame": number, "host_ns": host_ns, **meta})
            self._put_chunk(frames, jpeg, more)
            return number

    def wire(self, device: str, host_ns: int, data: bytes) -> None:
        """Append raw received bytes, for test fixtures and failure analysis."""
        if not data or self._closed:
            return
        with self._lock:
            wire = self._wires.get(device)
            if wire is None:
                _checked_name(device)
                wire = _Indexed(f"wire/{device}.index.jsonl", f"wire/{device}.bin")
                head = {"n": 0, "run_id": self.run_id, "wire": device}
                self._disk.put(wire.index, seal_line(head))
                wire.n = 1
                wire.next_file()
                self._wires[device] = wire
            self._put_chunk(wire, data, f'"host_ns":{host_ns}')

    def sync(self, timeout_s: float = 5.0) -> bool:
        """Wait until all data are with the operating system; False on time-out."""
        return self._disk.drain(timeout_s)

    def finalize(self, outcome: str, **summary: Any) -> dict[str, Any]:
        """End the record; later calls have no effect.

        Args:
            outcome: ``clean``, ``stopped``, ``aborted`` or ``faulted``. After a write failure,
                ``clean`` becomes ``faulted``.
            summary: members for the whole run: gaps, clock_fit, fault, ...

        Returns:
            the members of final.json.

        Raises:
            RecordError: final.json could not be written; the run then counts as interrupted.
        """
        if outcome not in OUTCOMES:
            raise ValueError(f"outcome is {outcome!r}, expected one of {', '.join(OUTCOMES)}")
        with self._lock:
            if self._final is not None:
                return self._final
            if not self._closed:
                for stream in self._streams.values():
                    with contextlib.suppress(RecordError):
                        self._end_segment(stream)
            self._closed = True
            files = {"run.json": self._known, **self._disk.close(self.on_wait)}
            self._close_ahead(True)
            final = self._summary(outcome, files, summary)
            try:
                write_sealed(self.folder / "final.json", final, True)
            except OSError as error:
                with contextlib.suppress(OSError):
                    os.unlink(self.folder / "final.json.partial")
                raise disk_error(self.folder, "final.json cannot be written", error) from error
            self._disk.written.close(True)
            self._final = final
            return final

    def abandon(self) -> None:
        """Close the files without final.json; the run then counts as interrupted."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._disk.close()
                self._close_ahead(False)
                self._disk.written.close(False)

    def _close_ahead(self, finished: bool) -> None:
        for stream in self._streams.values():
            if stream.ahead_file is not None:
                if finished:
                    self._disk.written.gone(ahead_name(stream.schema.name))
                stream.ahead_file.close(finished)
                stream.ahead_file = None

    def _summary(
        self, outcome: str, files: dict[str, Any], summary: dict[str, Any]
    ) -> dict[str, Any]:
        failed = self._disk.failed
        final: dict[str, Any] = {
            "schema": SCHEMA,
            "run_id": self.run_id,
            "outcome": "faulted" if failed and outcome == "clean" else outcome,
            "ended": {
                "utc": _utc(self._clock.wall_ns()),
                "t_ns": self._clock.now_ns() - self._start_ns,
            },
            "rows": {name: s.rows for name, s in sorted(self._streams.items())},
            "frames": max(0, self._frames.n - 1),
            "events": self._events,
        }
        if failed:
            final["write_failure"] = {
                "what": str(failed),
                "discarded_bytes": self._disk.discarded_bytes,
            }
        taken = sorted(set(summary) & {*final, "files", "crc"})
        if taken:
            final["summary"] = {k: summary.pop(k) for k in taken}
        return {**final, **summary, "files": files}

    def _put_chunk(self, at: _Indexed, data: bytes, fields: str, end: bool = False) -> None:
        self._disk.put(at.file, data, end=end)
        self._disk.put(at.index, index_line(at.n, at.file, at.offset, data, fields))
        at.offset += len(data)
        at.n += 1

    def _end_segment(self, stream: _Stream) -> None:
        if stream.file:
            self._put_chunk(stream, END_OF_STREAM, '"chunk":"end"', end=True)
            stream.file = ""


def _utc(wall_ns: int) -> str:
    return datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _checked_name(name: str) -> str:
    if not _NAME.match(name) or len(name) > LONGEST_NAME:
        what = f"use up to {LONGEST_NAME} letters, digits, - and _"
        raise ValueError(f"{name[:100]!r} cannot be a file name; {what}")
    return name
