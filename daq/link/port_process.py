"""The process that reads the ports of a bench and sends its heartbeat.

Started by :mod:`daq.link.acquisition`. It needs the standard library only, so that it starts in
milliseconds and its two threads stay short. One beats and hears the program. The other waits for
bytes, stamps them and hands them on; on a terminal that wait may last, because the kernel lets a
thread of its own deliver the bytes, which a busy computer delays as well.

The heartbeat frames come ready-made from the program that runs the test, together with the time
until which they may be sent. When that time is over, when the program ends, or when it is
killed, no frame is sent any more, and the firmware vents.

Messages in both directions begin with kind, number of the port, a time in ns and the length of what
follows.
"""

from __future__ import annotations

import array
import contextlib
import gc
import os
import select
import selectors
import signal
import socket
import struct
import sys
import threading
import time
from collections import deque

HEAD = struct.Struct("<BBqI")
ADD, DROP, FRAMES, ALIVE = 1, 2, 3, 4
"""To this process: a port (with its descriptor), the end of one, heartbeat frames, until when."""
DATA, LOST, BEAT, LATE, DROPPED, READY, BLOCKED = 11, 12, 13, 14, 15, 16, 17
"""From this process: bytes, a lost port, a frame sent, lateness, an end confirmed, the start, and
since when reading has been held up (its time; 0 where it is so no more)."""
HEARTBEAT, READING = 0, 1
"""Whose lateness it is."""
FRAME = struct.Struct("<HB")
"""Before each heartbeat frame: its number, the length of its bytes."""

TICK_NS = 10_000_000
REPORT_TICKS = 5
AT_ONCE_NS = 30_000_000
"""A delay above this is reported at once, others with the next report."""
READ_WAIT_NS = 20_000_000
READ_BYTES = 65536
MOST_HELD = 8 << 20
FIFO_PRIORITY = 20
NICE = -10


def raise_priority() -> str:
    """Ask the system for a priority above that of other programs; what was granted."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
        return "SCHED_FIFO"
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
        return f"nice {NICE}"
    return "normal"


def clipped_us(late_ns: int) -> int:
    """Lateness in us, as it is sent."""
    return min(max(0, late_ns) // 1000, 0xFFFFFFFF)


class Port:
    """One port: its descriptor and its heartbeat, if it has one."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.frames: deque[tuple[int, bytes]] = deque()
        self.alive_until_ns = 0
        self.next_ns = 0
        self.period_ns = 0


