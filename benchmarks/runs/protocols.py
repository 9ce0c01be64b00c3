"""What an hour of each protocol costs on the virtual clock, beside the same hour in real time.

A default template is run until at least ``seconds`` of it are on the virtual clock, camera on
trigger, nothing derived. What loads and compiles is paid before by the short template.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from daq.store.run import open_run
from rigs.execution.session import run_protocol
from rigs.protocols.names import PROTOCOLS, default_rig
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig

HOUR_S = 3600.0
ENOUGH_S = 240.0
"""Short tests are repeated until so much of them has been run."""


def cost(name: str, enough_s: float = ENOUGH_S) -> tuple[float, float]:
    """Seconds of test on the virtual clock, and processor seconds (user and system) of them."""
    kind, config = procedure(name), load_rig(default_rig(name))
    test_s = spent_s = 0.0
    with tempfile.TemporaryDirectory() as root:
        run_protocol(kind, config, kind.read(f"{name}-short", config), Path(root))
        plan = kind.read(name, config)
        while test_s < enough_s:
            before = time.process_time()
            result = run_protocol(kind, config, plan, Path(root))
            spent_s += time.process_time() - before
            final = open_run(result.folder).final or {}
            if result.outcome != "clean":
                raise RuntimeError(f"{name} ended {result.outcome}: {result.error}")
            test_s += float(final["duration_s"])
    return test_s, spent_s


def main() -> None:
    """Print a row per protocol; the arguments name some of them."""
    print("| protocol | s of test | processor s | processor s an hour | times real time |")
    print("|--|--|--|--|--|")
    for name in sys.argv[1:] or PROTOCOLS:
        test_s, spent_s = cost(name)
        print(
            f"| {name} | {test_s:.0f} | {spent_s:.1f} | {spent_s / test_s * HOUR_S:.0f} |"
            f" {test_s / spent_s:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
