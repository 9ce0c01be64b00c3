"""The command of every protocol: read the files, run the test, derive and print the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from cli.first_compile import compile_first
from cli.output import print_json
from cli.progress import progress_line
from cli.protocols.terminal import ProgressLine, exit_status, print_result
from daq.errors import ConfigError

if TYPE_CHECKING:
    from rigs.execution.procedure import Plan, Procedure
    from rigs.execution.runner import Runner
    from rigs.live.feed import LiveFeed
    from rigs.rigfile.config import RigConfig

MAX_WAIT_FOR_VIEWER_S = 30.0


@dataclass(frozen=True)
class TestOptions:
    """Options of a test on the command line; the same for every protocol."""

    __test__ = False  # not a pytest class

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


def live_maker(
    kind: Procedure, plan: Plan, config: RigConfig, browser: bool, feeds: list[LiveFeed]
) -> Callable[[str], LiveFeed]:
    """What opens the live view of a test, states its address, and waits where time is virtual.

    Args:
        kind, plan, config: the test and its rig.
        browser: open the page in a browser, if there is a screen.
        feeds: gets what was opened.
    """
    from analysis.layouts.layouts import without_camera
    from rigs.live.feed import open_live

    def make_live(run_id: str) -> LiveFeed:
        layout = kind.analysis.layout(plan.as_dict())
        if not config.camera.source:
            layout = without_camera(layout)
        feed = open_live(run_id, layout, open_browser=browser)
        feeds.append(feed)
        view = feed.view
        if view.error:
            typer.echo(f"live view: none ({view.error}); the test continues", err=True)
            return feed
        where = view.url
        if view.page_error:
            where = f"no page ({view.page_error}); open it with: rerun {view.data_url}"
        typer.echo(f"live view: {where}", err=True)
        if browser and config.is_virtual:
            # On the virtual clock the test would finish before the page is loaded.
            typer.echo(f"waiting up to {MAX_WAIT_FOR_VIEWER_S:.0f} s for a viewer", err=True)
            view.wait_for_viewer(MAX_WAIT_FOR_VIEWER_S)
        return feed

    return make_live


def protocol_command(name: str, options: TestOptions) -> int:
    """Run a protocol; returns the exit status.

    Args:
        name: of a protocol, or a Python file that holds one.
        options: of the command line.
    """
    from analysis.reporting.derived import try_derive
    from daq.interrupt import stop_on_signals
    from rigs.execution.session import run_protocol
    from rigs.protocols.names import default_rig
    from rigs.protocols.registry import procedure
    from rigs.rigfile.config import load_rig

    kind = procedure(name)
    name = kind.name
    config = load_rig(options.rig or default_rig(name), options.seed)
    if options.seed is not None and config.virtual is None:
        raise ConfigError(config.source, "--seed is for virtual benches", "leave it out")
    kind.check(config)
    plan = kind.read(options.protocol or name, config)
    if config.is_virtual:
        compile_first()
    line = ProgressLine(quiet=options.as_json)
    make_live = None
    begin: Callable[[Runner, Any], None] = line.start
    if options.live:
        feeds: list[LiveFeed] = []
        if options.predict is not None and kind.on_joint:
            from rigs.live.joint_prediction import predicting_joint

            begin = predicting_joint(options.predict, config, feeds, line.start)
        elif options.predict is not None:
            from rigs.live.prediction import predicting

            begin = predicting(options.predict, feeds, line.start)

        make_live = live_maker(kind, plan, config, options.browser, feeds)

    with stop_on_signals() as stop:
        result = run_protocol(
            kind, config, plan, options.out,
            specimen=options.specimen, operator=options.operator, note=options.note,
            stop=stop, make_live=make_live, watch=line.watch(), on_start=begin, wire=options.wire,
        )  # fmt: skip
    line.close()
    with progress_line("making table and report"):
        not_derived = try_derive(result.folder, result.error)
    status = exit_status(result)
    if options.as_json:
        from analysis.reporting.report import report_json
        from daq.store.run import open_run

        print_json(report_json(open_run(result.folder)))
        return status
    return print_result(result, not_derived)
