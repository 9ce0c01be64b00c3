"""What every protocol's command does: read, run, derive, say what came of it."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from daq.errors import ConfigError

if TYPE_CHECKING:
    from rigs.execution.runner import Runner

VIEWER_S = 30.0


@dataclass(frozen=True)
class Order:
    """What was asked for on the command line; the same options for every protocol."""

    rig: str = ""
    protocol: str = ""
    out: Path = Path("runs")
    specimen: str = "muscle"
    operator: str = ""
    note: str = ""
    seed: int | None = None
    live: bool = False
    browser: bool = True
    wire: bool = False
    as_json: bool = False
    predict: Path | None = None


class ProgressLine:
    """One line on the terminal: state, points done, time left. Quiet where there is no one."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._tty = sys.stderr.isatty()
        self._runner: Runner | None = None
        self._start = 0.0
        self._last = 0.0
        self._width = 0

    def start(self, runner: Runner, record: Any) -> None:
        """The run begins."""
        self._runner = runner
        self._start = time.monotonic()
        if not self._quiet:
            typer.echo(f"recording to {record.folder}", err=True)

    def state(self, text: str) -> None:
        """A new phase; always printed where there is no terminal to redraw."""
        if not self._quiet and not self._tty:
            typer.echo(f"  {text}{self._left()}", err=True)
        self.redraw(text)

    def redraw(self, text: str = "") -> None:
        """Redraw the line, ten times a second at most."""
        now = time.monotonic()
        if self._quiet or not self._tty or self._runner is None or now - self._last < 0.1:
            return
        self._last = now
        line = f"{text or self._runner.progress.state}{self._left()}"
        typer.echo("\r" + line.ljust(self._width), nl=False, err=True)
        self._width = len(line)

    def _left(self) -> str:
        if self._runner is None:
            return ""
        p = self._runner.progress
        text = f"  {p.done}/{p.points} points"
        left_s = time_left_s(
            p.seconds, p.spent_s, time.monotonic() - self._start, self._runner.rig.clock.virtual
        )
        if left_s is not None:
            text += f", about {left_s:.0f} s left"
        return text

    def close(self) -> None:
        """Leave the terminal on a fresh line."""
        if self._width:
            typer.echo("", err=True)


def time_left_s(total_s: float, spent_s: float, elapsed_s: float, virtual: bool) -> float | None:
    """Time left in s of the wall's clock, or None where nothing can be said yet.

    Args:
        total_s, spent_s: bench time of the whole method and of the steps done, as estimated.
        elapsed_s: wall time since the start.
        virtual: True where bench time goes at another pace than the wall's.
    """
    if spent_s > 0.02 * total_s:
        return max(0.0, total_s - spent_s) * elapsed_s / spent_s
    return None if virtual else total_s


def protocol_command(name: str, order: Order) -> int:
    """Run the protocol of that name; returns the exit status."""
    from analysis.reporting.derived import try_derive
    from cli.protocols.outcome import exit_status, print_result
    from daq.interrupt import stop_on_signals
    from rigs.execution.runner import Watch
    from rigs.execution.session import run_protocol
    from rigs.protocols.names import default_rig
    from rigs.protocols.registry import procedure
    from rigs.rigfile.config import load_rig

    kind = procedure(name)
    config = load_rig(order.rig or default_rig(name), order.seed)
    if order.seed is not None and config.virtual is None:
        raise ConfigError(config.source, "--seed is for virtual benches", "leave it out")
    plan = kind.read(order.protocol or name, config)
    line = ProgressLine(quiet=order.as_json)
    watch = Watch(
        state=line.state, point=lambda *_: line.redraw(), log=lambda t: typer.echo(t, err=True)
    )
    make_live = None
    begin: Callable[[Runner, Any], None] = line.start
    if order.live:
        from rigs.live.feed import LiveFeed, open_live

        feeds: list[LiveFeed] = []
        if order.predict is not None:
            from rigs.live.prediction import predicting

            begin = predicting(order.predict, feeds, line.start)

        def make_live(run_id: str) -> LiveFeed:
            feed = open_live(
                run_id, kind.analysis.layout(plan.as_dict()), open_browser=order.browser
            )
            feeds.append(feed)
            view = feed.view
            if view.error:
                typer.echo(f"live view: none ({view.error}); the test goes on", err=True)
                return feed
            where = view.web_url or f"open it with: rerun --connect {view.url}"
            typer.echo(f"live view: {where}", err=True)
            if order.browser and config.is_virtual:
                # On the virtual clock the test is over before a page has loaded.
                typer.echo(f"waiting up to {VIEWER_S:.0f} s for a viewer", err=True)
                view.wait_for_viewer(VIEWER_S)
            return feed

    with stop_on_signals() as stop:
        result = run_protocol(
            kind, config, plan, order.out,
            specimen=order.specimen, operator=order.operator, note=order.note,
            stop=stop, make_live=make_live, watch=watch, on_start=begin, wire=order.wire,
        )  # fmt: skip
    line.close()
    not_derived = try_derive(result.folder, result.error)
    status = exit_status(result)
    if order.as_json:
        from analysis.reporting.report import report_json
        from daq.store.run import open_run

        typer.echo(json.dumps(report_json(open_run(result.folder)), indent=2, allow_nan=False))
        return status
    return print_result(result, not_derived)
