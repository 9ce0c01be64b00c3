# mypy: ignore-errors
"""Copying of bytes as machine code; CPython has a faster way (``native.copy``)."""

import micropython


@micropython.viper
def copy(to: ptr8, at: int, source: ptr8, first: int, n: int):  # noqa: F821
    """Copy ``n`` bytes of ``source`` from ``first`` on to ``to`` from ``at`` on."""
    end = at + n
    while at < end:
        to[at] = source[first]
        at += 1
        first += 1
