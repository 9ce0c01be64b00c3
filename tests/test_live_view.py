"""A viewer that is absent, frozen, killed or broken: the test that feeds it never notices."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

import daq.live.live
from analysis.layouts import layouts as names
from analysis.layouts.layouts import isometric_layout
from daq.live.layout import LiveLayout
from daq.live.live import LiveView
from daq.live.queue import DropQueue
from daq.live.scene import Scene
from daq.live.web import (
    POLICY,
    ViewerError,
    WebViewer,
    free_port,
    viewer_environment,
    viewer_program,
)

pytestmark = pytest.mark.realtime
CLOSE_S = 30.0
"""A viewer that never reads would hold it up for ever; a busy machine may take its time."""
QUIET = bool(os.environ.get("PAMRIG_CAMPAIGN"))
JPEG = b"\xff\xd8" + bytes(range(256)) * 400  # 100 kB that no viewer here decodes


@pytest.fixture(scope="module", autouse=True)
def patience() -> Iterator[None]:
    """A busy machine may take longer to start the viewer's server than a user would wait."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(daq.live.live, "START_S", 300.0)
        yield


def feed(view: LiveView, seconds: float, frames_hz: float = 20.0) -> np.ndarray:
    """Push as a test does, a batch a millisecond; returns seconds each push took."""
    took = []
    start = time.perf_counter()
    k = 0
    while (now := time.perf_counter() - start) < seconds:
        before = time.perf_counter()
        t = now + np.arange(5) * 2e-4
        view.series(names.PRESSURE, t, np.sin(t))
        view.series(names.FORCE, t, np.cos(t))
        if k % round(1000 / frames_hz) == 0:
            view.image(names.CAMERA, now, JPEG, [((0, 0), (0, 100), "edge")])
            view.points(names.POINTS, 100 + now, now, "60 mm")
            view.state(names.STATE, now, "settle")
        took.append(time.perf_counter() - before)
        k += 1
        time.sleep(max(0.0, start + k * 1e-3 - time.perf_counter()))
    return np.array(took)


def check_free(took: np.ndarray) -> None:
    """Nobody waited for a viewer; on a quiet machine, not for 10 ms either."""
    assert np.median(took) < 0.001
    assert np.max(took) < 1.0
    if QUIET:
        assert np.quantile(took, 0.999) < 0.010


def ended(viewer: subprocess.Popen, file: Path) -> None:
    """Let a viewer write down what the server had sent by its end, then end it."""
    size, since = -1, time.monotonic()
    while time.monotonic() - since < 1.0:
        if (now := file.stat().st_size) != size:
            size, since = now, time.monotonic()
        time.sleep(0.05)
    viewer.terminate()
    viewer.wait()


def close_in_time(view: LiveView) -> None:
    before = time.perf_counter()
    view.close()
    assert time.perf_counter() - before < CLOSE_S
    view.close()  # again: nothing happens


def client(view: LiveView, folder) -> subprocess.Popen:
    """A real viewer client without a window: it saves what the server sends."""
    command = [str(viewer_program()), "--save", str(folder / "seen.rrd")]
    command += ["--bind", "127.0.0.1", "--port", str(free_port(0)), view.url]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env=viewer_environment(folder), **quiet)
    end = time.monotonic() + 120.0
    while not (folder / "seen.rrd").exists() and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(0.5)
    return process


