"""What the panel "Status" of a running test says: state, progress, time left, faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from daq.errors import PamrigError
from daq.link.causes import CAUSES, cause_of, event_words
from daq.live.status import DONE, FAULT, STOPPED, Phases, Status, joined
from rigs.steps.watching import Progress, time_left_s

if TYPE_CHECKING:
    from daq.live.live import LiveView

EVERY_S = 1.0
"""The time left is shown anew so often; a change of the state is shown at once."""


class LiveStatus:
    """Follows telemetry, steps and faults of a test.

    Args:
        view: where it is shown.
        progress: of the test.
        now_s: time since the start of the run, s.
        names: of the controllers, in the order of the rig.
    """

    def __init__(
        self, view: LiveView, progress: Progress, now_s: Callable[[], float], names: list[str]
    ) -> None:
        self._view = view
        self._progress = progress
        self._now_s = now_s
        self._phases = {name: Phases() for name in names}
        self._step = self._request = ""
        self._problem = self._remedy = ""
        self._ended = ""
        self._shown = ""
        self._next_s = 0.0

    def batch(self, name: str, time_s: Any, columns: Mapping[str, Any]) -> None:
        """Telemetry of one controller."""
        changed = [phase for _, phase in self._phases[name].feed(time_s, columns)]
        if changed or self._now_s() >= self._next_s:
            self._show()

    def step(self, text: str) -> None:
        """The test enters a step."""
        self._step = text
        self._show()

    def point(self) -> None:
        """A point was made."""
        self._show()

    def request(self, text: str) -> None:
        """A person is asked for something, or ("") has done it."""
        self._request = text
        self._show()

    def event(self, text: str) -> None:
        """An event of a controller; the first fault is the one that matters."""
        if text.startswith("fault") and not self._problem:
            cause = cause_of(text)
            self._problem, self._remedy = CAUSES[cause] if cause else (event_words(text), "")
            self._show()

    def ended(self, outcome: str, error: BaseException | None) -> None:
        """The test has ended: how, why, and what to do."""
        self._ended = {"clean": DONE, "stopped": STOPPED}.get(outcome, FAULT)
        if isinstance(error, PamrigError):
            self._problem, self._remedy = f"{error.where}: {error.what}", error.remedy
        elif error is not None:
            self._problem = str(error) or type(error).__name__
        self._show()

    def _show(self) -> None:
        now_s, progress = self._now_s(), self._progress
        self._next_s = now_s + EVERY_S
        status = Status(
            phase=self._ended or joined({n: p.phase for n, p in self._phases.items()}),
            step=self._step,
            request=self._request,
            done=progress.done,
            planned=progress.points,
            left_s=time_left_s(progress.seconds, progress.spent_s, now_s, False),
            problem=self._problem,
            remedy=self._remedy,
        )
        text = status.markdown()
        if text != self._shown:
            self._shown = text
            self._view.status(now_s, text)
