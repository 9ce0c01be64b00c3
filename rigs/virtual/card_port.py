"""The simulated card of a bench in real time, reached over loopback.

A real card has no port that a program could open but by its manufacturer's package. So the mock of
the package runs in the client, and what it asks of the card goes over a socket: one JSON object a
line each way. ``{"do": "scans"}`` is answered by ``{"scans": [[volts, ...], ...]}``; ``start`` and
``stop`` begin and end the scan; ``write`` sets an output.
"""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from daq.errors import PortError
from rigs.rigfile.instruments import CardDevice
from rigs.virtual.byte_ports import LoopbackServer
from rigs.virtual.emulators.cards import VirtualCard

TCP = "tcp://"
"""How the port of such a card begins in a rig file that `pamrig virtual` wrote."""
PATIENCE_S = 2.0
LONGEST = 65536
"""Bytes of a request; a client that sends more without an end is hung up on."""


class CardPort(LoopbackServer):
    """Serves one client at a time, in the bench's own thread."""

    def __init__(self, card: VirtualCard) -> None:
        super().__init__(TCP)
        self._card = card
        self._buffer = b""

    def step(self) -> None:
        """Answer what was asked."""
        if self._accept():
            self._buffer = b""
        if self._client is None:
            return
        try:
            with contextlib.suppress(BlockingIOError):
                data = self._client.recv(LONGEST)
                if not data:
                    raise ValueError("the client is gone")
                self._buffer += data
            if len(self._buffer) > LONGEST:
                raise ValueError("no request is that long")
            while b"\n" in self._buffer:
                line, _, self._buffer = self._buffer.partition(b"\n")
                answer = json.dumps(self._answer(json.loads(line)))
                self._client.settimeout(PATIENCE_S)
                self._client.sendall(answer.encode() + b"\n")
                self._client.setblocking(False)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            self._drop()

    def _answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        card = self._card
        match request["do"]:
            case "start":
                card.terminals = [str(name) for name in request["terminals"]]
                card.ranges = {str(k): float(v) for k, v in request["ranges"].items()}
                card.scans.clear()
                card.start(float(request["rate_hz"]))
            case "stop":
                card.stop()
            case "write":
                card.write(str(request["terminal"]), float(request["volts"]))
            case "scans":
                scans = list(card.scans)
                card.scans.clear()
                return {"scans": scans, "gone": card.gone}
        return {}


class RemoteCard:
    """Stands for the card where the mock of its package runs; see `VirtualCard`.

    Args:
        device: of the rig file; its port is the address.

    Raises:
        PortError: nobody answers there.
    """

    def __init__(self, device: CardDevice) -> None:
        self.device = device
        self.sleep: Callable[[float], None] = time.sleep
        self.terminals: list[str] = []
        self.ranges: dict[str, float] = {}
        self.skip = 0
        self._scans: deque[list[float]] = deque()
        self._lost = False
        host, _, port = device.port.removeprefix(TCP).rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), PATIENCE_S)
        except (OSError, ValueError) as error:
            what = f"{device.port!r}: {error}"
            raise PortError("card", what, "is `pamrig virtual` running?") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._file = self._socket.makefile("rwb")

    def _ask(self, **request: Any) -> dict[str, Any]:
        """One answer; an empty one, and a lost card, where none comes."""
        try:
            self._file.write(json.dumps(request).encode() + b"\n")
            self._file.flush()
            answer: dict[str, Any] = json.loads(self._file.readline() or b"{}")
        except (OSError, ValueError):
            answer = {"gone": True}
        unanswered = request["do"] == "scans" and "scans" not in answer
        self._lost = self._lost or unanswered or bool(answer.get("gone"))
        return answer

    @property
    def gone(self) -> bool:
        """Whether the card, or the bench, is gone."""
        return self._lost

    @property
    def scans(self) -> deque[list[float]]:
        """Scans that can be read, those that came since included."""
        if not self._lost:
            self._scans.extend(self._ask(do="scans").get("scans", ()))
        return self._scans

    def start(self, rate_hz: float) -> None:
        """Begin to scan."""
        self._scans.clear()
        self._ask(do="start", rate_hz=rate_hz, terminals=self.terminals, ranges=self.ranges)

    def stop(self) -> None:
        """Scan no more."""
        self._ask(do="stop")

    def write(self, terminal: str, volts: float) -> None:
        """An analogue output."""
        self._ask(do="write", terminal=terminal, volts=volts)

    def close(self) -> None:
        """Close the connection."""
        for thing in (self._file, self._socket):
            with contextlib.suppress(OSError):
                thing.close()
