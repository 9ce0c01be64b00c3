"""`python -m tests.compiling`: compile what is compiled once per installation, each part once.

A fresh clone has no machine code yet. Left to the tests, every worker of pytest would compile all
of it for itself, at the same time as the others. What is there already costs a second to look at.
"""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

# Longest first. Parts that import each other stand together: what one has compiled is there.
PARTS = (
    "import plant.scene.kernel",
    "import plant.simulator.kernel, plant.finger.kernel",
    """
import numpy as np
from analysis.reduction.pictures import measure_stored
from rigs.virtual.emulators.camera import render
measure_stored(render(60.0, np.random.default_rng(0)), {})
""",
    "import plant.links.integrate",
)


def main() -> int:
    """Run every part in a process of its own, as many at a time as there are processors."""

    def run(part: str) -> int:
        return subprocess.run([sys.executable, "-c", part], check=False).returncode

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return max(pool.map(run, PARTS))


if __name__ == "__main__":
    sys.exit(main())
