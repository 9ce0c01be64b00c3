"""Line-based instruments: send a request, wait for its answer, keep the rest for others."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from daq.errors import DeviceTimeout, LinkLost
from daq.link.framer import LineFramer
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.faults import Faults


class LineDevice:
    """Shared plumbing of instruments that speak in lines.

    A line that ``on_line`` claims (returns True) is not offered to a waiting request, so a
    stream of readings cannot be taken for an answer.
    """

    def __init__(self, link: Link, event_loop: EventLoop, kind: str, end: bytes = b"\r\n") -> None:
        self._link = link
        self._event_loop = event_loop
        self._framer = LineFramer(b"\n")  # CR is stripped: some devices send LF alone
        self._end = end
        self._lines: deque[str] = deque(maxlen=256)
        self.kind = kind
        self.bad_lines = 0
        self.faults = Faults()
        self._lost = False
        self.on_bytes: Callable[[int, bytes], None] | None = None

    @property
    def name(self) -> str:
        """Where the instrument is, for messages."""
        return f"{self.kind} on {self._link.name}"

    def on_line(self, line: str, host_ns: int) -> bool:
        """Take an unsolicited line; True when it is one. Drivers override this."""
        del line, host_ns
        return False

    def poll(self) -> None:
        """Read what has come.

        Raises:
            LinkLost: once; the other devices go on being read after that (a bench that lost
                its balance must still see its pressure fall).
        """
        if self._lost:
            return
        try:
            chunks = self._link.read()
        except LinkLost as error:
            self._count_loss(error)
            raise
        for chunk in chunks:
            if self.on_bytes is not None:
                self.on_bytes(chunk.host_ns, chunk.data)
            for raw in self._framer.feed(chunk.data):
                try:
                    line = raw.decode("ascii").strip()
                except UnicodeDecodeError:
                    self.bad_lines += 1
                    self.faults.add("damaged", repr(raw))
                    continue
                if line and not self.on_line(line, chunk.host_ns):
                    self._lines.append(line)

    def _count_loss(self, error: LinkLost) -> None:
        if not self._lost:
            self._lost = True
            self.faults.add("unplugged", error.what)

    def send(self, text: str) -> None:
        """Send one line."""
        self.send_raw(text.encode("ascii") + self._end)

    def send_raw(self, data: bytes) -> None:
        """Send bytes as they are (single-character commands)."""
        try:
            self._link.write(data)
        except LinkLost as error:
            self._count_loss(error)
            raise

    def request(self, text: str, accept: Callable[[str], bool], seconds: float = 1.0) -> str:
        """Send ``text`` and return the first line that ``accept`` takes as its answer.

        Lines that came before the question are stale and thrown away.

        Raises:
            DeviceTimeout: no such line in time; names what came instead.
        """
        self._lines.clear()
        if text:
            self.send(text)
        return self.wait_line(accept, text, seconds)

    def wait_line(self, accept: Callable[[str], bool], asked: str, seconds: float) -> str:
        """Wait for a line that ``accept`` takes; see :meth:`request`."""
        found: list[str] = []
        other: list[str] = []

        def look() -> bool:
            while self._lines:
                line = self._lines.popleft()
                (found if accept(line) else other).append(line)
                if found:
                    return True
            return False

        if self._event_loop.until(look, seconds):
            return found[0]
        raise DeviceTimeout(
            self.name,
            f"no answer to {asked!r} within {seconds:g} s"
            + (f"; got {other[-1]!r} instead" if other else ""),
            "check port, cable, baud rate and power",
        )

    @property
    def midway(self) -> bool:
        """Whether a line has begun to come whose end has not."""
        return bool(self._framer.partial)

    def finish(self) -> None:
        """Nothing more is waited for: what has begun to come is half a line, and counted."""
        if self._framer.discard():
            self.faults.add("half")

    def counters(self) -> dict[str, int]:
        """Everything that was lost or refused on the link so far."""
        framer = self._framer
        return {
            "lines": framer.frames,
            "bad_lines": self.bad_lines,
            "oversize": framer.oversize,
            "dropped_bytes": framer.dropped_bytes,
            **self.faults.counts,
        }
