"""Byte links: a port by its name (see :mod:`daq.link.ports`), or memory.

A link returns received bytes as chunks with the host's monotonic time. It never blocks on reading,
and reports every loss of a port as one :class:`~daq.errors.LinkLost`.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from daq.clock import Clock
from daq.errors import LinkLost, PamrigError
from daq.link.acquisition import Acquisition
from daq.link.ports import UNPLUGGED, open_port, port_failures

BUFFER_BYTES = 4 << 20


class Chunk(NamedTuple):
    """The bytes of one read, and the time of the read (host monotonic, ns)."""

    host_ns: int
    data: bytes


class Link(Protocol):
    """A byte link to one device."""

    @property
    def name(self) -> str:
        """Port or device name for messages."""
        ...

    def read(self) -> list[Chunk]:
        """All bytes since the last call; does not wait. Raises LinkLost after the last bytes."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of ``data``. Raises LinkLost."""
        ...

    def close(self) -> None:
        """Close the link; may be repeated."""
        ...


class _Inbox:
    """Bounded receive buffer; it drops the oldest chunks on overflow and counts them."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._chunks: deque[Chunk] = deque()
        self._held = 0
        self._lock = threading.Lock()
        self.overruns = 0
        self.lost_bytes = 0
        self.error: PamrigError | None = None

    def put(self, chunk: Chunk) -> None:
        with self._lock:
            self._chunks.append(chunk)
            self._held += len(chunk.data)
            while self._held > self._limit:
                dropped = self._chunks.popleft()
                self._held -= len(dropped.data)
                self.lost_bytes += len(dropped.data)
                self.overruns += 1

    def take(self) -> list[Chunk]:
        if not self._chunks:
            if self.error is not None and not self._chunks:
                raise self.error
            return []
        with self._lock:
            chunks = list(self._chunks)
            self._chunks.clear()
            self._held = 0
        return chunks


class MemoryLink:
    """One end of an in-process link; see :func:`memory_pair`."""

    def __init__(self, name: str, clock: Clock, limit_bytes: int) -> None:
        self.name = name
        self._clock = clock
        self._inbox = _Inbox(limit_bytes)
        self._peer: MemoryLink | None = None
        self._closed = False

    @property
    def overruns(self) -> int:
        """Number of chunks dropped because they were not read in time."""
        return self._inbox.overruns

    def read(self) -> list[Chunk]:
        """See :class:`Link`."""
        if self._closed:
            raise LinkLost(self.name, "the link is closed", UNPLUGGED)
        return self._inbox.take()

    def write(self, data: bytes) -> None:
        """See :class:`Link`; the data arrive at once."""
        peer = self._peer
        if peer is None or self._closed:
            raise LinkLost(self.name, f"{len(data)} bytes could not be sent: unplugged", UNPLUGGED)
        if data:
            peer._inbox.put(Chunk(self._clock.now_ns(), bytes(data)))

    def close(self) -> None:
        """See :class:`Link`; the other end loses its link."""
        self._closed = True
        self.unplug()

    def unplug(self) -> None:
        """Simulate an unplugged cable: received data remain readable, then both ends are lost."""
        peer, self._peer = self._peer, None
        self._inbox.error = LinkLost(self.name, "the device was unplugged", UNPLUGGED)
        if peer is not None:
            peer.unplug()


def memory_pair(clock: Clock, name: str) -> tuple[MemoryLink, MemoryLink]:
    """Two connected ends, ``(host_end, device_end)``."""
    host = MemoryLink(name, clock, BUFFER_BYTES)
    device = MemoryLink(f"{name} (device end)", clock, BUFFER_BYTES)
    host._peer, device._peer = device, host
    return host, device


class SerialLink:
    """A port, read by the process of the acquisition, or by a thread where there is none.

    A port whose bytes no descriptor carries (RFC 2217, Windows) is always read by a thread.

    Args:
        path: its name: ``/dev/serial/by-id/...``, ``COM3``, ``socket://host:port``,
            ``rfc2217://host:port``.
        baud: bits per second.
        clock: time stamps of chunks, right after the read.
        buffer_bytes: limit of unread data; beyond it the oldest data are dropped.
        acquisition: the process that reads ports; its clock is the machine's monotonic clock.

    Attributes:
        beats: whether the link sends heartbeat frames by itself; see :meth:`keep_alive`.

    Raises:
        PortError: the port is missing, in use, or access is denied.
    """

    def __init__(
        self,
        path: str,
        baud: int,
        clock: Clock,
        buffer_bytes: int = BUFFER_BYTES,
        acquisition: Acquisition | None = None,
    ) -> None:
        self.name = path
        self._clock = clock
        self._failures = port_failures()
        self._inbox = _Inbox(buffer_bytes)
        self._write_lock = threading.Lock()
        self._stop = threading.Event()
        self._closed = False
        self._beaten: deque[tuple[int, int]] = deque(maxlen=4096)
        self._port = open_port(path, baud)
        self._thread: threading.Thread | None = None
        self._acquisition = acquisition
        descriptor = self._port.descriptor() if acquisition is not None else None
        self.beats = descriptor is not None
        if acquisition is not None and descriptor is not None:
            self._number = acquisition.add(descriptor, self)
            return
        self._thread = threading.Thread(target=self._read_loop, name=f"read {path}", daemon=True)
        self._thread.start()

    @property
    def overruns(self) -> int:
        """Number of chunks dropped because they were not read in time."""
        return self._inbox.overruns

    @property
    def lost_bytes(self) -> int:
        """Number of bytes in those chunks."""
        return self._inbox.lost_bytes

    def read(self) -> list[Chunk]:
        """See :class:`Link`."""
        return self._inbox.take()

    def write(self, data: bytes) -> None:
        """See :class:`Link`; a device that accepts no data for 0.2 s counts as lost."""
        if self._inbox.error is not None:
            raise self._inbox.error
        try:
            with self._write_lock:
                sent = self._port.write(data)
        except self._failures as error:
            raise self._lost(f"{len(data)} bytes could not be sent", error) from error
        if sent < len(data):
            raise self._lost(f"accepted {sent} of {len(data)} bytes", None)

    # ---- heartbeat ------------------------------------------------------------------

    def queue_beats(self, period_ns: int, frames: Sequence[tuple[int, bytes]]) -> None:
        """Further heartbeat frames with their numbers; only where :attr:`beats` is true."""
        assert self._acquisition is not None
        self._acquisition.frames(self._number, period_ns, frames)

    def keep_alive(self, until_ns: int) -> None:
        """Until when the frames may be sent, one each period; 0 stops them at once."""
        assert self._acquisition is not None
        self._acquisition.keep_alive(self._number, until_ns)

    def take_beats(self) -> list[tuple[int, int]]:
        """Number and time of each frame that was sent since the last call.

        A frame is listed before anything that the device sent after it can be read.
        """
        return [self._beaten.popleft() for _ in range(len(self._beaten))]

    # ---- called by the acquisition --------------------------------------------------

    def received(self, host_ns: int, data: bytes) -> None:
        """See :class:`daq.link.acquisition.Receiver`."""
        self._inbox.put(Chunk(host_ns, data))

    def beaten(self, identity: int, sent_ns: int) -> None:
        """See :class:`daq.link.acquisition.Receiver`."""
        self._beaten.append((identity, sent_ns))

    def failed(self, why: str) -> None:
        """See :class:`daq.link.acquisition.Receiver`."""
        self._lost(why, None)

    # ---------------------------------------------------------------------------------

    def close(self) -> None:
        """See :class:`Link`."""
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        if self._thread is not None:
            self._thread.join(2.0)
        elif self._acquisition is not None:
            self._acquisition.drop(self._number)
        with contextlib.suppress(*self._failures):
            self._port.close()
        if self._inbox.error is None:
            self._inbox.error = LinkLost(self.name, "the port is closed", "open it again")

    def _read_loop(self) -> None:
        while not self._stop.is_set():
            try:
                data = self._port.take()
            except self._failures as error:
                self._lost("no more bytes can be received", error)
                return
            if data:
                self._inbox.put(Chunk(self._clock.now_ns(), data))

    def _lost(self, what: str, error: Exception | None) -> LinkLost:
        text = f"{what}: {error}" if error else what
        lost = LinkLost(self.name, text, UNPLUGGED)
        if self._inbox.error is None and not self._stop.is_set():
            self._inbox.error = lost
        return lost
