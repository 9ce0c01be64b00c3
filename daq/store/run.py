"""A recorded run as it can be read: only what its CRCs vouch for."""

from __future__ import annotations

import zlib
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.calibration import Calibration
from daq.errors import RecordError
from daq.link.transport import Chunk
from daq.record.ahead import AheadRows
from daq.record.chunks import ChunkIndex, Entry, Problem, only_possible_rows
from daq.record.sealed import open_file, read_lines
from daq.record.segments import NONSENSE, BatchDecoder, Columns, StreamSchema
from daq.record.within import LARGEST_BULK, path_inside, read_inside
from daq.store.shapes import misshapen
from daq.store.tablefile import read_parquet

if TYPE_CHECKING:
    import pandas as pd

INTERRUPTED = "interrupted"
DAMAGED = "damaged"


def open_run(path: Path | str) -> Run:
    """The run in folder ``path`` (or that a file in it belongs to).

    Raises:
        RecordError: there is no run there.
    """
    folder = Path(path)
    if folder.is_file():
        folder = folder.parent
    if not (folder / "run.json").is_file():
        what = "no such folder" if not folder.exists() else "not a run: it holds no run.json"
        raise RecordError(str(path), what, "pamrig runs list shows the runs there are")
    return Run(folder)


class Run:
    """One run folder, read on demand and kept.

    Attributes:
        folder: where it lies.
        problems: damage met so far in what was read; :func:`daq.store.verify.verify` reads all.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.problems: list[Problem] = []
        self._samples: dict[str, Columns] = {}
        self._lost: dict[str, list[tuple[int, int]]] = {}

    @property
    def run_id(self) -> str:
        """Name of the run: that of its folder."""
        return self.folder.resolve().name

    # -- what stands around the data -----------------------------------------

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """What was known before the run.

        Raises:
            RecordError: run.json is damaged, so that its calibrations cannot be trusted.
        """
        found = self.sealed("run.json")
        if found is None:
            raise RecordError(
                str(self.folder / "run.json"),
                "does not match its CRC, so neither calibrations nor parameters can be trusted",
                "restore the file from a copy; samples, events and frames can still be read",
            )
        return found

    @cached_property
    def final(self) -> dict[str, Any] | None:
        """What was summed up at the end; None if the run was interrupted or it is damaged."""
        return self.sealed("final.json")

    @property
    def outcome(self) -> str:
        """``clean``, ``stopped``, ``aborted``, ``faulted``, ``interrupted`` or ``damaged``."""
        if not (self.folder / "final.json").exists():
            return INTERRUPTED
        outcome = self.final.get("outcome") if self.final is not None else None
        return outcome if isinstance(outcome, str) else DAMAGED

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """All sound events in order, each with ``n``, ``t_ns`` and ``kind``."""
        events: list[dict[str, Any]] = []
        path = self.folder / "events.jsonl"
        data = read_inside(self.folder, path.name) if path.exists() else b""
        expected = 0
        for line in read_lines(data):
            torn = line.fields is None and not line.raw.endswith(b"\n")
            if line.fields is None:
                what = "last line is torn" if torn else "line does not match its CRC"
                at = Problem(path.name, line.offset, what + ", not read", len(line.raw), torn)
                self.problems.append(at)
                continue
            n = line.fields.get("n")
            if type(n) is not int or type(line.fields.get("kind")) is not str:
                what = "line is sealed, but is no event"
                self.problems.append(Problem(path.name, line.offset, what, len(line.raw)))
                continue
            if n != expected:
                what = f"events {expected} to {n - 1} are missing or damaged"
                self.problems.append(Problem(path.name, line.offset, what))
            expected = n + 1
            events.append(line.fields)
        return events

    def calibration(self, quantity: str) -> Calibration:
        """The calibration that was in force for ``quantity``, such as ``pressure_kpa``.

        Raises:
            RecordError: run.json has none (or is damaged).
        """
        found = self.calibrations.get(quantity)
        if found is None:
            there = ", ".join(self.calibrations) or "none"
            raise RecordError(
                str(self.folder / "run.json"),
                f"no calibration of {quantity}; there: {there}",
                "the run was recorded without it; only raw readings can be had",
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
        """Calibrations of instruments with a stream of their own, by the stream's name."""
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
        """Columns of a stream, raw, only rows whose bytes are as they were written.

        Rows that were lost are missing, not filled in: address rows by ``seq`` or ``row``
        (:meth:`between`), not by their place in the array.

        Raises:
            RecordError: there is no such stream, or nothing of it can be read.
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
        """Row ranges (half open) that were recorded and cannot be read any more."""
        self.samples(stream)
        return self._lost[stream]

    def schema(self, stream: str) -> StreamSchema:
        """Columns, dtypes and raw units of a stream.

        Raises:
            RecordError: there is no such stream, or nothing sound says what it holds.
        """
        return self._schema(self.index(stream))

    def index(self, stream: str) -> ChunkIndex:
        """The index of a stream's segments."""
        name = f"samples/{stream}.index.jsonl"
        if not (self.folder / name).is_file():
            there = ", ".join(self.streams) or "none"
            raise RecordError(str(self.folder), f"no stream {stream!r}; there: {there}")
        index = ChunkIndex(self.folder, name)
        only_possible_rows(index)
        return index

    def _schema(self, index: ChunkIndex) -> StreamSchema:
        try:
            if index.head is not None:
                head = index.head
                return StreamSchema(head["stream"], dict(head["columns"]), dict(head["units"]))
            for data, chunks in index.sound():
                for chunk in chunks:
                    if chunk.fields["chunk"] == "schema":
                        message = data[chunk.offset : chunk.offset + chunk.length]
                        return StreamSchema.from_message(message)
        except (*NONSENSE, AttributeError) as error:  # sealed, and nonsense
            raise RecordError(
                str(self.folder / index.index),
                f"does not say what its columns are ({error})",
                "pamrig did not write this record so",
            ) from error
        raise RecordError(
            str(self.folder / index.index),
            "neither its first line nor a schema message is sound",
            "restore the index from a copy",
        )

    def _load(self, stream: str) -> None:
        index = self.index(stream)
        if index.head is None and not any(e.fields.get("rows") for e in index.entries):
            self.problems.extend(index.problems)
            self._samples[stream], self._lost[stream] = {}, []
            return
        schema = self._schema(index if index.head else self.index(stream))
        only_possible_rows(index, schema.row_bytes)
        rows = sum(int(e.fields.get("rows", 0)) for e in index.possible())
        decoder = BatchDecoder(schema, rows)
        try:
            lost = self.sound_rows(index, decoder)
        except NONSENSE as error:
            raise RecordError(
                str(self.folder / index.index),
                f"its chunks are not what its first line says ({error})",
                "they are sealed, but pamrig did not write them",
            ) from error
        ahead = self.ahead(index, schema)
        self.problems.extend([*index.problems, *ahead.problems])
        self._lost[stream] = lost + ahead.missing
        batched = decoder.columns()
        self._samples[stream] = (
            {name: np.concatenate([batched[name], ahead.columns[name]]) for name in batched}
            if len(ahead)
            else batched
        )

    def ahead(self, index: ChunkIndex, schema: StreamSchema) -> AheadRows:
        """Rows of a killed run that wait for their batch; none in a finished one."""
        rows = [e.fields for e in index.entries if e.fields.get("chunk") == "rows"]
        ends = [f.get("first_row", 0) + f.get("rows", 0) for f in rows]
        folder = self.folder if self.outcome == INTERRUPTED else None
        return AheadRows(folder, schema, max(ends, default=0))

    def sound_rows(
        self, index: ChunkIndex, decoder: BatchDecoder | None = None
    ) -> list[tuple[int, int]]:
        """Row ranges that are lost; sound rows go to ``decoder``, damage to the index."""
        lost: list[tuple[int, int]] = []
        end = 0
        for data, chunks in index.sound():
            rows = [c for c in chunks if c.fields.get("chunk") == "rows"]
            for chunk in rows:
                first = int(chunk.fields["first_row"])
                if first > end:
                    lost.append((end, first))
                end = first + int(chunk.fields["rows"])
            if decoder is not None:
                decoder.feed(data, rows)
        stream = index.index.removeprefix("samples/").removesuffix(".index.jsonl")
        said = (self.final or {}).get("rows")
        total = said.get(stream) if isinstance(said, dict) else None
        if isinstance(total, int) and total > end:
            lost.append((end, total))
        for low, high in lost:
            index.problems.append(Problem(index.index, 0, f"rows {low} to {high - 1} are lost"))
        return lost

    # -- frames and wire -----------------------------------------------------

    @cached_property
    def frames(self) -> list[dict[str, Any]]:
        """What is known of each frame: ``frame`` (its number), ``host_ns`` and more."""
        return [e.fields for e in self._frame_entries.values()]

    def frame_bytes(self, number: int) -> bytes:
        """The encoded image of frame ``number`` as it came from the camera.

        Raises:
            RecordError: there is no such frame, or it is damaged.
        """
        entry = self._frame_entries.get(number)
        if entry is None:
            raise RecordError(str(self.folder), f"no frame {number} (missing or damaged)")
        path = path_inside(self.folder, entry.file)
        if not path.is_file():
            raise RecordError(str(path), f"frame {number}: its file is missing")
        with open(path, "rb") as file:
            file.seek(entry.offset)
            there = max(0, path.stat().st_size - entry.offset)
            data = file.read(min(entry.length, there, LARGEST_BULK))
        if f"{zlib.crc32(data):08x}" != entry.crc32 or len(data) != entry.length:
            what = f"frame {number} does not match its CRC, not read"
            self.problems.append(Problem(entry.file, entry.offset, what, entry.length))
            raise RecordError(str(self.folder / entry.file), what)
        return data

    @cached_property
    def _frame_entries(self) -> dict[int, Entry]:
        if not (self.folder / "frames.jsonl").exists():
            return {}
        index = ChunkIndex(self.folder, "frames.jsonl")
        self.problems.extend(index.problems)
        named = [e for e in index.entries if type(e.fields.get("frame")) is int]
        return {e.fields["frame"]: e for e in named}

    def wire(self, device: str) -> list[Chunk]:
        """Raw received bytes of a device with their host times."""
        name = f"wire/{device}.index.jsonl"
        if not (self.folder / name).exists():
            raise RecordError(str(self.folder), f"the bytes of {device!r} were not recorded")
        index = ChunkIndex(self.folder, name)
        found = [
            Chunk(c.fields["host_ns"], data[c.offset : c.offset + c.length])
            for data, chunks in index.sound()
            for c in chunks
            if type(c.fields.get("host_ns")) is int
        ]
        self.problems.extend(index.problems)
        return found

    # -- derived -------------------------------------------------------------

    @property
    def table(self) -> pd.DataFrame:
        """The reduced table of the run, units in the names of its columns.

        Raises:
            RecordError: it has not been made, or is not as it was made.
        """
        import pandas as pd

        for name in ("table.parquet", "table.csv"):
            if (self.folder / "derived" / name).is_file():
                path = self.derived(name)
                return read_parquet(path) if name.endswith("parquet") else pd.read_csv(path)
        raise RecordError(
            str(self.folder), "no table was made of this run", f"pamrig runs rebuild {self.run_id}"
        )

    def derived(self, name: str) -> Path:
        """Path of a derived file once its CRC has been checked.

        Raises:
            RecordError: it is missing, damaged, or was not made by a rebuild.
        """
        path = self.folder / "derived" / name
        remedy = f"pamrig runs rebuild {self.run_id}"
        files = (self.sealed("derived/manifest.json") or {}).get("files")
        listed = files.get(name) if isinstance(files, dict) else None
        if not isinstance(listed, dict) or not path.is_file():
            raise RecordError(str(path), "missing, or not vouched for by its manifest", remedy)
        data = read_inside(self.folder, f"derived/{name}", LARGEST_BULK)
        if f"{zlib.crc32(data):08x}" != listed.get("crc32") or len(data) != listed.get("size"):
            raise RecordError(str(path), "does not match its CRC", remedy)
        return path

    def sealed(self, name: str) -> dict[str, Any] | None:
        """Members of a sealed file of the run; None if it is missing or damaged."""
        path = self.folder / name
        if not path.exists():
            return None
        try:
            fields = open_file(read_inside(self.folder, name))
            wrong = misshapen(name, fields)
        except RecordError as error:
            fields, wrong = {}, error.what
        except ValueError:
            fields, wrong = {}, "does not match its CRC, not read"
        if wrong:
            self.problems.append(Problem(name, 0, wrong))
            return None
        return fields


def time_s(host_ns: Any, start_ns: int) -> Any:
    """Host times as seconds since the run's start."""
    return (np.asarray(host_ns, dtype=np.int64) - start_ns) * 1e-9
