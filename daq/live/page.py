"""The files of the viewer's page, and the viewer's program that holds them.

The program's own server listens with less care than a bench needs, and its page sends usage
reports to its makers. Here the program is started for a moment, without any data, and asked for
the four files of its page. Then it is ended; `daq.live.door` serves them.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

from daq.errors import PamrigError

LOOPBACK = "127.0.0.1"
START_S = 60.0
STOP_S = 1.0
INDEX = "index.html"
FILES = (INDEX, "re_viewer.js", "re_viewer_bg.wasm", "favicon.ico")


class ViewerError(PamrigError):
    """The viewer program is missing or did not start."""


@dataclass(frozen=True)
class PageFile:
    """A file of the page: its media type and its content."""

    media_type: str
    content: bytes


def viewer_program() -> Path:
    """Path of the viewer binary; the script of the same name does not forward signals."""
    import importlib.util

    spec = importlib.util.find_spec("rerun_cli")
    places = list(spec.submodule_search_locations or []) if spec else []
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    for place in places:
        program = Path(place) / name
        if program.is_file():
            return program
    raise ViewerError("rerun-sdk", "its viewer program is not installed", "pip install rerun-sdk")


def viewer_environment(folder: Path) -> dict[str, str]:
    """Environment of the viewer program: usage reports off, configuration in ``folder``.

    The program would otherwise write its configuration into the user's home.
    """
    config = folder / "rerun" / "analytics.json"
    if not config.exists():
        config.parent.mkdir(parents=True, exist_ok=True)
        settings = {
            "analytics_enabled": False,
            "analytics_id": "pamrig",
            "metadata": {},
            "config_file_path": str(config),
            "data_dir_path": str(config.parent),
        }
        config.write_text(json.dumps(settings), encoding="utf-8")
    # CI also switches usage reports off, for systems where the program ignores XDG_CONFIG_HOME.
    return {**os.environ, "XDG_CONFIG_HOME": str(folder), "CI": "1"}


def has_screen() -> bool:
    """True if a browser can be opened here."""
    system: str = sys.platform
    if system.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return not os.environ.get("SSH_CONNECTION")


def page_files() -> dict[str, PageFile]:
    """The files of the viewer's page by name.

    Raises:
        ViewerError: the program is missing or does not respond in time.
    """
    with tempfile.TemporaryDirectory(prefix="pamrig-viewer-") as folder:
        port = _free_port()
        log = Path(folder) / "viewer.log"
        with log.open("wb") as output:
            # With a source of its own the program opens no server for data.
            program = subprocess.Popen(
                [str(viewer_program()), "--serve-web", "--bind", LOOPBACK,
                 "--web-viewer-port", str(port), f"http://{LOOPBACK}:1/none.rrd"],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=viewer_environment(Path(folder)),
            )  # fmt: skip
        try:
            end = time.monotonic() + START_S
            while time.monotonic() < end and program.poll() is None:
                try:
                    return {name: _get(port, name) for name in FILES}
                except OSError:
                    time.sleep(0.05)
        finally:
            program.terminate()
            try:
                program.wait(STOP_S)
            except subprocess.TimeoutExpired:
                program.kill()
                program.wait()
        lines = log.read_text(errors="replace").strip().splitlines() or ["nothing"]
    raise ViewerError(
        "rerun viewer",
        f"no page within {START_S:g} s; its last output: {lines[-1]}",
        "pamrig doctor",
    )


def _get(port: int, name: str) -> PageFile:
    with urllib.request.urlopen(f"http://{LOOPBACK}:{port}/{name}", timeout=10.0) as response:
        return PageFile(str(response.headers["Content-Type"]), response.read())


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
