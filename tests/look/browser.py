"""Pictures of web pages by headless Chromium, driven over its debugging pipe.

Nothing but the standard library: the browser reads JSON commands on file descriptor 3 and
answers on 4, each ended by a zero byte.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--mute-audio",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)


def find_browser() -> str | None:
    """Path of a Chromium, or None; PAMRIG_BROWSER overrides."""
    named = os.environ.get("PAMRIG_BROWSER")
    return named or next((p for n in NAMES if (p := shutil.which(n))), None)


class Browser:
    """One headless page of a given size.

    Args:
        width, height: of the page, in pixels.
    """

    def __init__(self, width: int = 1600, height: int = 900) -> None:
        program = find_browser()
        if program is None:
            raise RuntimeError("no Chromium found: install one or set PAMRIG_BROWSER")
        self._folder = tempfile.TemporaryDirectory(
            prefix="pamrig-browser-", ignore_cleanup_errors=True
        )
        to_read, self._to = os.pipe()
        self._from, from_write = os.pipe()

        def wire() -> None:
            # First move both ends out of the way of 3 and 4, then onto them.
            a, b = os.dup(to_read), os.dup(from_write)
            a, b = os.dup2(a, 100), os.dup2(b, 101)
            os.dup2(a, 3)
            os.dup2(b, 4)

        self.console: list[str] = []
        self._process = subprocess.Popen(
            [program, *FLAGS, f"--window-size={width},{height}",
             f"--user-data-dir={self._folder.name}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            close_fds=False,
            preexec_fn=wire,
        )  # fmt: skip
        os.close(to_read)
        os.close(from_write)
        self._next = 0
        self._buffer = b""
        self._session: str | None = None
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        self.call("Runtime.enable")
        self.call("Log.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def call(self, method: str, timeout_s: float = 180.0, **params: Any) -> dict[str, Any]:
        """Send one command and wait for its answer."""
        self._next += 1
        message: dict[str, Any] = {"id": self._next, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + timeout_s
        while True:
            answer = self._receive(end)
            if answer.get("id") == self._next:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result

    def _receive(self, end: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            left = end - time.monotonic()
            if left <= 0 or not select.select([self._from], [], [], left)[0]:
                raise TimeoutError("the browser did not answer")
            block = os.read(self._from, 1 << 20)
            if not block:
                raise RuntimeError("the browser has gone")
            self._buffer += block
        line, self._buffer = self._buffer.split(b"\0", 1)
        answer: dict[str, Any] = json.loads(line)
        self._note(answer)
        return answer

    def _note(self, answer: dict[str, Any]) -> None:
        params = answer.get("params", {})
        if answer.get("method") == "Runtime.consoleAPICalled" and params["type"] != "debug":
            text = " ".join(str(a.get("value", a.get("description"))) for a in params["args"])
            self.console.append(f"{params['type']}: {text}")
        elif answer.get("method") == "Log.entryAdded":
            entry = params["entry"]
            self.console.append(f"{entry['level']}: {entry['text']} {entry.get('url', '')}")

    def open(self, url: str) -> None:
        """Go to a page; returns when its document is there."""
        self.call("Page.navigate", url=url)
        end = time.monotonic() + 180.0
        while time.monotonic() < end:
            try:
                if self.evaluate("document.readyState") in ("interactive", "complete"):
                    return
            except RuntimeError:  # between two documents
                pass
            time.sleep(0.1)
        raise TimeoutError(f"{url} did not load")

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page."""
        return self.call("Runtime.evaluate", expression=expression)["result"].get("value")

    def picture(self, path: Path) -> Path:
        """Save what the page shows as PNG."""
        data = self.call("Page.captureScreenshot", timeout_s=120.0, format="png")["data"]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(data))
        return path

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to)
        os.close(self._from)
        self._folder.cleanup()

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
