"""Several markers along a muscle: strain and bending against drawn pictures."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import ndtr
from typer.testing import CliRunner

from cli.main import app
from vision.marker.several import MarkerRow, measure_markers, strain

GAPS = (60.0, 70.0, 80.0)
WIDTH_PX, HEIGHT_PX, BLUR_PX = 30.0, 110.0, 0.9


Place = tuple[float, float, float]


def bars(gaps: tuple[float, ...], turn: float = 0.0, x0: float = 100.3) -> list[Place]:
    """Middle and angle (y up) of straight bars; ``gaps`` are between the middles of their edges.

    From the facing edge of the first bar to that of the last the angle grows evenly.
    """
    spans = [g + WIDTH_PX * (1.0 if 0 < k < len(gaps) - 1 else 0.5) for k, g in enumerate(gaps)]
    x, y, angle = x0, 240.0, -turn / 2.0
    out = [(x, y, angle)]
    for gap, span in zip(gaps, spans, strict=True):
        each = turn * span / sum(spans)
        for size, way in ((WIDTH_PX / 2, angle), (gap, angle + each / 2),
                          (WIDTH_PX / 2, angle + each)):  # fmt: skip
            x, y = x + size * math.cos(way), y - size * math.sin(way)
        angle += each
        out.append((x, y, angle))
    return out


def draw(places: list[Place], rng: np.random.Generator, noise: float = 2.0) -> np.ndarray:
    """Dark bars through a Gaussian blur; a pixel is the mean of 3 x 3 places of Gauss."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    reach = round(0.5 * math.hypot(WIDTH_PX, HEIGHT_PX)) + 8
    frame = np.full((480, 640), 195.0)
    for x, y, angle in places:
        columns = np.arange(int(x) - reach, int(x) + reach)
        rows = np.arange(int(y) - reach, int(y) + reach)
        for p, wp in zip(nodes / 2, weights / 2, strict=True):
            for q, wq in zip(nodes / 2, weights / 2, strict=True):
                dx, dy = columns[None, :] + 0.5 + p - x, rows[:, None] + q - y
                along = dx * math.cos(angle) - dy * math.sin(angle)
                across = dx * math.sin(angle) + dy * math.cos(angle)
                cover = _bar(along, WIDTH_PX) * _bar(across, HEIGHT_PX)
                frame[np.ix_(rows, columns)] -= 150.0 * wp * wq * cover
    return np.clip(np.rint(frame + rng.normal(0.0, noise, frame.shape)), 0, 255).astype(np.uint8)


def _bar(value: np.ndarray, size: float) -> np.ndarray:
    return np.asarray(
        ndtr((value + size / 2) / BLUR_PX) - ndtr((value - size / 2) / BLUR_PX), np.float64
    )


def test_gaps_and_strain_are_right_within_their_uncertainty() -> None:
    rng = np.random.default_rng(1)
    rest = measure_markers(draw(bars(GAPS), rng), 4)
    longer = tuple(g * f for g, f in zip(GAPS, (1.01, 0.98, 1.0), strict=True))
    now = measure_markers(draw(bars(longer), rng), 4)
    for row, gaps in ((rest, GAPS), (now, longer)):
        assert row.trusted, row.reason
        for segment, gap in zip(row.segments, gaps, strict=True):
            assert abs(segment.pixels - gap) < 3.0 * segment.u_pixels < 0.06
        assert abs(row.turn) < 3.0 * row.u_turn < 0.003
    found = strain(now, rest)
    for value, u, truth in zip(found.segments, found.u_segments, (0.01, -0.02, 0.0), strict=True):
        assert abs(value - truth) < 3.0 * u < 1e-3
    assert abs(found.mean - (sum(longer) / sum(GAPS) - 1.0)) < 3.0 * found.u_mean


