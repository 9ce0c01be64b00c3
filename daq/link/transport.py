"""Byte links: serial port, TCP socket, or memory.

The only module that imports ``serial``. A link returns received bytes as chunks with the host's
monotonic time. It never blocks on reading, and reports every loss of a port as one
:class:`~daq.errors.LinkLost`.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import threading
from collections import deque
from typing import Any, NamedTuple, Protocol

from daq.clock import Clock
from daq.errors import LinkLost, PamrigError, PortError

try:
    import termios

    _TERMIOS_ERRORS: tuple[type[Exception], ...] = (termios.error,)
except ImportError:  # Windows
    _TERMIOS_ERRORS = ()

BUFFER_BYTES = 4 << 20
READ_TIMEOUT_S = 0.05
WRITE_TIMEOUT_S = 0.2
READ_BYTES = 65536
UNPLUGGED = "check the cable and the device's power, then start a new run"


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


class _SocketPort:
    """``socket://host:port`` with the required subset of a serial port's methods."""

    def __init__(self, url: str) -> None:
        host, _, port = url.removeprefix("socket://").rstrip("/").rpartition(":")
        if not host or not port.isdigit():
            raise ValueError("expected socket://host:port")
        self._socket = socket.create_connection((host, int(port)), timeout=5.0)
        self._socket.settimeout(READ_TIMEOUT_S)
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def take(self) -> bytes:
        try:
            data = self._socket.recv(READ_BYTES)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionResetError(errno.ECONNRESET, "closed by the other end")
        return data

    def write(self, data: bytes) -> int:
        self._socket.sendall(data)
        return len(data)

    def close(self) -> None:
        self._socket.close()


class _SerialPort:
    """A pyserial port, restricted to the calls that are reliable on all systems."""

    def __init__(self, path: str, baud: int) -> None:
        import serial

        is_url = "://" in path
        options: dict[str, Any] = {} if is_url else {"exclusive": True}
        self._serial: Any = serial.serial_for_url(
            path, baudrate=baud, timeout=READ_TIMEOUT_S, write_timeout=WRITE_TIMEOUT_S, **options
        )
        self._waits = os.name == "posix" and not is_url
        # Best effort: by default, FTDI adapters delay bytes by up to 16 ms.
        with contextlib.suppress(ValueError, OSError, AttributeError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    def take(self) -> bytes:
        waiting = min(self._serial.in_waiting, READ_BYTES)
        return bytes(self._serial.read(max(1, waiting)))

    def write(self, data: bytes) -> int:
        if not self._waits:
            return int(self._serial.write(data) or 0)
        # pyserial checks its time-out after the bytes have gone: a program suspended for 0.2 s
        # would report a lost device. Count only the wait for the port. Call select only when the
        # port is full: for a terminal, select waits for a kernel thread.
        sent, port = 0, self._serial.fileno()
        while sent < len(data):
            with contextlib.suppress(BlockingIOError):
                sent += os.write(port, data[sent:])
            if sent < len(data) and not select.select([], [port], [], WRITE_TIMEOUT_S)[1]:
                raise TimeoutError(f"accepted {sent} bytes, then none for {WRITE_TIMEOUT_S:g} s")
        return sent

    def close(self) -> None:
        self._serial.close()


def _port_failures() -> tuple[type[Exception], ...]:
    """All exceptions that a lost port can raise."""
    import serial

    # pyserial raises TypeError or AttributeError when another thread closes the port.
    return (OSError, serial.SerialException, TypeError, AttributeError, *_TERMIOS_ERRORS)


class SerialLink:
    """A serial port, opened exclusively and read by its own thread.

    Args:
        path: ``/dev/serial/by-id/...``, ``COM3``, or a URL such as ``socket://host:port``.
        baud: bits per second.
        clock: time stamps of chunks, right after the read.
        buffer_bytes: limit of unread data; beyond it the oldest data are dropped.

    Raises:
        PortError: the port is missing, in use, or access is denied.
    """

    def __init__(
        self, path: str, baud: int, clock: Clock, buffer_bytes: int = BUFFER_BYTES
    ) -> None:
        self.name = path
        self._clock = clock
        self._failures = _port_failures()
        self._inbox = _Inbox(buffer_bytes)
        self._write_lock = threading.Lock()
        self._stop = threading.Event()
        self._closed = False
        try:
            socket_url = path.startswith("socket://")
            self._port = _SocketPort(path) if socket_url else _SerialPort(path, baud)
        except self._failures as error:
            raise _not_opened(path, error) from error
        except ValueError as error:
            raise PortError(path, f"not a port: {error}", "correct the path") from error
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

    def close(self) -> None:
        """See :class:`Link`."""
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        self._thread.join(2.0)
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


class ModemLines:
    """The four control lines of an RS-232 port: DTR and RTS (output), CTS and DSR (input).

    Both outputs are off from the moment the port opens. The system switches them off when the
    process ends.

    Raises:
        PortError: the port is missing or in use, or has no control lines.
    """

    def __init__(self, path: str, port: Any = None) -> None:
        import serial

        self.name = path
        self._failures = _port_failures()
        try:
            if port is None:
                port = serial.Serial(exclusive=True)
                port.port = path
                port.dtr = port.rts = False  # before it opens
                port.open()
            self._port = port
            self.set(False, False)
            self.get()
        except self._failures as error:
            raise _not_opened(path, error) from error

    def set(self, dtr: bool, rts: bool) -> None:
        """Switch both outputs. Raises LinkLost."""
        try:
            self._port.dtr = dtr
            self._port.rts = rts
        except self._failures as error:
            raise LinkLost(self.name, f"control lines are lost: {error}", UNPLUGGED) from error

    def get(self) -> tuple[bool, bool]:
        """Read CTS and DSR. Raises LinkLost."""
        try:
            return bool(self._port.cts), bool(self._port.dsr)
        except self._failures as error:
            raise LinkLost(self.name, f"control lines are lost: {error}", UNPLUGGED) from error

    def close(self) -> None:
        """Switch both outputs off and close; may be repeated."""
        with contextlib.suppress(*self._failures):
            self._port.dtr = self._port.rts = False
        with contextlib.suppress(*self._failures):
            self._port.close()


def list_ports() -> list[str]:
    """The serial ports of this machine, as far as known."""
    try:
        from serial.tools import list_ports as tool

        return sorted(str(p.device) for p in tool.comports())
    except (ImportError, OSError):
        return []


def _not_opened(path: str, error: Exception) -> PortError:
    """Convert the error of a failed open into an error with a remedy."""
    number = getattr(error, "errno", None)
    text = str(error)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFoundError" in text:
        ports = ", ".join(list_ports())
        what = "no such port"
        remedy = "plug the device in or correct the path; "
        remedy += f"available ports: {ports}" if ports else "this machine has no serial port"
    elif number in (errno.EAGAIN, errno.EBUSY) or "PermissionError" in text:
        what = "the port is in use by another program"
        remedy = "close the other program (another pamrig, a terminal, ModemManager) and try again"
    elif number in (errno.EACCES, errno.EPERM):
        what = "no permission to open the port"
        remedy = "join the group that owns it (dialout or uucp: sudo usermod -aG dialout $USER), "
        remedy += "then log in again"
    elif number == errno.ECONNREFUSED:
        what = "nothing listens at this address"
        remedy = "start the bench, or correct the address"
    else:
        what, remedy = f"cannot be opened: {text}", "check the path and the device"
    return PortError(path, what, remedy)
