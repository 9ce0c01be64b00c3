"""The web viewer on loopback and the native viewer, as child processes.

The viewer's own ``serve_web_viewer`` listens on all network interfaces, and its page sends
usage reports to its makers. Here the viewer program serves the page on a loopback port. A proxy
passes the page on with a content policy that permits connections to this machine only.
"""

from __future__ import annotations

import atexit
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from daq.errors import PamrigError

LOOPBACK = "127.0.0.1"
START_S = 60.0
STOP_S = 1.0
NATIVE_FAILS_S = 1.5
# The page may run its own code and connect to loopback; no external fonts, no usage reports.
POLICY = (
    "default-src 'self' blob: data:; "
    "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; worker-src 'self' blob:; "
    "connect-src 'self' blob: data: http://127.0.0.1:* http://localhost:*"
)


class ViewerError(PamrigError):
    """The viewer program is missing or did not start."""


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


def has_client(port: int) -> bool:
    """True if a client is connected to the server on ``port`` of this process."""
    import psutil

    try:
        links = psutil.Process().net_connections("tcp")
    except (psutil.Error, OSError):
        return False
    return any(c.laddr.port == port and c.status == psutil.CONN_ESTABLISHED for c in links)


def has_screen() -> bool:
    """True if a window can be opened here."""
    system: str = sys.platform
    if system.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return not os.environ.get("SSH_CONNECTION")


class _Program:
    """The viewer program as a child process; ``close`` stops it in any case."""

    message = ""
    temporary: tempfile.TemporaryDirectory[str] | None = None  # deleted with the viewer

    def __init__(self, arguments: list[str]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="pamrig-viewer-")
        try:
            self._log = Path(self._folder.name) / "viewer.log"
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    [str(viewer_program()), *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env=viewer_environment(Path(self._folder.name)),
                )
        except BaseException:
            self._folder.cleanup()
            raise
        atexit.register(self.close)

    @property
    def pid(self) -> int:
        """Process id of the viewer program."""
        return self._process.pid

    @property
    def last_output(self) -> str:
        """The last line that the program printed."""
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "nothing"

    def wait(self) -> None:
        """Wait until the program ends or the user presses Ctrl-C."""
        try:
            self._process.wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop the program, within about 2 s. May be repeated."""
        atexit.unregister(self.close)
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait(STOP_S)
        self._folder.cleanup()
        if self.temporary is not None:
            self.temporary.cleanup()


class NativeViewer(_Program):
    """The viewer in its own window.

    Args:
        sources: server URLs or view files to open.

    Raises:
        ViewerError: the program is missing or ends at once (no screen, no graphics).
    """

    def __init__(self, sources: list[str]) -> None:
        # The window also listens for data: on loopback, and on its own port.
        super().__init__(["--bind", LOOPBACK, "--port", "auto", *sources])
        self.message = "viewer opened in a window; close it or press Ctrl-C to end"
        if _ended(self._process, NATIVE_FAILS_S):
            output = self.last_output
            self.close()
            raise ViewerError("rerun viewer", f"ended at once: {output}", "pamrig view RUN --web")


class WebViewer(_Program):
    """Serves the viewer's page on loopback until ``close``.

    Args:
        sources: server URLs (rerun+http://...) or view files to open.
        port: of the page; if it is in use, another free one.
        memory: limit of the data that the server keeps when ``sources`` are files.

    Raises:
        ViewerError: the program is missing or does not respond in time.
    """

    def __init__(self, sources: list[str], port: int = 9090, memory: str = "2GB") -> None:
        self._server: ThreadingHTTPServer | None = None
        inner, grpc = free_port(0), free_port(0)
        super().__init__(
            ["--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(inner),
             "--port", str(grpc), "--server-memory-limit", memory, *sources]
        )  # fmt: skip
        urls = [s for s in sources if "://" in s]
        if len(urls) < len(sources):
            urls.append(f"rerun+http://{LOOPBACK}:{grpc}/proxy")
        try:
            self._wait_for_page(inner)
            self._server = _proxy(free_port(port), inner)
        except BaseException:
            self.close()
            raise
        query = urllib.parse.urlencode(
            [("url", u) for u in urls] + [("theme", "dark"), ("persist", "0")]
        )
        self.url = f"http://{LOOPBACK}:{self._server.server_address[1]}/?{query}"
        self.message = f"open {self.url} in a browser; Ctrl-C ends"

    def _wait_for_page(self, port: int) -> None:
        end = time.monotonic() + START_S
        while time.monotonic() < end and not _ended(self._process, 0.05):
            try:
                with urllib.request.urlopen(f"http://{LOOPBACK}:{port}/", timeout=1.0):
                    return
            except OSError:
                pass
        raise ViewerError(
            "rerun viewer",
            f"no page within {START_S:g} s; its last output: {self.last_output}",
            "pamrig doctor",
        )

    def close(self) -> None:
        """Stop serving, within about 2 s. May be repeated."""
        server, self._server = self._server, None
        if server is not None:
            threading.Thread(target=server.shutdown, daemon=True).start()
            server.server_close()
        super().close()


def _ended(process: subprocess.Popen[bytes], seconds: float) -> bool:
    """True if ``process`` ends within ``seconds``."""
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return False
    return True


def free_port(wanted: int) -> int:
    """``wanted`` if it is free on loopback, else a free port; 0 for any."""
    for port in (wanted, 0):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise ViewerError(LOOPBACK, "no free port", "close other programs that listen there")


def _proxy(port: int, inner: int) -> ThreadingHTTPServer:
    """A loopback server that passes on the page from port ``inner`` under ``POLICY``."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.0"  # the connection closes at the end of the file

        def do_GET(self) -> None:
            try:
                with urllib.request.urlopen(
                    f"http://{LOOPBACK}:{inner}{self.path}", timeout=10.0
                ) as response:
                    self.send_response(200)
                    self.send_header("Content-Type", response.headers["Content-Type"])
                    self.send_header("Content-Security-Policy", POLICY)
                    size = response.headers.get("rerun-final-length")
                    if size:  # for the page's progress display
                        self.send_header("rerun-final-length", size)
                        self.send_header("Content-Length", size)
                    self.end_headers()
                    while block := response.read(1 << 18):
                        self.wfile.write(block)
            except urllib.error.HTTPError as error:
                self.send_error(error.code)
            except OSError:
                self.close_connection = True

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer((LOOPBACK, port), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="web viewer", daemon=True).start()
    return server
