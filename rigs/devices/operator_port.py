"""A person at the other end of a socket: the one of `pamrig virtual`, who hangs and sets things.

One JSON object a line each way: ``{"axis": "mass", "value": 1.2, "unit": "kg", "text": ...}``,
``{"answer": ""}``. A reading that is asked for has null for its value.
"""

from __future__ import annotations

import json
import math
import socket

from daq.errors import LinkLost, PortError
from rigs.devices.operator import Request

CONNECT_S = 3.0


def encode(request: Request) -> bytes:
    """A request as it goes over the line."""
    fields = {name: getattr(request, name) for name in ("axis", "value", "unit", "text")}
    if math.isnan(request.value):
        fields["value"] = None
    return json.dumps(fields).encode() + b"\n"


def decode(line: bytes) -> Request:
    """A request as it came.

    Raises:
        ValueError: it is none.
    """
    try:
        fields = json.loads(line)
        value = math.nan if fields["value"] is None else float(fields["value"])
        return Request(str(fields["axis"]), value, str(fields["unit"]), str(fields["text"]))
    except (KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(f"no request: {error!r}") from None


class RemoteOperator:
    """An operator that is reached over loopback.

    Raises:
        PortError: nobody answers there.
    """

    def __init__(self, address: str, name: str) -> None:
        self.name = name
        host, _, port = address.removeprefix("tcp://").rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), CONNECT_S)
        except (OSError, ValueError) as error:
            raise PortError(name, f"{address!r}: {error}", "is `pamrig virtual` running?") from None
        self._socket.setblocking(False)
        self._buffer = b""

    def begin(self, request: Request) -> None:
        """Send the request; returns at once."""
        try:
            self._socket.send(encode(request))
        except OSError as error:
            raise LinkLost(self.name, f"is gone: {error}") from None

    def answer(self) -> str | None:
        """What came back, or None as long as nothing did."""
        try:
            data = self._socket.recv(4096)
        except BlockingIOError:
            return None
        except OSError as error:
            raise LinkLost(self.name, f"is gone: {error}") from None
        if not data:
            raise LinkLost(self.name, "is gone")
        self._buffer += data
        line, found, rest = self._buffer.partition(b"\n")
        if not found:
            return None
        self._buffer = rest
        return str(json.loads(line)["answer"])

    def close(self) -> None:
        """Hang up."""
        self._socket.close()
