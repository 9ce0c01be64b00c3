"""The tutorials run from the first cell to the last in a real kernel."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest
from jupyter_client.manager import start_new_kernel

HOUSE = Path(__file__).resolve().parent.parent
TUTORIALS = HOUSE / "docs" / "tutorials"
SAID = {
    "first-test": ["clean: 6 of 6 points", "RecordedRun", "'clean'", "from 0 to 650, got 2000"],
    "raw-data-to-model": ["model file: muscle.toml", "braid_length"],
    "your-simulator": ["braid_friction", "no_gap_above_floor"],
}
"""What the outputs of each tutorial contain."""
TIMEOUT_S = 300


def cells(name: str) -> list[dict[str, Any]]:
    notebook = json.loads((TUTORIALS / f"{name}.ipynb").read_text("utf-8"))
    return list(notebook["cells"])


def run_cells(name: str, folder: Path) -> list[str]:
    """Run every cell in a kernel of this Python in a folder; what each printed or showed.

    Raises:
        AssertionError: a cell raised an error, or a command in it failed.
    """
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    env = {**os.environ, "PATH": path, "PYTHONPATH": str(HOUSE)}
    manager, client = start_new_kernel(kernel_name="python3", cwd=str(folder), env=env)
    said: list[str] = []

    def execute(code: str) -> str:
        shown: list[str] = []

        def hear(message: dict[str, Any]) -> None:
            content = message["content"]
            data = content.get("data", {})
            shown.append(str(content.get("text", data.get("text/plain", ""))))

        reply = client.execute_interactive(code, timeout=TIMEOUT_S, output_hook=hear)["content"]
        assert reply["status"] == "ok", f"{name}: {code}\n{reply.get('evalue')}\n{shown}"
        return "".join(shown)

    try:
        for cell in cells(name):
            if cell["cell_type"] == "code":
                said.append(execute("".join(cell["source"])))
                failed = execute("print(globals().get('_exit_code', 0))").strip()
                assert failed == "0", f"{name}: {cell['source']}\n{said[-1]}"
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
    return said


@pytest.mark.parametrize("name", SAID)
def test_every_cell_of_the_tutorial_runs(name: str, tmp_path: Path) -> None:
    said = "\n".join(run_cells(name, tmp_path))
    for words in SAID[name]:
        assert words in said, f"{words!r} is not in the outputs:\n{said}"


def test_every_tutorial_is_tested_and_stored_without_output() -> None:
    assert {path.stem for path in TUTORIALS.glob("*.ipynb")} == set(SAID)
    for name in SAID:
        for cell in cells(name):
            assert not cell.get("outputs")
            assert cell.get("execution_count") is None
            assert cell["metadata"] == {}


def test_a_command_that_fails_fails_the_test(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = {"cell_type": "code", "source": ["!exit 3"]}
    monkeypatch.setattr(sys.modules[__name__], "cells", lambda name: [bad])
    with pytest.raises(AssertionError, match="exit 3"):
        run_cells("bad", tmp_path)
