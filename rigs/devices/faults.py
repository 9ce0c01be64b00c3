"""What went wrong on an instrument's line: counted by kind, reported to whoever listens."""

from __future__ import annotations

from collections.abc import Callable

KINDS = {
    "damaged": "line or frame that is not a reading (half, doubled, garbled)",
    "half": "beginning of a line whose end never came",
    "checksum": "wrong checksum",
    "comma": "decimal comma instead of a point",
    "unit": "another unit than in the rig file",
    "overload": "overload flag",
    "underload": "underload flag",
    "range": "reading beyond what the instrument can read",
    "refused": "the instrument answered with an error",
    "unset": "a setting reads back differently",
    "no_answer": "no answer in time",
    "late": "answer after the time-out",
    "stale": "answer without a request, or two answers to one",
    "silent": "stopped sending",
    "stuck": "the same reading again and again, without the noise of its converter",
    "early": "a conversion before its time, as on an open data line",
    "lost_count": "an encoder jumped by two steps; its count is not valid any more",
    "unplugged": "link lost",
    "replugged": "link restored",
    "stranger": "another instrument answered after the link was restored",
    "restarted": "the instrument restarted by itself",
    "outside": "reading outside the calibrated range (kept and reported)",
    "repeated": "the same picture twice",
    "size": "a picture of another size",
    "no_pose": "a picture in which the pose of the mark is not certain",
}
"""Every kind of fault and its meaning; none of them ever becomes a value."""


class Faults:
    """Counts faults of one instrument.

    Attributes:
        counts: number of faults by kind.
        last: words of the last one, for messages.
        on_fault: called with (kind, words) for each.
    """

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.last = ""
        self.on_fault: list[Callable[[str, str], None]] = []

    def add(self, kind: str, words: str = "") -> None:
        """Count one fault of a known kind."""
        text = f"{KINDS[kind]}: {words}" if words else KINDS[kind]
        self.counts[kind] = self.counts.get(kind, 0) + 1
        if kind != "replugged":
            self.last = text
        for listener in self.on_fault:
            listener(kind, text)

    @property
    def total(self) -> int:
        """Faults of all kinds."""
        return sum(self.counts.values())
