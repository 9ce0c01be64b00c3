"""A viewer that is absent, frozen, killed or broken: the test that feeds it never notices."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

import daq.live.live
import daq.live.page
from analysis.layouts import layouts as names
from analysis.layouts.layouts import isometric_layout
from daq.live.layout import LiveLayout
from daq.live.live import LiveView
from daq.live.page import ViewerError, page_files, viewer_environment, viewer_program
from daq.live.queue import DropQueue

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
    command += ["--bind", "127.0.0.1", "--port", "auto", view.data_url]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env=viewer_environment(folder), **quiet)
    end = time.monotonic() + 120.0
    while not (folder / "seen.rrd").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert view.wait_for_viewer(60.0)
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


def styled(path) -> set[str]:
    """Entities of a file that have a style of their curve."""
    import warnings

    import rerun.chunk

    found = set()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for chunk in rerun.chunk.RrdReader(str(path)).stream():
            if any("SeriesLines:" in name for name in chunk.to_record_batch().schema.names):
                found.add(str(chunk.entity_path))
    return found


def test_nobody_looks():
    view = LiveView("absent", isometric_layout(), page=False, port=0)
    assert view.error is None
    took = feed(view, 2.0)
    check_free(took)
    assert view.dropped == 0
    close_in_time(view)


def test_the_run_listens_nowhere_and_the_viewer_s_process_on_one_port_of_this_machine():
    """Rerun's server stood in the run's own process, and took data from anybody."""
    before = psutil.Process().net_connections()
    view = LiveView("loopback", isometric_layout(), page=False, port=0)
    assert psutil.Process().net_connections() == before
    viewer = psutil.Process(view.pid)
    listening = [c.laddr for c in viewer.net_connections() if c.status == "LISTEN"]
    assert [(place.ip, place.port) for place in listening] == [("127.0.0.1", view.port)]
    assert not any(view.url.split("/")[3] in word for word in viewer.cmdline())
    close_in_time(view)
    assert not viewer.is_running()


def test_a_client_that_connects_and_never_reads():
    view = LiveView("mute", isometric_layout(), page=False, port=0, memory=16_000_000)
    with socket.create_connection(("127.0.0.1", view.port)) as mute:
        path = view.data_url.split("/", 3)[3]
        mute.sendall(f"GET /{path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        assert view.wait_for_viewer(60.0)
        took = feed(view, 2.0, frames_hz=100.0)
        check_free(took)
        assert view.error is None
        assert psutil.Process(view.pid).memory_info().rss < 400e6
        close_in_time(view)


def test_a_viewer_s_process_that_is_stopped():
    """The pipe fills, the queue drops its oldest items, and closing does not wait for it."""
    queue = DropQueue(bulk_bytes=200_000)
    view = LiveView("stopped", isometric_layout(), page=False, port=0, queue=queue)
    os.kill(view.pid, signal.SIGSTOP)
    took = feed(view, 3.0, frames_hz=100.0)
    check_free(took)
    assert view.dropped > 100
    assert queue.held_bytes <= 200_000
    close_in_time(view)
    assert "did not accept" in view.error


def test_a_viewer_s_process_that_is_killed_is_stated_once(caplog):
    view = LiveView("killed", isometric_layout(), page=False, port=0)
    feed(view, 0.2)
    os.kill(view.pid, signal.SIGKILL)
    took = feed(view, 1.0)
    check_free(took)
    assert view.error == "the viewer's process ended (status -9)"
    assert [r.message for r in caplog.records].count(f"live view: {view.error}") == 1
    assert view.dropped > 100
    close_in_time(view)


def test_the_viewer_s_process_does_not_outlive_the_run():
    script = (
        "from daq.live.live import LiveView; import os, time;"
        "from analysis.layouts.layouts import isometric_layout;"
        "view = LiveView('x', isometric_layout(), page=False, port=0);"
        "print(view.pid, flush=True); time.sleep(100)"
    )
    run = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    with run:
        viewer = psutil.Process(int(run.stdout.readline()))
        run.kill()
    viewer.wait(10.0)


def test_a_viewer_frozen_in_the_middle(tmp_path):
    view = LiveView("frozen", isometric_layout(), page=False, port=0, memory=16_000_000)
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
    view = LiveView("killed", isometric_layout(), page=False, port=0)
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


def test_without_the_viewer_installed_the_test_runs_and_the_view_says_why(tmp_path, monkeypatch):
    (tmp_path / "rerun.py").write_text("raise ImportError('no rerun here')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    view = LiveView("missing", isometric_layout(), port=0)
    assert "no rerun here" in view.error
    view.series(names.FORCE, [0.0], [1.0])
    view.text(0.0, "hello")
    assert view.dropped == 2
    close_in_time(view)


def test_a_taken_port_is_left_to_its_owner():
    with socket.socket() as owner:
        owner.bind(("127.0.0.1", 0))
        owner.listen()
        taken = owner.getsockname()[1]
        view = LiveView("second", isometric_layout(), page=False, port=taken)
        assert view.error is None
        assert view.port != taken
        close_in_time(view)


def test_nonsense_is_refused_and_counted_and_the_rest_is_still_shown(tmp_path):
    view = LiveView("nonsense", isometric_layout(), page=False, port=0)
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
    view = LiveView("extra", isometric_layout(), page=False, port=0)
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
    view = LiveView("steps", isometric_layout(), page=False, port=0)
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
    view = LiveView("bare", LiveLayout("bare", ()), page=False, port=0)
    view.series("a/b", [0.0], [1.0])
    view.state("c", 0.0, "on")
    close_in_time(view)
    assert view.error is None
    assert view.dropped == 0


def test_after_closing_items_are_counted_as_dropped():
    view = LiveView("closed", isometric_layout(), page=False, port=0)
    view.close()
    view.series(names.FORCE, [0.0], [0.0])
    view.state(names.STATE, 0.0, "x")
    assert view.dropped == 2


def test_an_old_picture_goes_before_what_every_viewer_needs(tmp_path):
    """A viewer that comes late to a long test misses its oldest data, and nothing else."""
    view = LiveView("long", isometric_layout(), page=False, port=0, memory=2_000_000)
    feed(view, 2.0, frames_hz=50.0)
    viewer = client(view, tmp_path)
    feed(view, 0.3)
    close_in_time(view)
    ended(viewer, tmp_path / "seen.rrd")
    assert (tmp_path / "seen.rrd").stat().st_size < 4_000_000
    assert curves_in(tmp_path / "seen.rrd")[names.PRESSURE][-1, 0] > 0.2
    assert f"/{names.PRESSURE}" in styled(tmp_path / "seen.rrd")


def test_the_page_comes_from_a_program_that_reports_nothing_and_has_ended(monkeypatch):
    started = []

    class Watched(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            started.append((self, kwargs["env"]))

    monkeypatch.setattr(daq.live.page.subprocess, "Popen", Watched)
    files = page_files()
    assert b"Rerun" in files["index.html"].content
    assert files["re_viewer_bg.wasm"].content[:4] == b"\0asm"
    ((program, environment),) = started
    assert program.poll() is not None
    assert environment["CI"] == "1"
    assert environment["XDG_CONFIG_HOME"] != os.environ.get("XDG_CONFIG_HOME")


def test_a_page_that_does_not_come_up_is_named_and_its_program_is_ended(monkeypatch):
    monkeypatch.setattr(daq.live.page, "START_S", 0.0)
    with pytest.raises(ViewerError, match="no page within"):
        page_files()
