"""The door of the live view: what a stranger, a foreign web page or a crowd gets there.

1,000 idle connections to the viewer's port once ended a run, a request for the host `evil.example`
read 515 kB of its data, and another client wrote into its recording.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

import daq.live.door
from analysis.layouts import layouts as names
from analysis.layouts.layouts import isometric_layout
from daq.live.door import MOST_STRANGERS, MOST_VIEWERS, POLICY, Door
from daq.live.history import ViewFile
from daq.live.live import LiveView
from daq.live.page import PageFile
from door_attack import GRPC_WRITE, HTTP2, STRANGERS, ask, crowd, flood

pytestmark = pytest.mark.realtime
FULL = bool(os.environ.get("PAMRIG_CAMPAIGN"))
CROWD = 10_000 if FULL else 300
FLOOD = 10_000 if FULL else 60
SECRET = b"what the bench measured" * 10_000
PAGE = {"index.html": PageFile("text/html", b"<p>page"), "re_viewer.js": PageFile("t", b"js")}


@pytest.fixture
def door(tmp_path: Path) -> Iterator[Door]:
    (tmp_path / "view.rrd").write_bytes(SECRET)
    made = Door(ViewFile(tmp_path / "view.rrd"), PAGE, 0)
    yield made
    made.close()


def get(door: Door, name: str = "view.rrd", method: str = "GET", **headers: str) -> bytes:
    """The answer to a request that has the token; a header of None is left out."""
    path = "/" + door.url.split("/", 3)[3] + name
    lines = {
        "Host": f"127.0.0.1:{door.port}",
        **{k.replace("_", "-"): v for k, v in headers.items()},
    }
    head = "".join(f"{k}: {v}\r\n" for k, v in lines.items() if v)
    return ask(door.port, f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode())


def status(answer: bytes) -> int:
    return int(answer.split()[1])


def test_with_the_token_page_and_data_come_under_a_policy(door: Door) -> None:
    assert get(door).endswith(SECRET)
    assert POLICY in get(door, "index.html?url=x").decode("latin-1")
    assert status(get(door, "other.js")) == 404
    opened = get(door, "", Host="localhost:1234").decode()  # a port forwarded by ssh
    assert "302 Found" in opened
    assert (
        f"Location: http://localhost:1234/{door.url.split('/')[3]}/?url=http%3A%2F%2Flocal"
        in opened
    )
    assert "tel.rerun.io" not in POLICY


@pytest.mark.parametrize("request_bytes", STRANGERS)
def test_without_the_token_nothing_can_be_read(door: Door, request_bytes: bytes) -> None:
    answer = ask(door.port, request_bytes)
    assert answer == b"" or (status(answer) in (400, 403) and answer.endswith(b"\r\n\r\n"))


def test_a_token_that_is_almost_right_is_wrong(door: Door) -> None:
    good = door.url.split("/")[3]
    for bad in (good[:-1], good + "x", good.swapcase(), "x" * 5000):
        request = f"GET /{bad}/view.rrd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        assert status(ask(door.port, request.encode())) == 403


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1.evil.example", "evil.example:80", "0.0.0.0", "", "127.0.0.1 x"],
)
def test_a_foreign_host_reads_nothing_even_with_the_token(door: Door, host: str) -> None:
    """How a web page reaches a server of this machine: its own name resolves to 127.0.0.1."""
    answer = get(door, Host=host)
    assert status(answer) == 403
    assert SECRET[:20] not in answer


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},  # another server of this machine
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_a_foreign_origin_reads_nothing_even_with_the_token(
    door: Door, headers: dict[str, str]
) -> None:
    assert status(get(door, **headers)) == 403
    assert status(get(door, Origin=f"http://127.0.0.1:{door.port}")) == 200


def test_no_method_but_get_is_answered_so_nobody_can_write(door: Door) -> None:
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "CONNECT", "PATCH", "HEAD"):
        assert status(get(door, method=method)) == 405
    assert status(get(door, Content_Length="5")) == 400
    for start in (GRPC_WRITE, HTTP2):
        assert SECRET[:20] not in ask(door.port, start)


def test_another_user_of_the_machine_reads_nothing_even_with_the_token(door: Door) -> None:
    """A token can be seen in the list of processes while a browser is opened."""
    if not sys.platform.startswith("linux") or os.getuid() != 0:
        pytest.skip("needs Linux and the right to become another user")
    script = (
        "import os, sys, urllib.request, encodings.idna; os.setuid(int(sys.argv[1]));"
        f"urllib.request.urlopen({door.data_url!r})"
    )
    other, ours = (
        subprocess.run(
            [sys.executable, "-I", "-c", script, user], capture_output=True, text=True, check=False
        )
        for user in ("65534", "0")
    )
    assert "HTTP Error 403" in other.stderr
    assert ours.returncode == 0, ours.stderr


def test_a_connection_that_says_nothing_is_closed(
    door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daq.live.door, "HEADER_S", 0.2)
    before = time.monotonic()
    assert ask(door.port, b"GET / HTTP/1.1\r\nHost: ") == b""
    assert time.monotonic() - before < 5.0


def test_only_so_many_viewers_read_at_once(door: Door) -> None:
    with contextlib.ExitStack() as stack:
        path = "/" + door.data_url.split("/", 3)[3]
        request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
        big = ViewFile(Path("/dev/zero")) if Path("/dev/zero").exists() else None
        if big is None:
            pytest.skip("needs an endless file")
        big.size = None
        endless = Door(big, PAGE, 0)
        stack.callback(endless.close)
        request = request.replace(path.encode(), b"/" + endless.data_url.split("/", 3)[3].encode())
        for _ in range(MOST_VIEWERS):
            viewer = stack.enter_context(socket.create_connection(("127.0.0.1", endless.port)))
            viewer.sendall(request)
            assert viewer.recv(100)
        assert status(ask(endless.port, request)) == 503


@pytest.fixture(scope="module")
def view() -> Iterator[LiveView]:
    made = LiveView("attacked", isometric_layout(), page=False, port=0)
    assert made.error is None
    yield made
    made.close()


def newest(view: LiveView) -> bytes:
    """What a viewer that connects now is sent at once."""
    with urllib.request.urlopen(view.data_url, timeout=30.0) as data:
        return bytes(data.read1(1 << 16))


def test_a_crowd_neither_keeps_the_user_out_nor_costs_the_viewer_its_screen(view: LiveView) -> None:
    with urllib.request.urlopen(view.data_url, timeout=30.0) as screen:
        assert screen.read1(1 << 16).startswith(b"RRF2")
        with crowd(view.port, CROWD):
            assert newest(view).startswith(b"RRF2")
            time.sleep(0.3)
            process = psutil.Process(view.pid)
            held = [c for c in process.net_connections("tcp") if c.status == "ESTABLISHED"]
            assert len(held) <= MOST_STRANGERS + 10
            assert process.num_fds() < 200
            view.series(names.PRESSURE, np.arange(100) * 1e-3, np.arange(100.0))
            assert screen.read1(1 << 16)
            assert newest(view).startswith(b"RRF2")
    assert view.error is None


def test_a_flood_of_strangers_reads_nothing_and_the_view_goes_on(view: LiveView) -> None:
    seen = flood(view.port, FLOOD, limit_s=600.0)
    assert seen.connections == FLOOD
    assert set(seen.statuses) <= {"400", "403", "none"}
    assert seen.content == 0
    assert newest(view).startswith(b"RRF2")
    assert view.error is None
    print(f"\n{CROWD} idle, {seen.connections} requests: {seen.statuses}, {seen.content} bytes")


def test_a_client_of_rerun_cannot_write_into_the_recording(view: LiveView, tmp_path: Path) -> None:
    """A second writer's curve was on the screen of the run."""
    script = (
        "import rerun as rr, sys;"
        "rec = rr.RecordingStream('pamrig', recording_id='attacked');"
        f"rec.connect_grpc('rerun+http://127.0.0.1:{view.port}/proxy');"
        "rec.log('evil', rr.Scalars(666.0));"
        "rec.flush(timeout_sec=2.0)"
    )
    writer = [sys.executable, "-c", script]
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run(writer, capture_output=True, timeout=30.0, check=False)
    view.series(names.FORCE, [0.0], [1.0])
    time.sleep(0.3)
    with urllib.request.urlopen(view.data_url, timeout=30.0) as data:
        got, end = b"", time.monotonic() + 1.0
        while time.monotonic() < end and b"force/" not in got:
            got += data.read1(1 << 16)
    assert b"evil" not in got
    assert view.error is None
