"""What went wrong on an instrument's line: counted by kind, reported to whoever listens."""

from __future__ import annotations

from collections.abc import Callable

KINDS = {
    "damaged": "line or frame that is no reading (half, doubled, garbled)",
    "half": "beginning of a line whose end never came",
    "checksum": "checksum does not hold",
    "comma": "decimal comma instead of a point",
    "unit": "another unit than the rig file says",
    "overload": "overload flag",
    "underload": "underload flag",
    "range": "reading beyond what the instrument can read",
    "refused": "the instrument answered with an error",
    "unset": "a setting that reads back otherwise",
    "no_answer": "no answer in time",
    "late": "answer after its time was up",
    "stale": "answer to no question, or two to one",
    "silent": "sends nothing any more",
    "unplugged": "link lost",
    "replugged": "link found again",
    "stranger": "another instrument answered after the link was found again",
    "restarted": "the instrument restarted by itself",
    "outside": "reading outside the calibrated range (kept, and said)",
    "repeated": "the last picture once more",
    "size": "a picture of another size",
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
