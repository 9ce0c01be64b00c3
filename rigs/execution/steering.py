"""Carries out the requests to a running test: pause, resume, skip, repeat, mark, stop."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from daq.clock import NS_PER_S
from rigs.execution.control import RunControl
from rigs.steps.custom_step import Answer, CustomStep, Step
from rigs.steps.steps import Measure, SetLength, SetPressure, Settle, Vent

if TYPE_CHECKING:
    from rigs.steps.context import StepContext

DONE = {
    "pause": "paused (p goes on)",
    "resume": "the test goes on",
    "skip": "the point that is being made is left out",
    "repeat": "the last point is made again",
}
"""What the terminal shows once a request is taken."""
LOOK_S = 0.25
"""How often the control file is looked at, in bench time."""
Setting = Vent | SetPressure | SetLength


class Steering:
    """Between a control and a runner.

    A skipped point leaves an event, no row. A repeated one is a new ``take`` of the same point:
    both stay in the record, the table takes the last. To repeat a point that the test has
    left already, its setting is made again, then that of the present point.

    Attributes:
        paused: whether the test is being held.
        skip: whether the present point is to be left out.
        take: of the point that is being made, from 1.
    """

    def __init__(self, runner: StepContext, control: RunControl) -> None:
        self._runner = runner
        self._control = control
        self.paused = False
        self.skip = False
        self.take = 1
        self._again = False
        self._held = False
        self._next_look_ns = 0
        self._settle: Settle | None = None
        self._settings: dict[str, Setting] = {}
        self._last: tuple[dict[str, Setting], Settle | None, Measure | CustomStep, int] | None = (
            None
        )

    def look(self) -> None:
        """Take the requests made since; called in every round of the bench."""
        now_ns = self._runner.rig.clock.now_ns()
        if now_ns >= self._next_look_ns:
            self._control.look()
            self._next_look_ns = now_ns + round(LOOK_S * NS_PER_S)
        while (requested := self._control.take()) is not None:
            self._carry_out(*requested)

    def _carry_out(self, word: str, rest: str) -> None:
        runner = self._runner
        if word == "p":
            word = "resume" if self.paused else "pause"
        if word == "mark":
            runner.record.event("marker", text=rest, state=runner.progress.state)
            runner.watch.log(f"marked: {rest}")
            return
        if word == "stop":
            runner.record.event("control", asked=word)
            runner.stop.set("stop requested")
            return
        runner.record.event("control", asked=word, order=self._order())
        if word in ("pause", "resume"):
            self.paused = word == "pause"
            self._held = self._held or self.paused
        elif word == "skip":
            self.skip = True
        elif word == "repeat":
            self._again = True
        still = "; the open request stays" if runner.rig.event_loop.asks else ""
        runner.watch.log(f"{DONE[word]}{still}")

    def _order(self) -> int | None:
        last = self._last[2] if self._last is not None else None
        return last.order if isinstance(last, Measure) else None

    def is_paused(self) -> bool:
        """Asked anew each time: the request to go on may come in any round of the bench."""
        return self.paused

    def hold(self) -> None:
        """Wait as long as the test is paused; the heart goes on beating, the air stays."""
        if not self.is_paused():
            return
        runner = self._runner
        state, start_ns = runner.progress.state, runner.rig.clock.now_ns()
        runner.report_state("paused")
        while self.is_paused():
            runner.rig.event_loop.step()
        seconds = (runner.rig.clock.now_ns() - start_ns) / NS_PER_S
        runner.record.event("paused", seconds=seconds)
        runner.report_state(state)

    @property
    def settle(self) -> Settle | None:
        """The criterion that the present point has waited for."""
        return self._settle

    def note(self, step: Step) -> None:
        """Remember how a point was set, so that it can be made again."""
        if isinstance(step, SetLength):
            self._settings["length"] = step
        elif isinstance(step, (SetPressure, Vent)):
            self._settings["pressure"] = step
        elif isinstance(step, Settle):
            self._settle = step
            self._held = False

    def point(self, step: Measure | CustomStep) -> Answer:
        """Make a point, unless it is skipped; and again, as often as that is asked for."""
        if self._again and self._last is not None:
            self._return()
        if self._held:
            self._held = False
            step = self._settle_again(self._settle, step)
        answer = self._make(step, 1)
        while self._again:
            step = self._settle_again(self._settle, step)
            answer = self._make(step, self.take + 1)
        return answer

    def _make(self, step: Measure | CustomStep, take: int) -> Answer:
        self._again = False
        self.take = take
        answer: Answer = None
        if not self.skip:
            answer = self._runner.make(step)
        if self.skip:
            self.skip = False
            fields = step.fields() if isinstance(step, Measure) else {}
            self._runner.record.event("skipped", take=take, **fields)
            self._runner.progress.done += 1 if take == 1 else 0
        self._last = (dict(self._settings), self._settle, step, take)
        return answer

    def _return(self) -> None:
        """Go back to the last point, make it again, and come back to the present one."""
        assert self._last is not None
        here, settle = dict(self._settings), self._settle
        there, there_settle, step, take = self._last
        self._go(there)
        self._make(self._settle_again(there_settle, step), take + 1)
        self._go(here)
        self._settle, self._held = settle, True

    def _go(self, settings: dict[str, Setting]) -> None:
        for axis, step in settings.items():
            if self._settings.get(axis) != step:
                self._settings[axis] = step
                self._runner.do(step)

    def _settle_again(
        self, settle: Settle | None, point: Measure | CustomStep
    ) -> Measure | CustomStep:
        """Settle once more; the point with how that went."""
        if settle is None:
            return point
        settled, waited_s = self._runner.do(settle)
        if isinstance(point, Measure):
            return replace(point, settled=settled, waited_s=waited_s)
        return point
