"""The person of a bench in real time, reached over loopback."""

from __future__ import annotations

import contextlib
import json
import socket

from daq.clock import RealClock
from rigs.devices.operator_port import decode
from rigs.virtual.bench import VirtualBench
from rigs.virtual.byte_ports import LOOPBACK

LONGEST = 4096
"""Bytes of a request; a client that sends more without an end is hung up on."""
HAND_S = 0.3
"""How long the person of a bench in real time takes: nobody likes to wait for one."""


class OperatorPort:
    """The bench's person on request over loopback TCP; see ``rigs.devices.operator_port``."""

    def __init__(self, bench: VirtualBench) -> None:
        self._person = bench.extras.operator(RealClock(), HAND_S)
        self._server = socket.create_server((LOOPBACK, 0))
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self._buffer = b""
        self.address = f"tcp://{LOOPBACK}:{self._server.getsockname()[1]}"

    def step(self) -> None:
        """Take a request, and answer it when it is done; in the bench's own thread."""
        assert self._person is not None
        with contextlib.suppress(BlockingIOError, OSError):
            client, _ = self._server.accept()
            client.setblocking(False)
            if self._client is not None:
                self._client.close()
            self._client, self._buffer = client, b""
        if self._client is None:
            return
        try:
            with contextlib.suppress(BlockingIOError):
                self._buffer += self._client.recv(4096)
            line, found, rest = self._buffer.partition(b"\n")
            if len(line) > LONGEST:
                raise ValueError("no request is that long")
            if found:
                self._buffer = rest
                self._person.begin(decode(line))
            answer = self._person.answer()
            if answer is not None:
                self._client.send(json.dumps({"answer": answer}).encode() + b"\n")
        except (OSError, ValueError):
            self._client.close()
            self._client = None

    def close(self) -> None:
        """Go home."""
        if self._client is not None:
            self._client.close()
        self._server.close()
