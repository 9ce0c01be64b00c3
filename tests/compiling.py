"""`python -m tests.compiling`: compile what is compiled once per installation, each part once.

`python -m tests.compiling bench` compiles what a virtual bench needs, in one process; it needs only
the packages of `COMPILED_WITH` in the Makefile, so that it runs while the others are installed.

A fresh clone has no machine code yet, nor byte code of the libraries and of the tests. Left to the
tests, every worker of pytest would compile all of it for itself, at the same time as the others.
What is there already costs a second to look at.
"""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HOUSE = Path(__file__).resolve().parent.parent
MEASURING = """
import numpy as np
from analysis.reduction.pictures import measure_stored
from rigs.virtual.emulators.pictures.camera import render
measure_stored(render(60.0, np.random.default_rng(0)), {})
"""
LIBRARIES = """
import cv2, hypothesis, matplotlib.backends.backend_svg, numba, pandas, pyarrow.parquet, pypdf
import scipy.integrate, scipy.interpolate, scipy.optimize, scipy.signal, scipy.spatial, scipy.stats
import statsmodels.api, sympy, typer.testing
"""
# What pytest does with a test file when it imports it, without running it. Parts of pytest that it
# does not document: if another version has them no more, tests only begin later.
ASSERTIONS = """
import pathlib, types
from _pytest.assertion import rewrite
config = types.SimpleNamespace(getini=lambda name: False)
state = types.SimpleNamespace(trace=lambda text: None)
for file in sorted(pathlib.Path("tests").glob("test_*.py")):
    folder = rewrite.get_cache_dir(file.resolve())
    kept = folder / (file.stem + rewrite.PYC_TAIL)
    if rewrite.try_makedirs(folder) and rewrite._read_pyc(file, kept) is None:
        made = rewrite._rewrite_test(file.resolve(), config)
        rewrite._write_pyc(state, made[1], made[0], kept)
"""
# Longest first. Parts that import each other stand together: what one has compiled is there.
PARTS = (
    "import plant.scene.kernel",
    "import plant.simulator.replay, plant.finger.kernel",
    MEASURING,
    """
import numpy as np
from blind.physics.bench import Trial, no_effect, nominal
from blind.physics.readings import read_trial
at = np.arange(0.0, 0.1, 0.01)
edges = np.array([(0.01, 0, 1.0), (0.02, 0, 0.0)])
free = ("t", "s", "free", 1, 1, 40, 0.1)
one = Trial(*free, temperature_c=21.0, camera_hz=50.0, held_mm=60.0, edges=edges)
read_trial(one, nominal(), no_effect(), at, at, at)
""",
    "import plant.links.integrate, gap.model.pressure",
    LIBRARIES,
)


def main() -> int:
    """Run every part in a process of its own, as many at a time as there are processors."""

    def run(part: str) -> int:
        return subprocess.run([sys.executable, "-c", part], cwd=HOUSE, check=False).returncode

    if sys.argv[1:] == ["bench"]:
        return run(f"import plant.simulator.kernel\n{MEASURING}")
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        saves_time = pool.submit(run, ASSERTIONS)
        failed = max(pool.map(run, PARTS))
        saves_time.result()
    return failed


if __name__ == "__main__":
    sys.exit(main())