@pytest.mark.parametrize("degrees", [4.0, -9.0])
def test_bending_is_right_within_its_uncertainty(degrees: float) -> None:
    places = bars(GAPS, math.radians(degrees))
    row = measure_markers(draw(places, np.random.default_rng(2)), 4)
    assert row.trusted, row.reason
    assert abs(row.turn - math.radians(degrees)) < 3.0 * row.u_turn < 0.02
    for segment, gap in zip(row.segments, GAPS, strict=True):
        assert abs(segment.pixels - gap) < 3.0 * segment.u_pixels
    ends = [
        np.array([x, y]) + sign * 0.5 * WIDTH_PX * np.array([math.cos(a), -math.sin(a)])
        for sign, (x, y, a) in ((1.0, places[0]), (-1.0, places[-1]))
    ]
    chord = float(np.hypot(*(ends[1] - ends[0])))
    assert abs(row.chord_px - chord) < 3.0 * row.u_chord_px
    assert row.curvature == row.turn / row.arc_px


@pytest.mark.campaign
def test_many_rows_of_markers() -> None:
    """Coverage of the uncertainties of gaps and bending."""
    rng = np.random.default_rng(3)
    offs, turns = [], []
    for _ in range(60):
        turn = math.radians(rng.uniform(-9, 9))
        row = measure_markers(draw(bars(GAPS, turn, x0=rng.uniform(90, 110)), rng), 4)
        assert row.trusted, row.reason
        turns.append((row.turn - turn) / row.u_turn)
        offs += [(s.pixels - g) / s.u_pixels for s, g in zip(row.segments, GAPS, strict=True)]
    for name, z in (("gap", np.array(offs)), ("turn", np.array(turns))):
        print(name, "within k = 2:", np.mean(np.abs(z) < 2), "rms / u:", np.sqrt(np.mean(z**2)))
        assert np.mean(np.abs(z) < 2.0) > 0.9


def spoiled(kind: str) -> np.ndarray:
    image = draw(bars(GAPS), np.random.default_rng(4))
    if kind == "merged":
        image[200:280, 115:180] = 45
    elif kind == "covered":
        image[100:235, 170:245] = 195
    elif kind == "dark":
        image[360:460, 300:400] = 45
    elif kind == "border":
        image = image[200:]
    elif kind == "even":
        image[:] = 190
    return image


@pytest.mark.parametrize(
    ("kind", "markers", "words"),
    [
        ("none", 5, "4 dark bodies found, 5 markers stated"),
        ("none", 3, "4 dark bodies found, 3 markers stated"),
        ("merged", 4, "3 dark bodies found"),
        ("merged", 3, "two have merged"),
        ("covered", 4, "partly covered"),
        ("dark", 4, "5 dark bodies found"),
        ("border", 4, "reaches out of the region"),
        ("even", 4, "no markers"),
    ],
)
def test_markers_that_cannot_be_told_apart_are_refused(kind: str, markers: int, words: str) -> None:
    row = measure_markers(spoiled(kind), markers)
    assert not row.trusted
    assert words in row.reason
    assert math.isnan(row.curvature)


def test_too_much_bending_is_refused_with_the_angle() -> None:
    row = measure_markers(draw(bars(GAPS, math.radians(24.0)), np.random.default_rng(5)), 4)
    assert not row.trusted
    assert "markers" in row.reason


def test_an_untrusted_frame_has_no_strain() -> None:
    with pytest.raises(ValueError, match="trusted"):
        strain(MarkerRow(), MarkerRow())


def test_the_command(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    for k, factor in enumerate((1.0, 1.02)):
        image = draw(bars(tuple(g * factor for g in GAPS)), rng)
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
    cv2.imwrite(str(tmp_path / "2.png"), spoiled("dark"))
    done = CliRunner().invoke(app, ["strain", str(tmp_path), "--markers", "4", "--json"])
    assert done.exit_code == 0, done.output
    rest, now, bad = json.loads(done.output)
    assert rest["mean_strain_percent"] == 0.0
    assert abs(now["mean_strain_percent"] - 2.0) < 3.0 * now["u_mean_strain_percent"] < 0.1
    assert not bad["trusted"]
    assert "5 dark bodies" in bad["reason"]
    done = CliRunner().invoke(app, ["strain", str(tmp_path), "--markers", "7"])
    assert done.exit_code == 2
