"""Messages between the notebook and the process that holds the rig.

Each message is one block of bytes on a local connection with a random key: a JSON object, or an
archive of arrays. Nothing that is received is run or unpickled.
"""

from __future__ import annotations

import io
import json
import queue
import threading
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import numpy.typing as npt

Tables = dict[str, dict[str, npt.NDArray[Any]]]
GONE = "the program that opened the rig has ended"
CLOSED = "closed"
"""The reason of a session that the user has closed; every other one is recorded as a stop."""


def send(link: Connection, message: Mapping[str, Any]) -> None:
    """Send a JSON object."""
    link.send_bytes(json.dumps(message).encode())


def receive(link: Connection) -> dict[str, Any]:
    """Receive a JSON object.

    Raises:
        EOFError: the other side has gone.
        ValueError: something else came.
    """
    message = json.loads(link.recv_bytes())
    if not isinstance(message, dict):
        raise ValueError("expected a JSON object")
    return message


def send_tables(link: Connection, tables: Tables) -> None:
    """Send tables of columns."""
    buffer = io.BytesIO()
    flat = {f"{t}/{c}": values for t, columns in tables.items() for c, values in columns.items()}
    np.savez(buffer, **flat)  # type: ignore[arg-type]
    link.send_bytes(buffer.getvalue())


def receive_tables(link: Connection) -> Tables:
    """Receive tables of columns."""
    tables: Tables = {}
    with np.load(io.BytesIO(link.recv_bytes())) as archive:
        for key in archive.files:
            table, column = key.split("/", 1)
            tables.setdefault(table, {})[column] = archive[key]
    return tables


class Inbox:
    """Requests as they come, taken up by a thread.

    Args:
        link: the connection.
        on_close: called once with the reason when the other side closes or goes.

    Attributes:
        answers: texts typed by the person, for requests of the rig.
        closed: no request comes any more.
    """

    def __init__(self, link: Connection, on_close: Callable[[str], None]) -> None:
        self._link = link
        self._on_close = on_close
        self._requests: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self.answers: queue.Queue[str] = queue.Queue()
        self.closed = False
        self._thread = threading.Thread(target=self._listen, name="requests", daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        reason = GONE
        try:
            while True:
                message = receive(self._link)
                if message.get("do") == "close":
                    reason = str(message.get("reason", "")) or CLOSED
                    break
                if message.get("do") == "answer":
                    self.answers.put(str(message.get("text", "")))
                else:
                    self._requests.put(message)
        except (EOFError, OSError, ValueError):
            pass
        self._on_close(reason)
        self.closed = True
        self._requests.put(None)

    @property
    def empty(self) -> bool:
        """Whether nothing waits."""
        return self._requests.empty()

    def take(self, wait_s: float = 0.0) -> dict[str, Any] | None:
        """The next request, None for none; waits that long of the wall's time."""
        try:
            return self._requests.get(timeout=wait_s) if wait_s else self._requests.get_nowait()
        except queue.Empty:
            return None
