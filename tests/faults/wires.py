"""Lines between simulated instruments and host that lose, flip, double and hold up bytes."""

from __future__ import annotations

import random
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

BEAT = b"hb "
DEADLINE_US = 350_000
_PLAIN = re.compile(rb"[0-9 ]")
_SCPI = re.compile(rb'[-+]?[0-9]+(\.[0-9]+)?(E[-+]?[0-9]+)?|[0-9]+,".*"')


@dataclass
class Rule:
    """What happens to messages of one device in one direction for a while (bench time, s)."""

    device: str
    inward: bool
    how: str
    share: float
    start_s: float
    end_s: float
    altered: int = 0
    """Messages that were changed, lost, doubled or held up."""
    plain: int = 0
    """Of these, how many differ from the true one in digits alone: a line without a checksum
    cannot tell. A supply's answers are not even of one length; what is told to it is read back."""


@dataclass
class Wires:
    """Stands between a virtual bench and its links."""

    bench: Any
    rng: random.Random
    rules: list[Rule] = field(default_factory=list)
    on_beat: Callable[[], None] = lambda: None
    """Called when a whole heartbeat reached the controller."""

    def __post_init__(self) -> None:
        self._out, self._in = self.bench._send, self.bench.feed
        self._held: deque[tuple[float, str, bytes]] = deque()
        self.bench._send = self._to_host
        self.bench.feed = self._to_device

    def _rule(self, device: str, inward: bool) -> Rule | None:
        now = self.bench.board.bench_us * 1e-6
        for rule in self.rules:
            if rule.device == device and rule.inward == inward and rule.start_s <= now < rule.end_s:
                return rule if self.rng.random() < rule.share else None
        return None

    def _to_host(self, device: str, data: bytes, bench_ns: int | None = None) -> None:
        rule = self._rule(device, True)
        if rule is not None and rule.how == "held up":
            rule.altered += 1
            self._held.append((self.bench.board.bench_us * 1e-6 + self.rng.uniform(0.05, 1.0),
                               device, data))  # fmt: skip
            return
        if any(name == device for _, name, _ in self._held):  # nothing overtakes on a line
            self._held.append((self._held[-1][0], device, data))
            return
        if rule is not None:
            data = self._spoilt(data, rule)
        if data:
            self._out(device, data, bench_ns)

    def _to_device(self, device: str, data: bytes) -> None:
        rule = self._rule(device, False)
        good = rule is None or rule.how == "doubled"  # of two like beats the first one counts
        if rule is not None:
            data = self._spoilt(data, rule)
        if device == "valve" and BEAT in data and good:
            self.on_beat()
        if data:
            self._in(device, data)

    def direct(self, device: str, data: bytes) -> None:
        """Bytes that do not come from the host; nothing spoils them."""
        self._in(device, data)

    def advance(self) -> None:
        """Hand on what was held up long enough."""
        now = self.bench.board.bench_us * 1e-6
        while self._held and self._held[0][0] <= now:
            _, device, data = self._held.popleft()
            self._out(device, data, self.bench.board.bench_us * 1000)

    def _spoilt(self, data: bytes, rule: Rule) -> bytes:
        out = spoil(data, rule.how, self.rng)
        if out[-1:] == b"\n" and out.strip() == data.strip():
            return data  # a space or carriage return at the end of a line says nothing
        if out != data:
            rule.altered += 1
            rule.plain += _plain(data, out)
        return out


def _plain(data: bytes, out: bytes) -> bool:
    """Whether digits became other digits, or a supply's number another number."""
    if _SCPI.fullmatch(data.strip()) and _SCPI.fullmatch(out.strip()) and out.endswith(b"\n"):
        return True
    return len(out) == len(data) and all(
        a == b or bool(_PLAIN.match(bytes([a])) and _PLAIN.match(bytes([b])))
        for a, b in zip(data, out, strict=True)
    )


def spoil(data: bytes, how: str, rng: random.Random) -> bytes:
    """A message as a bad line delivers it."""
    if how == "lost":
        return b""
    if how == "doubled":
        return data + data
    at = rng.randrange(len(data))
    if how == "flipped":
        return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    if how == "cut":
        return data[:at] + data[at + rng.randint(1, 8) :]
    if how == "garbage":
        return data[:at] + rng.randbytes(rng.randint(1, 40)) + data[at:]
    raise ValueError(how)
