"""What strangers do to the door of the live view: crowds, floods, foreign pages, writers.

Only ever against 127.0.0.1, bounded in number and time.
"""

from __future__ import annotations

import contextlib
import resource
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

LOOPBACK = "127.0.0.1"
GRPC_WRITE = (
    b"POST /rerun.sdk_comms.v1alpha1.MessageProxyService/WriteMessages HTTP/1.1\r\n"
    b"Host: 127.0.0.1\r\nContent-Type: application/grpc-web+proto\r\nContent-Length: 100000\r\n\r\n"
)
HTTP2 = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes.fromhex("000000040000000000")
STRANGERS = (
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /view.rrd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /proxy HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    b"GET //view.rrd HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n\r\n",
    b"GET /../view.rrd HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 5000 + b"\r\n",
    b"\x00\xff" * 9000,
    GRPC_WRITE + b"\0" * 100_000,
    HTTP2,
    b"",
)


@dataclass
class Seen:
    """What strangers got: status lines by number, and whatever came with them."""

    connections: int = 0
    statuses: dict[str, int] = field(default_factory=dict)
    content: int = 0

    def add(self, answer: bytes) -> None:
        """Count an answer."""
        self.connections += 1
        head, _, body = answer.partition(b"\r\n\r\n")
        words = head.split()
        status = words[1].decode() if len(words) > 1 else "none"
        self.statuses[status] = self.statuses.get(status, 0) + 1
        self.content += len(body)


def ask(port: int, request: bytes, limit_s: float = 20.0) -> bytes:
    """All that comes back on one connection."""
    parts = []
    try:
        with socket.create_connection((LOOPBACK, port), timeout=limit_s) as connection:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                connection.sendall(request)
                if not request:
                    connection.shutdown(socket.SHUT_WR)
            with contextlib.suppress(ConnectionResetError):
                while part := connection.recv(1 << 16):
                    parts.append(part)
    except (TimeoutError, ConnectionResetError):
        pass
    return b"".join(parts)


@contextlib.contextmanager
def crowd(port: int, count: int) -> Iterator[list[socket.socket]]:
    """Connections that never say anything."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = count + 500
    if soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(wanted, hard), hard))
    held: list[socket.socket] = []
    try:
        for _ in range(count):
            connection = socket.socket()
            connection.setblocking(False)
            connection.connect_ex((LOOPBACK, port))
            held.append(connection)
        yield held
    finally:
        for connection in held:
            connection.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def flood(port: int, count: int, limit_s: float) -> Seen:
    """``count`` requests of strangers one after another, for at most ``limit_s``.

    Ends also when nobody listens any more.
    """
    seen, end = Seen(), time.monotonic() + limit_s
    with contextlib.suppress(ConnectionRefusedError):
        for k in range(count):
            if time.monotonic() > end:
                break
            seen.add(ask(port, STRANGERS[k % len(STRANGERS)]))
    return seen
