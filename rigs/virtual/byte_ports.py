"""Byte lines of a served bench: pseudo-terminals, or TCP where there are none."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path
from typing import Protocol

LOOPBACK = "127.0.0.1"


class Port(Protocol):
    """One end of a byte line that a client may open and leave at will."""

    address: str

    def read(self) -> bytes:
        """What came, without waiting."""
        ...

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost, as on a wire."""
        ...

    def close(self) -> None:
        """Let go."""
        ...


class PtyPort:
    """A pseudo-terminal under a stable name."""

    def __init__(self, link: Path) -> None:
        import tty

        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._slave))
        self._link = link
        self.address = str(link)

    def _waiting(self) -> bool:
        """Whether bytes are there: a read without any waits for a thread of the kernel."""
        import fcntl
        import termios

        return fcntl.ioctl(self._master, termios.FIONREAD, bytes(4)) != bytes(4)

    def read(self) -> bytes:
        """What came, without waiting."""
        try:
            return os.read(self._master, 65536) if self._waiting() else b""
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost."""
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._master, data)

    def close(self) -> None:
        """Let go."""
        self._link.unlink(missing_ok=True)
        for fd in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(fd)


class LoopbackServer:
    """A loopback TCP socket that one client at a time may connect to; the newest one stays.

    Args:
        scheme: what the address begins with.
    """

    def __init__(self, scheme: str) -> None:
        self._server = socket.create_server((LOOPBACK, 0))
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self.address = f"{scheme}{LOOPBACK}:{self._server.getsockname()[1]}"

    def _accept(self) -> bool:
        """Take a client that waits, without waiting for one; whether there is a new one."""
        with contextlib.suppress(BlockingIOError, OSError):
            client, _ = self._server.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._drop()
            self._client = client
            return True
        return False

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def close(self) -> None:
        """Let go."""
        self._drop()
        self._server.close()


class TcpPort(LoopbackServer):
    """Bytes over a loopback socket."""

    def __init__(self) -> None:
        super().__init__("socket://")

    def read(self) -> bytes:
        """What came, without waiting."""
        self._accept()
        if self._client is None:
            return b""
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost."""
        if self._client is not None:
            try:
                self._client.send(data)
            except BlockingIOError:
                pass  # nobody reads
            except OSError:
                self._drop()
