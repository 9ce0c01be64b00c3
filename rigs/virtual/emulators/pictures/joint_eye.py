"""Pictures of the marks of a simulated joint: one beside its axis, one on the link that turns.

The camera is the one that the shipped calibration `configs/marks/joint-camera.toml` was made with,
from drawn pictures of a board. What it sees is drawn without any use of that file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.errors import ConfigError
from rigs.virtual.emulators.pictures.marks import Drawn, MarkCamera, draw_moving

CAMERA = MarkCamera(k1=-0.12, tilt_deg=(4.0, -3.0), distance_mm=260.0)
BASE_MM = (-40.0, 0.0)
"""Middle of the reference; the axis of the joint is at 0, 0."""
LINK_MM = 35.0
"""Distance of the middle of the link's mark from the axis."""
EXPOSURE_S = 4e-3
SHARP_PX = 0.2
"""A mark that moves less in an exposure is drawn once."""
MOST_INSTANTS = 12
DICTIONARY = "4x4_50"


class JointEye:
    """What the camera of a virtual joint sees.

    Args:
        marks: plain values of `vision.pose.measure.MarkSettings`.
        mark: which of them is on the link.
        angle_deg: of the mark at this moment, with the error of how it was fixed.
        rate_deg_s: how fast it turns.
        rng: of the noise of the sensor.
        blur_px, noise: of the pictures.
        source: the rig file, for messages.

    Raises:
        ConfigError: the marks are of a set whose patterns are not drawn.
    """

    def __init__(
        self,
        marks: Mapping[str, Any],
        mark: str,
        angle_deg: Callable[[], float],
        rate_deg_s: Callable[[], float],
        rng: np.random.Generator,
        blur_px: float = 0.8,
        noise: float = 2.0,
        source: str = "",
    ) -> None:
        if marks["dictionary"] != DICTIONARY:
            raise ConfigError(
                f"{source}: camera.marks", f"the virtual bench draws marks of {DICTIONARY} only",
                "use that dictionary, or a real camera",
            )  # fmt: skip
        by_name = {values["name"]: values for values in marks["marks"]}
        reference = marks["reference"]
        self._base = _body(by_name[reference]) if reference else None
        self._link = _body(by_name[mark])
        self._angle_deg, self._rate_deg_s = angle_deg, rate_deg_s
        self._rng = rng
        self._camera = replace(CAMERA, blur_px=blur_px, noise=noise)

    def picture(self) -> npt.NDArray[np.uint8]:
        """One picture, (height, width), whose exposure begins now."""
        angle, rate = self._angle_deg(), self._rate_deg_s()
        scale = self._camera.focal_px / self._camera.distance_mm
        smear_px = abs(math.radians(rate)) * EXPOSURE_S * (LINK_MM + self._link.side_mm) * scale
        number = 1 if smear_px < SHARP_PX else min(MOST_INSTANTS, 1 + math.ceil(3.0 * smear_px))
        at_s = EXPOSURE_S * (np.arange(number) + 0.5) / number if number > 1 else [0.0]
        instants = [self._bodies(angle + rate * float(s)) for s in at_s]
        return draw_moving(instants, self._rng, self._camera)

    def _bodies(self, angle_deg: float) -> list[Drawn]:
        """Both marks where the link is at an angle."""
        turn = math.radians(angle_deg)
        link = replace(
            self._link, x_mm=LINK_MM * math.cos(turn), y_mm=LINK_MM * math.sin(turn),
            angle_deg=angle_deg + self._link.angle_deg,
        )  # fmt: skip
        return [link] if self._base is None else [self._base, link]


def _body(values: Mapping[str, Any]) -> Drawn:
    """A mark or a board; beside the axis, and as it is turned on its body."""
    board = values["board"]
    out = Drawn(
        values["number"], values["side_mm"], *BASE_MM, values["turned_deg"], values["height_mm"]
    )
    if board is None:
        return out
    return replace(
        out, number=board["first_id"], side_mm=board["square_mm"], columns=board["columns"],
        rows=board["rows"], mark_mm=board["mark_mm"],
    )  # fmt: skip
