"""Servers of serial ports on loopback TCP: RFC 2217 with pyserial's own parts, and a raw bridge."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from typing import Any

import serial
import serial.rfc2217

LOOPBACK = "127.0.0.1"


class NoModemLines(serial.Serial):
    """A port without modem lines, as a pseudo-terminal is."""

    cts = dsr = ri = cd = False

    def _update_dtr_state(self) -> None:
        pass

    _update_rts_state = _update_dtr_state


class SerialServer:
    """Serves one serial port to one client at a time.

    Args:
        path: the port, or "loop://" for one that sends back what it gets.
        rfc2217: with the protocol that sets the port, or raw.
    """

    def __init__(self, path: str, rfc2217: bool) -> None:
        loop = path.startswith("loop://")
        self.serial: Any = (
            serial.serial_for_url(path, timeout=0) if loop else NoModemLines(path, timeout=0)
        )
        self._rfc2217 = rfc2217
        self._server = socket.create_server((LOOPBACK, 0))
        self._clients: list[socket.socket] = []
        self._stop = threading.Event()
        scheme = "rfc2217" if rfc2217 else "socket"
        self.address = f"{scheme}://{LOOPBACK}:{self._server.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        self._server.settimeout(0.05)
        while not self._stop.is_set():
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            self._clients.append(client)
            with contextlib.suppress(OSError), client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._talk(client)

    def _talk(self, client: socket.socket) -> None:
        class Connection:
            write = staticmethod(client.sendall)

        manager = serial.rfc2217.PortManager(self.serial, Connection()) if self._rfc2217 else None
        while not self._stop.is_set():
            if select.select([client], [], [], 0.001)[0]:
                data = client.recv(4096)
                if not data:
                    return
                self.serial.write(b"".join(manager.filter(data)) if manager is not None else data)
            data = self.serial.read(4096)
            if data:
                client.sendall(b"".join(manager.escape(data)) if manager is not None else data)

    def cut(self) -> None:
        """End every connection, as a server does that loses its power."""
        for client in self._clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Serve no more."""
        self._stop.set()
        self.cut()
        self._thread.join(10)
        self._server.close()
        self.serial.close()
