"""`pamrig runs tell`: a request to a test that runs in another process."""

from __future__ import annotations

from pathlib import Path

from daq.errors import RecordError
from daq.store.store import find_run
from rigs.execution.control import RunControl, control_file, is_heard


def tell_run(run: str, runs: Path, text: str) -> str:
    """Append a request to the control file of a running test; returns a confirmation.

    Raises:
        ConfigError: unknown request.
        RecordError: no such run, or it is not running.
    """
    RunControl().request(text)  # raises if the request is unknown
    folder = Path(find_run(runs, run).folder)
    path = control_file(folder)
    if not is_heard(path):
        raise RecordError(str(folder), "is not running", "it has ended; see `pamrig runs show`")
    with path.open("a", encoding="utf-8") as file:
        file.write(text.replace("\n", " ") + "\n")
    return f"sent to {folder.name}: {text}"
