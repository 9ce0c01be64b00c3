"""Opens a port by its name: a serial device, a raw TCP socket, or a port of an RFC 2217 server.

The only module that imports ``serial``.

| Name | What is opened |
|---|---|
| ``/dev/serial/by-id/...``, ``COM3`` | a serial port of this computer, for this program alone |
| ``socket://host:port`` | raw bytes over TCP; the server sets the baud rate |
| ``rfc2217://host:port`` | a serial port of a server; the baud rate is negotiated |
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol
from urllib.parse import urlsplit

from daq.errors import LinkLost, PortError

try:
    import termios

    _TERMIOS_ERRORS: tuple[type[Exception], ...] = (termios.error,)
except ImportError:  # Windows
    _TERMIOS_ERRORS = ()

READ_TIMEOUT_S = 0.05
WRITE_TIMEOUT_S = 0.2
CONNECT_TIMEOUT_S = 5.0
READ_BYTES = 65536
UNPLUGGED = "check the cable and the device's power, then start a new run"
KINDS = "a device of this computer, socket://host:port or rfc2217://host:port"


class Port(Protocol):
    """An open port. Each call may raise one of :func:`port_failures`."""

    def descriptor(self) -> int | None:
        """File descriptor at which the port's bytes can be read and written; None without one."""
        ...

    def take(self) -> bytes:
        """The bytes that came; waits up to ``READ_TIMEOUT_S`` for the first."""
        ...

    def write(self, data: bytes) -> int:
        """Send; returns how many bytes the port accepted."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


def open_port(name: str, baud: int) -> Port:
    """Open a port by its name.

    Raises:
        PortError: the name is none, or the port is missing, in use or not to be had.
    """
    scheme, url, _ = name.partition("://")
    openers: dict[str, Callable[[str, int], Port]] = {
        "socket": lambda name, baud: _SocketPort(name),
        "rfc2217": _Rfc2217Port,
    }
    if url and scheme not in openers:
        raise PortError(name, f"not a port: unknown kind {scheme!r}", f"use {KINDS}")
    try:
        return (openers[scheme] if url else _SerialPort)(name, baud)
    except _AddressError as error:
        raise PortError(name, f"not a port: {error}", "correct the address") from None
    except port_failures() as error:
        raise not_opened(name, error) from error
    except ValueError as error:
        raise PortError(name, f"not a port: {error}", "correct the path") from error


class _AddressError(ValueError):
    """An address without host or port."""


def _address(url: str) -> tuple[str, int]:
    """Host and port of an address."""
    scheme = url.partition("://")[0]
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port:
        raise _AddressError(f"expected {scheme}://host:port")
    return host, port


def _send_all(send: Callable[[bytes], int], descriptor: int, data: bytes) -> int:
    """Send all bytes; only the wait for a full port counts towards the time-out.

    A program that was suspended meanwhile does not report a lost device. ``select`` is called only
    when the port is full: for a terminal it waits for a kernel thread.
    """
    sent = 0
    while sent < len(data):
        with contextlib.suppress(BlockingIOError):
            sent += send(data[sent:])
        if sent < len(data) and not select.select([], [descriptor], [], WRITE_TIMEOUT_S)[1]:
            raise TimeoutError(f"accepted {sent} bytes, then none for {WRITE_TIMEOUT_S:g} s")
    return sent


class _SocketPort:
    """``socket://host:port``: raw bytes."""

    def __init__(self, url: str) -> None:
        self._socket = socket.create_connection(_address(url), timeout=CONNECT_TIMEOUT_S)
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def descriptor(self) -> int | None:
        return self._socket.fileno() if os.name == "posix" else None

    def take(self) -> bytes:
        if not select.select([self._socket], [], [], READ_TIMEOUT_S)[0]:
            return b""
        data = self._socket.recv(READ_BYTES)
        if not data:
            raise ConnectionResetError(errno.ECONNRESET, "closed by the other end")
        return data

    def write(self, data: bytes) -> int:
        return _send_all(self._socket.send, self._socket.fileno(), data)

    def close(self) -> None:
        self._socket.close()


