"""A wire that can be made to misbehave: halves, doubles, damages, delays and repeats."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

INJECTED_FAULTS = ("half", "double", "checksum", "late", "stale", "drop", "garbage")


class Wire:
    """Carries a simulated instrument's messages to the host, one injected fault at a time.

    Args:
        send: takes the bytes that go to the host.
        late_ns: how long a late message is held.

    Attributes:
        bunch_ns: an adapter that delivers only at multiples of this time; 0 for none.
    """

    def __init__(self, send: Callable[[bytes], None], late_ns: int = 700_000_000) -> None:
        self._send = send
        self._late_ns = late_ns
        self._next: deque[str] = deque()
        self._held: deque[tuple[int, bytes]] = deque()
        self._before = b""
        self.bunch_ns = 0
        self._adapter = b""
        self._deliver_ns = 0
        self.done: list[str] = []

    def arrange(self, *faults: str) -> None:
        """The next messages suffer these, one each; "" leaves one alone."""
        self._next.extend(faults)

    def send(self, message: bytes, now_ns: int) -> None:
        """One whole message of the instrument; nothing overtakes a late one."""
        if self.bunch_ns:
            self._adapter += message
            self._deliver_ns = -(-now_ns // self.bunch_ns) * self.bunch_ns
            return
        if self._held:
            self._held.append((self._held[-1][0], message))
            self._before = message
            return
        kind = self._next.popleft() if self._next else ""
        if kind:
            self.done.append(kind)
        match kind:
            case "half":
                self._send(message[: max(1, len(message) // 2)])
            case "double":
                self._send(message + message)
            case "checksum":
                # One bit of a digit in the middle: the length stays, the value changes.
                digits = [k for k, byte in enumerate(message) if chr(byte).isdigit()]
                at = digits[len(digits) // 2] if digits else len(message) // 2
                self._send(message[:at] + bytes([message[at] ^ 1]) + message[at + 1 :])
            case "late":
                self._held.append((now_ns + self._late_ns, message))
            case "stale":
                self._send(self._before + message)
            case "garbage":
                self._send(b"\xff\x13\x80~" + message)
            case "drop":
                pass
            case _:
                self._send(message)
        self._before = message

    @property
    def next_ns(self) -> int | None:
        """When a held message is due."""
        if self._adapter:
            return self._deliver_ns
        return self._held[0][0] if self._held else None

    def advance(self, now_ns: int) -> None:
        """Send what is due."""
        if self._adapter and self._deliver_ns <= now_ns:
            data, self._adapter = self._adapter, b""
            self._send(data)
        while self._held and self._held[0][0] <= now_ns:
            self._send(self._held.popleft()[1])
