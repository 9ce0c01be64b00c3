"""Reads the ports of a bench, and sends its heartbeat, in a process of its own.

A computer that is busy gives a program its turn late, and the more late the more the program
computes. What must not be late, reading, time stamps and the heartbeat, therefore happens in a
process that does nothing else (:mod:`daq.link.port_process`). It gets a higher priority where the
system grants it.

The process beats only while the program has recently reported progress: the program sends the time
until which it may. It stops at once when the program ends, however that happens.
"""

from __future__ import annotations

import array
import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from daq.clock import NS_PER_S
from daq.errors import PamrigError
from daq.link.lateness import Lateness
from daq.link.port_process import (
    ADD,
    ALIVE,
    BEAT,
    BLOCKED,
    DATA,
    DROP,
    DROPPED,
    FRAME,
    FRAMES,
    HEAD,
    HEARTBEAT,
    LATE,
    LOST,
    READY,
)

START_S = 20.0
STOP_S = 2.0
REPORT_NS = 100_000_000
"""From the process comes something at least so often."""
READ_BYTES = 1 << 18
MOST_PORTS = 255
SOCKET_BYTES = 1 << 20


class Receiver(Protocol):
    """What takes the bytes of one port; called from the thread that hears the process."""

    def received(self, host_ns: int, data: bytes) -> None:
        """Bytes came at that time."""
        ...

    def beaten(self, identity: int, sent_ns: int) -> None:
        """A heartbeat frame was sent."""
        ...

    def failed(self, why: str) -> None:
        """The port is lost."""
        ...


def available() -> bool:
    """Whether this system can hand an open port to another process."""
    return os.name == "posix" and hasattr(socket, "send_fds")


class Acquisition:
    """The process, seen from the program that runs the test.

    Attributes:
        priority: what the system granted: "SCHED_FIFO", "nice -10" or "normal".
        lateness: of the thread of the process that beats.
        reading: of the thread that reads.

    Raises:
        PamrigError: the process did not start.
    """

    def __init__(self) -> None:
        self.priority = ""
        self.lateness = Lateness()
        self.reading = Lateness()
        self._blocked_ns = 0
        self._heard_ns = time.monotonic_ns()
        self._receivers: dict[int, Receiver] = {}
        self._dropped: dict[int, threading.Event] = {}
        self._ready = threading.Event()
        self._next = 0
        self._lock = threading.Lock()
        self._closed = False
        self._control, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        with end:
            for one in (self._control, end):
                for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                    with contextlib.suppress(OSError):
                        one.setsockopt(socket.SOL_SOCKET, option, SOCKET_BYTES)
            script = Path(__file__).with_name("port_process.py")
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(script), str(end.fileno()), str(os.getpid())],
                pass_fds=[end.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._thread = threading.Thread(target=self._listen, name="acquisition", daemon=True)
        self._thread.start()
        if not self._ready.wait(START_S) or self._process.poll() is not None:
            self.close()
            raise PamrigError(
                "acquisition", f"its process did not start within {START_S:g} s", "try again"
            )

    def add(self, descriptor: int, receiver: Receiver) -> int:
        """Read a port from now on; returns its number. The descriptor remains the caller's."""
        with self._lock:
            number = self._next = self._next % MOST_PORTS + 1
            self._receivers[number] = receiver
            socket.send_fds(self._control, [HEAD.pack(ADD, number, 0, 0)], [descriptor])
        return number

    def drop(self, number: int) -> None:
        """Read a port no more; returns when the process has let go of it."""
        done = self._dropped.setdefault(number, threading.Event())
        self._tell(DROP, number)
        if threading.current_thread() is not self._thread:
            done.wait(STOP_S)
        self._dropped.pop(number, None)
        self._receivers.pop(number, None)

    def blocked_s(self, now_ns: int) -> float:
        """For how long nothing has been read, by the kernel's or the computer's doing; else 0.

        The process reports every 50 ms. Where it does not, it has no turn either.
        """
        since_ns = self._blocked_ns or self._heard_ns + REPORT_NS
        return max(0.0, (now_ns - since_ns) / NS_PER_S)

    def frames(self, number: int, period_ns: int, frames: Sequence[tuple[int, bytes]]) -> None:
        """Further heartbeat frames with their numbers, one to be sent each period."""
        body = b"".join(FRAME.pack(identity, len(data)) + data for identity, data in frames)
        self._tell(FRAMES, number, period_ns, body)

    def keep_alive(self, number: int, until_ns: int) -> None:
        """Until when heartbeat frames may be sent; 0 stops them."""
        self._tell(ALIVE, number, until_ns)

    def close(self) -> None:
        """End the process; may be repeated."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(OSError):
            self._control.shutdown(socket.SHUT_RDWR)
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join(STOP_S)
        self._control.close()

    def _tell(self, kind: int, number: int, t_ns: int = 0, body: bytes = b"") -> None:
        # A process that has ended is reported by the thread that hears it.
        with self._lock, contextlib.suppress(OSError):
            self._control.sendall(HEAD.pack(kind, number, t_ns, len(body)) + body)

    def _listen(self) -> None:
        held = bytearray()
        while True:
            try:
                data = self._control.recv(READ_BYTES)
            except OSError:
                data = b""
            if not data:
                break
            self._heard_ns = time.monotonic_ns()
            held += data
            at = 0
            while len(held) - at >= HEAD.size:
                kind, number, t_ns, length = HEAD.unpack_from(held, at)
                if len(held) - at < HEAD.size + length:
                    break
                at += HEAD.size + length
                self._message(kind, number, t_ns, bytes(held[at - length : at]))
            del held[:at]
        self._ready.set()
        for receiver in list(self._receivers.values()):
            receiver.failed("the process that reads the ports has ended")

    def _message(self, kind: int, number: int, t_ns: int, body: bytes) -> None:
        if kind == READY:
            self.priority = body.decode()
            self._ready.set()
            return
        if kind == LATE:
            lateness = self.lateness if number == HEARTBEAT else self.reading
            lateness.extend(late_us * 1e-6 for late_us in array.array("I", body))
            return
        if kind == BLOCKED:
            self._blocked_ns = t_ns
            return
        if kind == DROPPED:
            self._dropped.setdefault(number, threading.Event()).set()
            return
        receiver = self._receivers.get(number)
        if receiver is None:
            return
        if kind == DATA:
            receiver.received(t_ns, body)
        elif kind == BEAT:
            receiver.beaten(int.from_bytes(body, "little"), t_ns)
        elif kind == LOST:
            receiver.failed(body.decode(errors="replace"))
