"""Lines of columns: whole ones become rows, everything else is counted."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

from daq.errors import LinkLost
from daq.link.framer import LineFramer
from daq.link.transport import Link
from rigs.devices.faults import Faults
from rigs.rigfile.columns import COUNTER, NUMBER, TIME, TIME_S, ColumnForm

Row = tuple[int, int, float, tuple[float, ...]]
"""Host time in ns of its last byte; how long before that the last bytes had come, in ns; own time
in s (nan without one); the printed numbers of the channels."""
LONGEST_LINE = 200


class ColumnStream:
    """Reads the lines of one controller.

    A row has the time at which it came, the time that the controller printed, and the numbers as
    printed. The first line is dropped: the port may have been opened in its middle.

    Attributes:
        rows: rows since they were taken last.
        faults: everything that came and was no row.
        restarted: whether its own time ran backwards.
        on_bytes: takes host time and bytes as they come.
    """

    def __init__(self, link: Link, form: ColumnForm) -> None:
        self._link = link
        self._form = form
        self._framer = LineFramer(b"\n")
        self._first = True
        self._before_ns = 0
        self._own_last: float | None = None
        self._turns = 0
        self._confirmed: float | None = None
        self.rows: list[Row] = []
        self.count = 0
        self.faults = Faults()
        self.restarted = False
        self.on_bytes: Callable[[int, bytes], None] | None = None

    @property
    def name(self) -> str:
        """Device and port, for messages."""
        return f"{self._form.name} on {self._link.name}"

    def poll(self) -> None:
        """Read what came.

        Raises:
            LinkLost: counted, and for the caller to end the recording.
        """
        try:
            chunks = self._link.read()
        except LinkLost as error:
            if not self.faults.counts.get("unplugged"):
                self.faults.add("unplugged", error.what)
            raise
        for chunk in chunks:
            if self.on_bytes is not None:
                self.on_bytes(chunk.host_ns, chunk.data)
            waited_ns = chunk.host_ns - self._before_ns if self._before_ns else 0
            for raw in self._framer.feed(chunk.data):
                self._line(raw, chunk.host_ns, waited_ns)
            self._before_ns = chunk.host_ns

    def finish(self) -> None:
        """Nothing more is waited for: what has begun to come is half a line."""
        if self._framer.discard():
            self.faults.add("half")

    def send(self, text: str) -> None:
        """Send one line."""
        self._link.write(text.encode("ascii") + b"\n")

    def confirmed(self) -> float | None:
        """The set-point that was confirmed since this was asked last."""
        value, self._confirmed = self._confirmed, None
        return value

    def _line(self, raw: bytes, host_ns: int, waited_ns: int) -> None:
        if self._first:
            self._first = False
            return
        try:
            line = raw.decode("ascii").strip("\r\n")
        except UnicodeDecodeError:
            self.faults.add("damaged", repr(raw[:LONGEST_LINE]))
            return
        if not line.strip():
            return
        body = self._checked(line)
        if body is None:
            return
        if self._is_confirmation(body) or body.startswith("#"):
            return
        cells = body.split() if self._form.delimiter == " " else body.split(self._form.delimiter)
        numbers = [cell.strip() for cell in cells]
        if len(numbers) != len(self._form.columns) or not all(map(NUMBER.fullmatch, numbers)):
            comma = self._form.delimiter != "," and "," in body
            self.faults.add("comma" if comma else "damaged", repr(line[:LONGEST_LINE]))
            return
        values = dict(zip(self._form.columns, map(float, numbers), strict=True))
        own_s = self._own_s(values.pop(TIME)) if TIME in values else float("nan")
        if own_s is None:
            return
        for name, value in values.items():
            calibration = self._form.calibrations[name]
            low, high = calibration.domain
            if not low <= float(calibration.apply(value)) <= high:
                self.faults.add("range", f"{name} in {line!r}")
                return
        self.rows.append((host_ns, waited_ns, own_s, tuple(values.values())))
        self.count += 1

    def _checked(self, line: str) -> str | None:
        """The line without its checksum; None where that is wrong or missing."""
        if not self._form.checksum:
            return line
        body, star, digits = line.rpartition("*")
        total = reduce(lambda a, b: a ^ ord(b), body, 0)
        if not star or digits.strip().upper() != f"{total:02X}":
            self.faults.add("checksum", repr(line[:LONGEST_LINE]))
            return None
        return body

    def _is_confirmation(self, body: str) -> bool:
        setpoint = self._form.setpoint
        match = setpoint.confirm.fullmatch(body) if setpoint and setpoint.confirm else None
        if match is None:
            return False
        if NUMBER.fullmatch(match["value"]):
            self._confirmed = float(match["value"])
        else:
            self.faults.add("damaged", repr(body[:LONGEST_LINE]))
        return True

    def _own_s(self, printed: float) -> float | None:
        """Own time in s without overflow; None for one that repeats or runs backwards."""
        unit = TIME_S[self._form.time_unit]
        whole = self._form.time_unit != "s"
        value = printed + (self._turns * COUNTER if whole else 0)
        last = self._own_last
        if last is not None and value <= last:
            if whole and last - value > 0.9 * COUNTER:
                self._turns += 1
                value += COUNTER
            elif value == last:
                self.faults.add("stale", f"time {printed:g} twice")
                return None
            else:
                self.faults.add("restarted", f"time {printed:g} after {last:g}")
                self.restarted = True
                return None
        self._own_last = value
        return value * unit
