"""Reads a recorded run; only data with a correct CRC are used."""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.calibration import Calibration
from daq.errors import RecordError
from daq.link.transport import Chunk
from daq.record.ahead import AheadRows
from daq.record.chunks import ChunkIndex, Entry, Problem, drop_implausible_rows
from daq.record.runname import run_tag
from daq.record.safe_read import LARGEST_BULK, read_inside, read_part
from daq.record.sealed import open_file, read_lines
from daq.record.segments import DECODE_ERRORS, BatchDecoder, Columns, StreamSchema
from daq.store.annotations import annotations_differ
from daq.store.belongs import EVENTS, Belonging, belonging
from daq.store.tablefile import read_parquet
from daq.store.validate import structure_error

if TYPE_CHECKING:
    import pandas as pd

INTERRUPTED = "interrupted"
DAMAGED = "damaged"
DERIVED = "derived"
PARTIAL = "derived.partial"
"""Folder of derived files until they are complete."""
_STRANGE = "a file was exchanged, edited or cut off: `pamrig runs verify` lists all; restore it"


def open_run(path: Path | str, pictures: Mapping[str, Any] | None = None) -> Run:
    """Open the run in folder ``path``, or the run that the file ``path`` belongs to.

    Args:
        path: of the run.
        pictures: other settings for its pictures, see :class:`Run`.

    Raises:
        RecordError: there is no run.
    """
    folder = Path(path)
    if folder.is_file():
        folder = folder.parent
    if not (folder / "run.json").is_file():
        what = "no such folder" if not folder.exists() else "not a run: it contains no run.json"
        raise RecordError(str(path), what, "pamrig runs list shows all runs")
    return Run(folder, pictures)