class PortProcess:
    """The loop.

    Args:
        control: stream socket to the program that runs the test.
        parent: its process id.
    """

    def __init__(self, control: socket.socket, parent: int) -> None:
        self._control = control
        self._parent = parent
        self._ports: dict[int, Port] = {}
        self._in = bytearray()
        self._descriptors: deque[int] = deque()
        self._out: deque[bytes] = deque()
        self._held = 0
        self._late = array.array("I")
        self._reading_late = array.array("I")
        self._changes: deque[tuple[int, int, Port]] = deque()
        self._running = True
        self._lock = threading.Lock()
        self._selector = selectors.DefaultSelector()
        self._read_due_ns = 0
        self._blocked_ns = 0
        control.setblocking(False)

    def run(self) -> None:
        """Until the program that runs the test has ended."""
        threading.Thread(target=self._read_on, name="read", daemon=True).start()
        due_ns = time.monotonic_ns() + TICK_NS
        while self._running:
            wait_s = max(0, due_ns - time.monotonic_ns()) * 1e-9
            ready = select.select([self._control], [], [], wait_s)[0]
            now_ns = time.monotonic_ns()
            with self._lock:
                if now_ns >= due_ns:
                    self._tick(now_ns, now_ns - due_ns)
                    due_ns += TICK_NS * (1 + (now_ns - due_ns) // TICK_NS)
                if ready:
                    self._hear()
                self._flush()

    def _read_on(self) -> None:
        """The thread that reads."""
        while self._running:
            while self._changes:
                self._change(*self._changes.popleft())
            self._read_due_ns = due_ns = time.monotonic_ns() + READ_WAIT_NS
            ready = self._selector.select(READ_WAIT_NS * 1e-9)
            self._reading_late.append(clipped_us(time.monotonic_ns() - due_ns))
            for key, _ in ready:
                self._read(key.data)

    def _change(self, kind: int, number: int, port: Port) -> None:
        """Open and close ports here only: a descriptor is not closed while it is read."""
        if kind == ADD:
            self._selector.register(port.descriptor, selectors.EVENT_READ, number)
            return
        self._selector.unregister(port.descriptor)
        os.close(port.descriptor)
        with self._lock:
            self._send(DROPPED, number, 0)
            self._flush()

    def _tick(self, now_ns: int, late_ns: int) -> None:
        if os.getppid() != self._parent:  # killed, while a descriptor of it lives on somewhere
            self._running = False
            return
        for number, port in self._ports.items():
            if port.frames and port.next_ns <= now_ns < port.alive_until_ns:
                self._beat(number, port, now_ns)
        self._look_at_reader(now_ns)
        self._late.append(clipped_us(late_ns))
        if len(self._late) >= REPORT_TICKS or late_ns > AT_ONCE_NS:
            self._send(LATE, HEARTBEAT, now_ns, self._late.tobytes())
            self._late = array.array("I")
            late, self._reading_late = self._reading_late, array.array("I")
            self._send(LATE, READING, now_ns, late.tobytes())

    def _look_at_reader(self, now_ns: int) -> None:
        """Report while the thread that reads does not come back from the kernel."""
        due_ns = self._read_due_ns
        if due_ns and now_ns - due_ns > AT_ONCE_NS:
            self._blocked_ns = due_ns
            self._send(BLOCKED, 0, due_ns)
        elif self._blocked_ns:
            self._blocked_ns = 0
            self._send(BLOCKED, 0, 0)

    def _beat(self, number: int, port: Port, now_ns: int) -> None:
        identity, frame = port.frames.popleft()
        # In time with the plan, so that lateness does not add up.
        behind = now_ns - port.next_ns > port.period_ns
        port.next_ns = (now_ns if behind else port.next_ns) + port.period_ns
        self._send(BEAT, number, time.monotonic_ns(), identity.to_bytes(2, "little"))
        try:
            sent = os.write(port.descriptor, frame)
        except BlockingIOError:
            return  # full: nobody takes it, and the firmware's deadline says so
        except OSError:
            return  # the thread that reads reports the loss
        if sent < len(frame):  # the rest of a frame is worth nothing without its beginning
            with contextlib.suppress(OSError):
                os.write(port.descriptor, frame[sent:])

    def _read(self, number: int) -> None:
        port = self._ports.get(number)
        if port is None:
            return
        why, data = "closed by the other end", b""
        try:
            data = os.read(port.descriptor, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            why = str(error)
        now_ns = time.monotonic_ns()
        with self._lock:
            if self._ports.get(number) is not port:
                return
            if data:
                self._send(DATA, number, now_ns, data)
                self._flush()
            else:
                self._lose(number, f"no more bytes can be received: {why}")

    def _lose(self, number: int, why: str) -> None:
        """Report a lost port and let go of it."""
        self._changes.append((DROP, number, self._ports.pop(number)))
        self._send(LOST, number, time.monotonic_ns(), why.encode(errors="replace"))

    # ---- to and from the program --------------------------------------------------------

    def _hear(self) -> None:
        try:
            data, descriptors, _, _ = socket.recv_fds(self._control, READ_BYTES, 8)
        except BlockingIOError:
            return
        except OSError:
            data, descriptors = b"", []
        self._descriptors.extend(descriptors)
        self._in += data
        while len(self._in) >= HEAD.size:
            kind, number, t_ns, length = HEAD.unpack_from(self._in)
            if len(self._in) < HEAD.size + length:
                break
            body = bytes(self._in[HEAD.size : HEAD.size + length])
            del self._in[: HEAD.size + length]
            self._message(kind, number, t_ns, body)
        if not data:  # the program has ended: not one beat more
            self._running = False

    def _message(self, kind: int, number: int, t_ns: int, body: bytes) -> None:
        if kind == ADD:
            port = self._ports[number] = Port(self._descriptors.popleft())
            self._changes.append((ADD, number, port))
            return
        if kind == DROP:
            gone = self._ports.pop(number, None)
            if gone is not None:
                self._changes.append((DROP, number, gone))
            else:
                self._send(DROPPED, number, t_ns)
            return
        known = self._ports.get(number)
        if known is None:
            return
        if kind == ALIVE:
            known.alive_until_ns = t_ns
        elif kind == FRAMES:
            known.period_ns = t_ns
            at = 0
            while at < len(body):
                identity, length = FRAME.unpack_from(body, at)
                at += FRAME.size + length
                known.frames.append((identity, body[at - length : at]))

    def _send(self, kind: int, number: int, t_ns: int, body: bytes = b"") -> None:
        message = HEAD.pack(kind, number, t_ns, len(body)) + body
        if self._held + len(message) > MOST_HELD and kind in (DATA, LATE):
            return  # the program has not read for minutes
        self._out.append(message)
        self._held += len(message)

    def _flush(self) -> None:
        while self._out:
            message = self._out[0]
            try:
                sent = self._control.send(message)
            except BlockingIOError:
                return
            except OSError:
                self._running = False
                return
            self._held -= sent
            if sent < len(message):
                self._out[0] = message[sent:]
                return
            self._out.popleft()


def main() -> None:
    """Serve the program at the other end of the socket whose descriptor is the first argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program, which then vents
    control = socket.socket(fileno=int(sys.argv[1]))
    granted = raise_priority()
    gc.disable()  # nothing in the loop makes cycles
    process = PortProcess(control, int(sys.argv[2]))
    process._send(READY, 0, time.monotonic_ns(), granted.encode())
    process.run()


if __name__ == "__main__":
    main()
