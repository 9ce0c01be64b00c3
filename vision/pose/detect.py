"""Finds ArUco marks and the corners of ChArUco boards, by the detectors of OpenCV.

The detectors give numbers and corners to a few tenths of a pixel. What is measured is finer: the
corner of two dark squares by `cv2.cornerSubPix`, which a blur does not move; the corner of a single
mark as the crossing of lines through its sides (`vision.pose.sides`), because `cornerSubPix` moves
the corner of one dark square inwards by about 0.1 pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DICTIONARIES = {
    f"{side}x{side}_{count}": f"DICT_{side}X{side}_{count}"
    for side in (4, 5, 6, 7)
    for count in (50, 100, 250, 1000)
}
"""Sets of marks: squares a side, and how many marks the set has."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board as printed: squares across and down, their side and that of the marks in mm.

    ``first_id`` is the number of the mark at the upper left.
    """

    columns: int
    rows: int
    square_mm: float
    mark_mm: float
    dictionary: str = "4x4_50"
    first_id: int = 0

    @property
    def marks(self) -> int:
        """How many marks the board has: one in every second square."""
        return self.columns * self.rows // 2


@dataclass(frozen=True)
class Found:
    """One mark in a picture: its number and its corners (4, 2) in pixels, upper left first."""

    number: int
    corners: Array


@lru_cache(maxsize=16)
def _dictionary(name: str) -> Any:
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[name]))


@lru_cache(maxsize=16)
def _detector(name: str) -> Any:
    import cv2

    return cv2.aruco.ArucoDetector(_dictionary(name), _parameters())


def _parameters() -> Any:
    """No correction of wrong bits: a mark is whole or is none."""
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.errorCorrectionRate = 0.0
    parameters.maxErroneousBitsInBorderRate = 0.1
    return parameters


@lru_cache(maxsize=16)
def _board_detector(board: Board) -> tuple[Any, Array]:
    import cv2

    ids = np.arange(board.first_id, board.first_id + board.marks, dtype=np.int32)
    made = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_mm, board.mark_mm,
        _dictionary(board.dictionary), ids,
    )  # fmt: skip
    parameters = cv2.aruco.CharucoParameters()
    detector = cv2.aruco.CharucoDetector(made, parameters, _parameters())
    places = np.asarray(made.getChessboardCorners(), dtype=np.float64)[:, :2]
    middle = np.array([board.columns, board.rows]) * board.square_mm / 2.0
    return detector, (places - middle) * [1.0, -1.0]


def find_marks(gray: npt.NDArray[np.uint8], dictionary: str) -> list[Found]:
    """All marks of a dictionary in a picture (h, w); a number may occur more than once."""
    corners, numbers, _ = _detector(dictionary).detectMarkers(gray)
    if numbers is None:
        return []
    return [
        Found(int(n), np.asarray(c, dtype=np.float64).reshape(4, 2))
        for n, c in zip(np.ravel(numbers), corners, strict=True)
    ]


def find_board(gray: npt.NDArray[np.uint8], board: Board) -> tuple[Array, Array]:
    """Corners of the squares of a board that are seen.

    Returns:
        Places on the board in mm from its middle, y up, (n, 2), and pixels (n, 2).
    """
    detector, places = _board_detector(board)
    corners, numbers, _, _ = detector.detectBoard(gray)
    if numbers is None or not len(np.ravel(numbers)):
        return np.empty((0, 2)), np.empty((0, 2))
    which = np.ravel(numbers).astype(int)
    rough = np.asarray(corners, dtype=np.float32).reshape(-1, 2)
    return places[which], _saddles(gray, rough, places[which], board)


def _saddles(
    gray: npt.NDArray[np.uint8], rough: npt.NDArray[np.float32], places: Array, board: Board
) -> Array:
    """Corners of dark squares, in windows that hold nothing of the marks beside them."""
    import cv2

    near = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) < 1.1 * board.square_mm
    apart = np.hypot(*(rough[:, None] - rough[None]).transpose(2, 0, 1))
    np.fill_diagonal(near, False)
    sides = apart[near]
    if not sides.size:
        return rough.astype(np.float64)
    clear = (board.square_mm - board.mark_mm) / 2.0 / board.square_mm
    half = int(np.clip(clear * sides.min() - 1.0, 2, 12))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    fine = cv2.cornerSubPix(gray, rough.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), stop)
    return np.asarray(fine, dtype=np.float64).reshape(-1, 2)