class _SerialPort:
    """A serial port of this computer, restricted to the calls that are reliable on all systems."""

    def __init__(self, path: str, baud: int) -> None:
        import serial

        self._serial: Any = serial.serial_for_url(
            path,
            baudrate=baud,
            timeout=READ_TIMEOUT_S,
            write_timeout=WRITE_TIMEOUT_S,
            exclusive=True,
        )
        # Best effort: by default, FTDI adapters delay bytes by up to 16 ms.
        with contextlib.suppress(ValueError, OSError, AttributeError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    def descriptor(self) -> int | None:
        return int(self._serial.fileno()) if os.name == "posix" else None

    def take(self) -> bytes:
        waiting = min(self._serial.in_waiting, READ_BYTES)
        return bytes(self._serial.read(max(1, waiting)))

    def write(self, data: bytes) -> int:
        port = self.descriptor()
        if port is None:
            return int(self._serial.write(data) or 0)
        # pyserial checks its time-out after the bytes have gone.
        return _send_all(lambda rest: os.write(port, rest), port, data)

    def close(self) -> None:
        self._serial.close()


class _Rfc2217Port:
    """``rfc2217://host:port``: pyserial's client, which has no write time-out of its own."""

    def __init__(self, url: str, baud: int) -> None:
        import serial

        _address(url)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # how pyserial names its thread
            port: Any = serial.serial_for_url(url, baudrate=baud, timeout=READ_TIMEOUT_S)
        # Its socket waits 5 s otherwise. The reader of the same socket goes on after a time-out.
        port._socket.settimeout(WRITE_TIMEOUT_S)
        self._serial = port

    def descriptor(self) -> int | None:
        return None  # what the socket carries is Telnet

    def take(self) -> bytes:
        waiting = min(self._serial.in_waiting, READ_BYTES)
        return bytes(self._serial.read(max(1, waiting)))

    def write(self, data: bytes) -> int:
        return int(self._serial.write(data) or 0)

    def close(self) -> None:
        self._serial.close()


def port_failures() -> tuple[type[Exception], ...]:
    """All exceptions that a lost port can raise."""
    import serial

    # pyserial raises TypeError or AttributeError when another thread closes the port.
    return (OSError, serial.SerialException, TypeError, AttributeError, *_TERMIOS_ERRORS)


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
        self._failures = port_failures()
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
            raise not_opened(path, error) from error

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


@dataclass(frozen=True)
class PortInfo:
    """A serial port of this computer: its name, what its adapter says, its serial number."""

    name: str
    about: str = ""
    serial: str = ""


def list_ports() -> list[PortInfo]:
    """The serial ports of this machine, as far as known."""
    try:
        from serial.tools import list_ports as tool

        found = tool.comports()
    except (ImportError, OSError):
        return []
    return sorted(
        (PortInfo(str(p.device), _about(p), str(p.serial_number or "")) for p in found),
        key=lambda port: port.name,
    )


def _about(port: Any) -> str:
    words = [str(port.description or "")]
    if port.vid is not None:
        words.append(f"USB {port.vid:04x}:{port.pid:04x}")
    return ", ".join(word for word in words if word and word != "n/a")


def not_opened(path: str, error: Exception) -> PortError:
    """Convert the error of a failed open into an error with a remedy."""
    # pyserial's network client puts its own error in the place of the system's.
    cause = error if isinstance(error, OSError) and error.errno else error.__context__ or error
    number = getattr(cause, "errno", None)
    text = str(error)
    if isinstance(cause, socket.gaierror):
        what, remedy = "no host of this name", "correct the address"
    elif isinstance(cause, TimeoutError):
        what, remedy = "the host does not answer", "check the network and the address"
    elif number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFoundError" in text:
        ports = ", ".join(port.name for port in list_ports())
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
        remedy = "start the bench or the server, or correct the address"
    elif number in (errno.ENETUNREACH, errno.EHOSTUNREACH):
        what, remedy = "the host cannot be reached", "check the network and the address"
    elif "RFC2217" in text:
        what = "the server does not speak RFC 2217, or refuses the settings of the port"
        remedy = "check the server; for raw bytes use socket://host:port"
    else:
        what, remedy = f"cannot be opened: {text}", "check the path and the device"
    return PortError(path, what, remedy)
