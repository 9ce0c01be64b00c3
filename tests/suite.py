"""`python -m tests.suite`: all tests at their small sizes, as `make test` runs them.

Code that is compiled once per installation comes first. Then the tests that run by the wall clock
and mostly wait; beside them, at a lower priority, those that compute: they take the time that the
others leave. A test in real time that failed is run once more, alone.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import psutil

from tests import compiling

HERE = Path(__file__).resolve().parent
SMALL = "not campaign and not look"
SIDE_BY_SIDE = ("-n", "3", "--dist", "worksteal")
GIVES_WAY = psutil.BELOW_NORMAL_PRIORITY_CLASS if sys.platform == "win32" else 5


def pytest(*words: str) -> list[str]:
    """The command of one run of pytest."""
    return [sys.executable, "-m", "pytest", *words]


def in_real_time() -> list[str]:
    """Which tests run by the wall clock; files without such a test need not be collected.

    What failed is kept apart from what failed among the others, which run at the same time.
    """
    files = sorted(HERE.glob("test_*.py"))
    files = [file for file in files if "realtime" in file.read_text(encoding="utf-8")]
    words = ("-m", f"{SMALL} and realtime", "-o", "cache_dir=.pytest_cache/realtime")
    return [*words, *map(str, files)]


def main() -> int:
    """Run all of them; 0 if all passed."""
    failed = compiling.main()
    with tempfile.TemporaryFile() as said:
        waiting = subprocess.Popen(
            pytest(*SIDE_BY_SIDE, *in_real_time()), stdout=said, stderr=subprocess.STDOUT
        )
        words = ("-n", "logical", "--dist", "worksteal", "-m", f"{SMALL} and not realtime")
        computing = subprocess.Popen(pytest(*words))
        psutil.Process(computing.pid).nice(GIVES_WAY)
        failed |= computing.wait()
        again = waiting.wait()
        said.seek(0)
        print("Those in real time:", said.read().decode(errors="replace"), sep="\n", flush=True)
    if again:
        print("Those that failed in real time once more, alone:", flush=True)
        again = subprocess.run(pytest("--last-failed", *in_real_time()), check=False).returncode
    return int(bool(failed or again))


if __name__ == "__main__":
    sys.exit(main())
