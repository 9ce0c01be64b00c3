"""One instrument in a rig file: where it is and who it must say it is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Device:
    """One instrument on a serial port."""

    port: str
    baud: int
    serial: str
