"""A reader with a fault behind five bytes in a row, which only guidance by branches finds."""

from __future__ import annotations


def deep(data: bytes) -> None:
    """Raises where the input begins with five certain bytes."""
    at = 0
    for wanted in (0x7F, 0x80, 0x30, 0x0D, 0xFF):
        if at >= len(data) or data[at] != wanted:
            break
        at += 1
    match at:
        case 1:
            return
        case 2:
            return
        case 3:
            return
        case 4:
            return
        case 5:
            raise ZeroDivisionError("found")