class Run:
    """One run folder; its parts are read on demand and kept.

    Attributes:
        folder: path of the run folder.
        pictures: settings for a derived version (:mod:`daq.store.versions`) that take the place
            of those in run.json: ``camera``, members of its table ``camera``, and ``length_mm``,
            a calibration. None for the run as it was recorded.
        problems: damage found so far; :func:`daq.store.verify.verify` checks everything.
    """

    def __init__(self, folder: Path, pictures: Mapping[str, Any] | None = None) -> None:
        self.folder = folder
        self.pictures = dict(pictures) if pictures else None
        self.problems: list[Problem] = []
        self._samples: dict[str, Columns] = {}
        self._lost: dict[str, list[tuple[int, int]]] = {}

    @property
    def run_id(self) -> str:
        """Name of the run: the name of its folder."""
        return self.folder.resolve().name

    # -- metadata --------------------------------------------------------------

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """The data known before the run.

        Raises:
            RecordError: run.json is damaged, so its calibrations cannot be trusted; or it, or
                final.json, belongs to another run.
        """
        found = self.run_json
        if found is None:
            wrong = [p.what for p in self.problems if p.file == "run.json"]
            raise RecordError(
                str(self.folder / "run.json"),
                f"{wrong[-1] if wrong else 'missing'}; calibrations and parameters are unreliable",
                "restore the file from a copy; samples, events and frames can still be read",
            )
        for name, why in self.belonging.strangers.items():
            raise RecordError(str(self.folder / name), why, _STRANGE)
        return _with_pictures(found, self.pictures) if self.pictures else found

    @cached_property
    def run_json(self) -> dict[str, Any] | None:
        """Members of run.json as found, for lists and checks; None if damaged."""
        return self.sealed("run.json")

    @cached_property
    def belonging(self) -> Belonging:
        """Which of the files belong to this run."""
        return belonging(self.folder, self.run_json, self.final)

    @property
    def version(self) -> int:
        """Version of the record's format."""
        return self.belonging.version

    def refuse_stranger(self, name: str) -> None:
        """Check that an index, or the events, belongs to this run.

        Raises:
            RecordError: it belongs to another one.
        """
        why = self.belonging.stranger(name)
        if why:
            raise RecordError(str(self.folder / name), f"{why}; not read", _STRANGE)

    @cached_property
    def final(self) -> dict[str, Any] | None:
        """The summary at the end of the run; None if the run was interrupted or it is damaged."""
        return self.sealed("final.json")

    @property
    def outcome(self) -> str:
        """``clean``, ``stopped``, ``aborted``, ``faulted``, ``interrupted`` or ``damaged``."""
        if not os.path.lexists(self.folder / "final.json"):
            return INTERRUPTED
        outcome = self.final.get("outcome") if self.final is not None else None
        known = isinstance(outcome, str) and not self.belonging.strangers
        return str(outcome) if known else DAMAGED

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """All valid events in order, each with ``n``, ``t_ns`` and ``kind``.

        Raises:
            RecordError: the file belongs to another run.
        """
        events: list[dict[str, Any]] = []
        path = self.folder / EVENTS
        self.refuse_stranger(path.name)
        data = read_inside(self.folder, path.name) if os.path.lexists(path) else b""
        expected = 0
        tag = run_tag(self.belonging.run_id) if self.version > 1 else ""
        for line in read_lines(data):
            if line.offset == 0 and line.fields and "events" in line.fields:
                continue  # the first line of format 2 names the run
            if line.fields is None:
                what = "last line is torn" if line.torn else "line does not match its CRC"
                at = Problem(path.name, line.offset, what + ", not read", len(line.raw), line.torn)
                self.problems.append(at)
                continue
            n = line.fields.get("n")
            if tag and line.fields.pop("run", None) != tag:
                what = "the CRC of the line is correct, but it is of another run; not read"
                self.problems.append(Problem(path.name, line.offset, what, len(line.raw)))
                continue
            if type(n) is not int or type(line.fields.get("kind")) is not str:
                what = "the CRC of the line is correct, but it is not an event"
                self.problems.append(Problem(path.name, line.offset, what, len(line.raw)))
                continue
            if n != expected:
                what = f"events {expected} to {n - 1} are missing or damaged"
                self.problems.append(Problem(path.name, line.offset, what))
            expected = n + 1
            events.append(line.fields)
        return events

    def calibration(self, quantity: str) -> Calibration:
        """The calibration of ``quantity``, such as ``pressure_kpa``, during the run.

        Raises:
            RecordError: run.json is damaged or has no such calibration.
        """
        found = self.calibrations.get(quantity)
        if found is None:
            there = ", ".join(self.calibrations) or "none"
            raise RecordError(
                str(self.folder / "run.json"),
                f"no calibration of {quantity}; there: {there}",
                "the run was recorded without it; only raw readings are available",
            )
        return found

    @cached_property
    def calibrations(self) -> dict[str, Calibration]:
        """All calibrations of the run by quantity."""
        given = self.manifest.get("calibrations", {})
        listed = given.values() if isinstance(given, dict) else given
        found = [Calibration.from_dict(g, str(self.folder / "run.json")) for g in listed]
        return {c.quantity: c for c in found}

    @cached_property
    def instrument_calibrations(self) -> dict[str, Calibration]:
        """Calibrations of instruments with their own stream, by the stream's name."""
        where = str(self.folder / "run.json")
        given = self.manifest.get("instrument_calibrations", {})
        return {name: Calibration.from_dict(c, where) for name, c in given.items()}

    # -- samples -------------------------------------------------------------

    @cached_property
    def streams(self) -> list[str]:
        """Names of the recorded streams."""
        found = sorted((self.folder / "samples").glob("*.index.jsonl"))
        return [p.name.removesuffix(".index.jsonl") for p in found]

    def samples(self, stream: str) -> Columns:
        """Raw columns of a stream; only rows whose bytes are unchanged.

        Lost rows are absent. Select rows by ``seq`` or ``row`` (:meth:`between`), not by
        position.

        Raises:
            RecordError: there is no such stream, or no part of it is readable.
        """
        if stream not in self._samples:
            self._load(stream)
        return self._samples[stream]

    def between(self, stream: str, column: str, low: float, high: float) -> Columns:
        """The rows with ``low <= column < high``, such as a point's ``valve_seq``."""
        columns = self.samples(stream)
        at = columns[column]
        use = (at >= low) & (at < high)
        return {name: values[use] for name, values in columns.items()}

    def lost_rows(self, stream: str) -> list[tuple[int, int]]:
        """Recorded row ranges (half open) that are not readable any more."""
        self.samples(stream)
        return self._lost[stream]

    def schema(self, stream: str) -> StreamSchema:
        """Columns, dtypes and raw units of a stream.

        Raises:
            RecordError: there is no such stream, or its schema is damaged.
        """
        return self._schema(self.index(stream))

    def index(self, stream: str) -> ChunkIndex:
        """The index of a stream's segments."""
        name = f"samples/{stream}.index.jsonl"
        if not os.path.lexists(self.folder / name):
            there = ", ".join(self.streams) or "none"
            raise RecordError(str(self.folder), f"no stream {stream!r}; there: {there}")
        self.refuse_stranger(name)
        index = ChunkIndex(self.folder, name)
        drop_implausible_rows(index)
        return index

    def _schema(self, index: ChunkIndex) -> StreamSchema:
        try:
            if index.head is not None:
                head = index.head
                return StreamSchema(head["stream"], dict(head["columns"]), dict(head["units"]))
            for data, chunks in index.valid_chunks():
                for chunk in chunks:
                    if chunk.fields["chunk"] == "schema":
                        message = data[chunk.offset : chunk.offset + chunk.length]
                        return StreamSchema.from_message(message)
        except (*DECODE_ERRORS, AttributeError) as error:  # correct CRC, invalid content
            raise RecordError(
                str(self.folder / index.index),
                f"the description of its columns is invalid ({error})",
                "pamrig did not write this record",
            ) from error
        raise RecordError(
            str(self.folder / index.index),
            "its first line and all schema messages are damaged",
            "restore the index from a copy",
        )

    def _load(self, stream: str) -> None:
        index = self.index(stream)
        if index.head is None and not any(e.fields.get("rows") for e in index.entries):
            self.problems.extend(index.problems)
            self._samples[stream], self._lost[stream] = {}, []
            return
        schema = self._schema(index if index.head else self.index(stream))
        drop_implausible_rows(index, schema.row_bytes)
        rows = sum(int(e.fields.get("rows", 0)) for e in index.plausible())
        decoder = BatchDecoder(schema, rows)
        try:
            lost = self.read_rows(index, decoder)
        except DECODE_ERRORS as error:
            raise RecordError(
                str(self.folder / index.index),
                f"its chunks do not match its first line ({error})",
                "their CRC is correct, but pamrig did not write them",
            ) from error
        ahead = self.rows_ahead(index, schema)
        self.problems.extend([*index.problems, *ahead.problems])
        self._lost[stream] = lost + ahead.missing
        batched = decoder.columns()
        self._samples[stream] = (
            {name: np.concatenate([batched[name], ahead.columns[name]]) for name in batched}
            if len(ahead)
            else batched
        )

    def rows_ahead(self, index: ChunkIndex, schema: StreamSchema) -> AheadRows:
        """Rows that a killed run left in its write-ahead file; none in a finished run."""
        rows = [e.fields for e in index.entries if e.fields.get("chunk") == "rows"]
        ends = [f.get("first_row", 0) + f.get("rows", 0) for f in rows]
        folder = self.folder if self.outcome == INTERRUPTED else None
        run_id = self.belonging.run_id if self.version > 1 else ""
        return AheadRows(folder, schema, max(ends, default=0), run_id)

    def read_rows(
        self, index: ChunkIndex, decoder: BatchDecoder | None = None
    ) -> list[tuple[int, int]]:
        """Pass valid rows to ``decoder``; returns lost row ranges, adds damage to the index."""
        lost: list[tuple[int, int]] = []
        end = 0
        for data, chunks in index.valid_chunks():
            rows = [c for c in chunks if c.fields.get("chunk") == "rows"]
            for chunk in rows:
                first = int(chunk.fields["first_row"])
                if first > end:
                    lost.append((end, first))
                end = first + int(chunk.fields["rows"])
            if decoder is not None:
                decoder.feed(data, rows)
        counts = (self.final or {}).get("rows")
        total = counts.get(stream_of(index)) if isinstance(counts, dict) else None
        if isinstance(total, int) and total > end:
            lost.append((end, total))
        for low, high in lost:
            index.problems.append(Problem(index.index, 0, f"rows {low} to {high - 1} are lost"))
        return lost

    # -- frames and wire -----------------------------------------------------

    @cached_property
    def frames(self) -> list[dict[str, Any]]:
        """Metadata of each frame: ``frame`` (its number), ``host_ns`` and more."""
        return [e.fields for e in self._frame_entries.values()]

    def frame_bytes(self, number: int) -> bytes:
        """The encoded image of frame ``number`` as the camera sent it.

        Raises:
            RecordError: there is no such frame, or it is damaged.
        """
        entry = self._frame_entries.get(number)
        if entry is None:
            raise RecordError(str(self.folder), f"no frame {number} (missing or damaged)")
        data = read_part(self.folder, entry.file, entry.offset, entry.length)
        if f"{zlib.crc32(data):08x}" != entry.crc32 or len(data) != entry.length:
            what = f"frame {number} does not match its CRC, not read"
            self.problems.append(Problem(entry.file, entry.offset, what, entry.length))
            raise RecordError(str(self.folder / entry.file), what)
        return data

    @cached_property
    def _frame_entries(self) -> dict[int, Entry]:
        if not os.path.lexists(self.folder / "frames.jsonl"):
            return {}
        self.refuse_stranger("frames.jsonl")
        index = ChunkIndex(self.folder, "frames.jsonl")
        self.problems.extend(index.problems)
        named = [e for e in index.entries if type(e.fields.get("frame")) is int]
        return {e.fields["frame"]: e for e in named}

    def wire(self, device: str) -> list[Chunk]:
        """Raw received bytes of a device with their host times."""
        name = f"wire/{device}.index.jsonl"
        if not os.path.lexists(self.folder / name):
            raise RecordError(str(self.folder), f"the bytes of {device!r} were not recorded")
        self.refuse_stranger(name)
        index = ChunkIndex(self.folder, name)
        found = [
            Chunk(c.fields["host_ns"], data[c.offset : c.offset + c.length])
            for data, chunks in index.valid_chunks()
            for c in chunks
            if type(c.fields.get("host_ns")) is int
        ]
        self.problems.extend(index.problems)
        return found

    # -- derived -------------------------------------------------------------

    @property
    def table(self) -> pd.DataFrame:
        """The reduced table of the run, with units in the column names.

        Raises:
            RecordError: the table does not exist or is damaged.
        """
        import pandas as pd

        for name in ("table.parquet", "table.csv"):
            if (self.folder / "derived" / name).is_file():
                path = self.derived(name)
                return read_parquet(path) if name.endswith("parquet") else pd.read_csv(path)
        raise RecordError(
            str(self.folder), "this run has no table", f"pamrig runs rebuild {self.run_id}"
        )

    def derived(self, name: str, folder: str = DERIVED) -> Path:
        """Path of a derived file, after a check of its CRC.

        Args:
            name: of the file.
            folder: that of the derived files, or of a derived version.

        Raises:
            RecordError: it is missing or damaged, or is not part of the derived files.
        """
        path = self.folder / folder / name
        remedy = f"pamrig runs rebuild {self.run_id}"
        manifest = self.sealed(f"{folder}/manifest.json") or {}
        if manifest and manifest.get("run_id") != self.belonging.run_id:
            raise RecordError(str(path), f"belongs to run {manifest.get('run_id')}", remedy)
        if stale := annotations_differ(self.folder, manifest):
            raise RecordError(str(path), stale, remedy)
        files = manifest.get("files")
        listed = files.get(name) if isinstance(files, dict) else None
        if not isinstance(listed, dict) or not path.is_file():
            raise RecordError(str(path), "missing, or not listed in its manifest", remedy)
        data = read_inside(self.folder, f"{folder}/{name}", LARGEST_BULK)
        if f"{zlib.crc32(data):08x}" != listed.get("crc32") or len(data) != listed.get("size"):
            raise RecordError(str(path), "does not match its CRC", remedy)
        return path

    def sealed(self, name: str) -> dict[str, Any] | None:
        """Members of a sealed file of the run; None if it is missing or damaged."""
        if not os.path.lexists(self.folder / name):
            return None
        try:
            fields = open_file(read_inside(self.folder, name))
            wrong = structure_error(name, fields)
        except RecordError as error:
            fields, wrong = {}, error.what
        except ValueError:
            fields, wrong = {}, "does not match its CRC, not read"
        if wrong:
            self.problems.append(Problem(name, 0, wrong))
            return None
        return fields


def time_s(host_ns: Any, start_ns: int) -> Any:
    """Convert host times to seconds since the start of the run."""
    return (np.asarray(host_ns, dtype=np.int64) - start_ns) * 1e-9


def stream_of(index: ChunkIndex) -> str:
    """Name of the stream of an index."""
    return index.index.removeprefix("samples/").removesuffix(".index.jsonl")


def _with_pictures(manifest: dict[str, Any], pictures: Mapping[str, Any]) -> dict[str, Any]:
    """Members of run.json with other settings for pictures."""
    camera = {**(manifest.get("camera") or {}), **pictures.get("camera", {})}
    calibrations = manifest.get("calibrations", {})
    if (length := pictures.get("length_mm")) is not None:
        if isinstance(calibrations, dict):
            calibrations = {**calibrations, "length_mm": length}
        else:
            others = [c for c in calibrations if c.get("quantity") != "length_mm"]
            calibrations = [*others, length]
    return {**manifest, "camera": camera, "calibrations": calibrations}
