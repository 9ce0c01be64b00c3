"""What a technician sees in the browser. Run by ``make look``."""

from __future__ import annotations

import pytest

from daq.live.layout import GREEN, ORANGE, SKY, VERMILLION, YELLOW
from tests.look.browser import find_browser
from tests.look.live import look_at_live, look_at_run, pixels_of

pytestmark = [
    pytest.mark.look,
    pytest.mark.skipif(find_browser() is None, reason="no Chromium; set PAMRIG_BROWSER"),
]


def test_live_view_draws_every_panel(tmp_path):
    picture = look_at_live(tmp_path / "live.png")
    height, width = picture.shape[:2]
    left, right = picture[:, : width // 2], picture[:, width // 2 :]
    for colour in (SKY, ORANGE, GREEN, YELLOW, VERMILLION):  # pressure, set-point, force, ...
        assert pixels_of(left, colour) > 200, colour
    chart = right[: height * 45 // 100]
    for colour in (SKY, ORANGE, GREEN, YELLOW):  # one curve a length
        assert pixels_of(chart, colour) > 150, colour
    camera = right[height // 2 : height * 3 // 4, : width // 4]
    assert (camera.mean(axis=2) > 150).mean() > 0.3  # the light ground of the frame
    assert pixels_of(camera, ORANGE) > 50  # an edge


def test_view_of_a_recorded_run_draws_it(tmp_path):
    from tests.test_live_viewfile import small_run

    picture = look_at_run(small_run(tmp_path).folder, tmp_path / "run.png")
    assert pixels_of(picture, SKY) > 300
    assert pixels_of(picture, GREEN) > 300
