"""Signals as a request for an orderly stop, on a real terminal."""

from __future__ import annotations

import os
import sys

import pytest

WAITS = """
import sys, time
from daq.interrupt import stop_on_signals
with stop_on_signals() as stop:
    print("ready", flush=True)
    while not stop.reason:
        time.sleep(0.01)
    print(stop.reason, flush=True)
    print("report", file=sys.stderr, flush=True)
    sys.exit(130)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="pseudo-terminals")
def test_a_program_whose_terminal_is_closed_ends_its_work() -> None:
    """It ended with status 1 at the next line that it printed: no table, no report."""
    import pty

    child, terminal = pty.fork()
    if not child:
        os.execv(sys.executable, [sys.executable, "-c", WAITS])
    heard = b""
    while b"ready" not in heard:
        heard += os.read(terminal, 1000)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 130
