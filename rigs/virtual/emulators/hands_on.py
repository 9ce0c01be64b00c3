"""A person at the terminal whose hands reach the simulated bench."""

from __future__ import annotations

from dataclasses import replace

from rigs.devices.operator import ConsoleOperator, Request, read_number
from rigs.virtual.emulators.operator import VirtualOperator

WAIT_S = 0.2
"""Of the wall's time, between two looks at Ctrl-C; the bench's time hardly moves meanwhile."""


class HandsOn(ConsoleOperator):
    """Asks the person at the terminal; once they confirm, it is done on the simulated bench.

    Enter for what was asked, or a number for what was set instead. What is to be read on the
    bench (a gauge) is read by Enter.

    Args:
        hands: does it.
    """

    def __init__(self, hands: VirtualOperator) -> None:
        super().__init__()
        self._hands = hands
        self._request: Request | None = None

    def begin(self, request: Request) -> None:
        """Print the request."""
        self._request = request
        super().begin(request)

    def answer(self, wait_s: float = WAIT_S) -> str | None:
        """What was typed, done on the bench."""
        text = super().answer(wait_s)
        request = self._request
        if text is None or request is None:
            return text
        self._request = None
        if request.value != request.value:
            return text or self._hands.perform(request)
        typed = read_number(text, request.unit)
        self._hands.perform(request if typed is None else replace(request, value=typed))
        return text