def curves_in(path) -> dict[str, np.ndarray]:
    """(n, 2) time in s and value of every curve in a file, in order of time."""
    import warnings

    import rerun.chunk

    parts: dict[str, list[np.ndarray]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for chunk in rerun.chunk.RrdReader(str(path)).stream():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name.endswith("Scalars:scalars"):
                    at = batch.column("time").to_numpy(zero_copy_only=False)
                    at_s = at.astype("timedelta64[ns]").astype(np.int64) * 1e-9
                    values = np.array([row[0] for row in batch.column(name).to_pylist()])
                    entity = str(chunk.entity_path).strip("/")
                    parts.setdefault(entity, []).append(np.column_stack((at_s, values)))
    joined = {entity: np.concatenate(p) for entity, p in parts.items()}
    return {e: c[np.argsort(c[:, 0], kind="stable")] for e, c in joined.items()}


def seen(path) -> dict[str, int]:
    """Rows by entity in a file of the viewer's."""
    import warnings

    import rerun.chunk

    rows: dict[str, int] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for chunk in rerun.chunk.RrdReader(str(path)).stream():
            batch = chunk.to_record_batch()
            if any("Scalars" in name for name in batch.schema.names):
                entity = str(chunk.entity_path)
                rows[entity] = rows.get(entity, 0) + batch.num_rows
    return rows


def test_nobody_looks():
    view = LiveView("absent", isometric_layout(), port=0)
    assert view.error is None
    took = feed(view, 2.0)
    check_free(took)
    assert view.dropped == 0
    close_in_time(view)


def test_server_listens_on_loopback_only():
    view = LiveView("loopback", isometric_layout(), port=0)
    port = int(view.url.split(":")[-1].split("/")[0])
    here = [c for c in psutil.Process().net_connections("tcp") if c.laddr.port == port]
    assert {c.laddr.ip for c in here if c.status == "LISTEN"} == {"127.0.0.1"}
    close_in_time(view)


def test_a_client_that_connects_and_never_reads():
    view = LiveView("mute", isometric_layout(), port=0, memory="16MB")
    port = int(view.url.split(":")[-1].split("/")[0])
    with socket.create_connection(("127.0.0.1", port)) as mute:
        mute.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n")
        took = feed(view, 2.0)
        check_free(took)
        assert view.error is None
        close_in_time(view)


def test_a_viewer_frozen_in_the_middle(tmp_path):
    view = LiveView("frozen", isometric_layout(), port=0, memory="16MB")
    viewer = client(view, tmp_path)
    try:
        feed(view, 0.5)
        viewer.send_signal(19)  # SIGSTOP
        before = psutil.Process().memory_info().rss
        took = feed(view, 4.0, frames_hz=100.0)  # 10 MB/s, past every buffer on the way
        grown = psutil.Process().memory_info().rss - before
        check_free(took)
        assert grown < 150e6
        close_in_time(view)
    finally:
        viewer.kill()
        viewer.wait()


def test_a_viewer_killed_in_the_middle_and_another_that_comes_later(tmp_path):
    view = LiveView("killed", isometric_layout(), port=0)
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    viewer = client(view, first)
    feed(view, 0.3)
    viewer.kill()
    viewer.wait()
    took = feed(view, 1.0)
    check_free(took)
    late = client(view, second)
    try:
        feed(view, 0.5)
        close_in_time(view)
    finally:
        ended(late, second / "seen.rrd")
    rows = seen(second / "seen.rrd")
    assert rows[f"/{names.PRESSURE}"] > 100  # also what came before it connected
    assert view.dropped == 0


def test_a_viewer_that_blocks_for_ever_costs_only_the_newest_picture(monkeypatch):
    """What ``log`` does when its buffers are full, done for certain."""
    release = threading.Event()
    monkeypatch.setattr(Scene, "series", lambda *_: release.wait(30.0))
    monkeypatch.setattr(daq.live.live, "CLOSE_S", 1.0)
    queue = DropQueue(bulk_bytes=200_000)
    view = LiveView("stuck", isometric_layout(), port=0, queue=queue)
    took = feed(view, 2.0, frames_hz=50.0)
    check_free(took)
    assert view.dropped > 100
    assert queue.held_bytes <= 200_000
    close_in_time(view)
    assert "did not accept" in view.error
    release.set()


def test_without_the_viewer_installed_the_test_runs_and_the_view_says_why(monkeypatch):
    for name in [n for n in sys.modules if n.split(".")[0] == "rerun"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rerun", None)
    view = LiveView("missing", isometric_layout(), port=0, web=True)
    assert "rerun" in view.error
    view.series(names.FORCE, [0.0], [1.0])
    view.text(0.0, "hello")
    assert view.dropped == 2
    close_in_time(view)


def test_a_taken_port_is_left_to_its_owner():
    with socket.socket() as owner:
        owner.bind(("127.0.0.1", 0))
        owner.listen()
        taken = owner.getsockname()[1]
        view = LiveView("second", isometric_layout(), port=taken)
        assert view.error is None
        assert f":{taken}/" not in view.url
        close_in_time(view)


def test_nonsense_is_refused_and_counted_and_the_rest_is_still_shown(tmp_path):
    view = LiveView("nonsense", isometric_layout(), port=0)
    viewer = client(view, tmp_path)
    view.series(names.FORCE, [0.0, 1.0], [1.0])
    view.series(names.FORCE, "when", "what")
    view.points(names.POINTS, [1.0], [1.0, 2.0], "x")
    view.image(names.CAMERA, 0.0, None)
    view.image(names.CAMERA, 0.0, b"no jpeg", [("a", "b")])
    view.state(names.STATE, "soon", "x")
    view.series("", [0.0], [0.0])
    view.points("nowhere/at_all", 1.0, 1.0, "x")
    assert view.dropped >= 6
    view.series(names.FORCE, np.arange(10) * 0.1, np.arange(10))
    close_in_time(view)
    ended(viewer, tmp_path / "seen.rrd")
    assert seen(tmp_path / "seen.rrd")[f"/{names.FORCE}"] == 10


def test_series_nobody_planned_for_are_drawn_and_no_more_than_100_points_a_second(tmp_path):
    view = LiveView("extra", isometric_layout(), port=0)
    viewer = client(view, tmp_path)
    t = np.arange(5_000) * 1e-3
    for part in np.split(t, 100):
        view.series("prediction/force_n", part, np.sin(part))
        view.series("force/predicted_n", part, np.cos(part))
        view.series(names.PRESSURE, part, part)
    close_in_time(view)
    ended(viewer, tmp_path / "seen.rrd")
    rows = seen(tmp_path / "seen.rrd")
    for path in ("prediction/force_n", "force/predicted_n", names.PRESSURE):
        assert 250 <= rows[f"/{path}"] <= 501, path


def test_a_staircase_is_drawn_by_its_steps_in_order_and_carried_on(tmp_path):
    view = LiveView("steps", isometric_layout(), port=0)
    viewer = client(view, tmp_path)
    t = np.arange(3_000) * 1e-3
    for k, part in enumerate(np.split(t, 60)):
        view.series(names.PRESSURE, part, part)
        view.series(names.SET_POINT, part, np.floor(part) * 100.0)
        if k % 20 == 5:
            view.series(names.SET_LENGTH, part[:1], [55.0 + k])
            time.sleep(0.4)
    close_in_time(view)
    ended(viewer, tmp_path / "seen.rrd")
    curves = curves_in(tmp_path / "seen.rrd")
    steps = curves[names.SET_POINT]
    assert np.array_equal(steps[:, 1], np.floor(steps[:, 0] + 1e-9) * 100.0)
    lengths = curves[names.SET_LENGTH]
    assert np.array_equal(lengths[:, 1], 60.0 + 20.0 * np.floor(lengths[:, 0] - 0.25 + 1e-9))
    assert lengths[-1, 0] == pytest.approx(2.999)
    assert len(steps) < 20


def test_an_empty_layout_still_shows_what_it_is_handed():
    view = LiveView("bare", LiveLayout("bare", ()), port=0)
    view.series("a/b", [0.0], [1.0])
    view.state("c", 0.0, "on")
    close_in_time(view)
    assert view.error is None
    assert view.dropped == 0


def test_after_closing_items_are_counted_as_dropped():
    view = LiveView("closed", isometric_layout(), port=0)
    view.close()
    view.series(names.FORCE, [0.0], [0.0])
    view.state(names.STATE, 0.0, "x")
    assert view.dropped == 2


def test_the_page_is_served_on_loopback_under_a_policy_and_reports_nothing(tmp_path):
    import urllib.request

    with LiveView("page", isometric_layout(), port=0, web=True) as view:
        assert view.web_error is None
        with urllib.request.urlopen(view.web_url, timeout=60.0) as page:
            assert page.headers["Content-Security-Policy"] == POLICY
            assert b"Rerun" in page.read()
        assert "tel.rerun.io" not in POLICY
        program = psutil.Process(view._web.pid)
        assert program.environ()["CI"] == "1"
        assert program.environ()["XDG_CONFIG_HOME"] != ""
        ports = [psutil.Process(), program]
        listening = [c for p in ports for c in p.net_connections("tcp") if c.status == "LISTEN"]
        assert listening
        assert {c.laddr.ip for c in listening} == {"127.0.0.1"}
    assert not program.is_running()


def test_a_page_that_does_not_come_up_is_named(tmp_path):
    with pytest.raises(ViewerError, match="rerun viewer"):
        WebViewer([str(tmp_path / "missing.rrd")], port=0)
