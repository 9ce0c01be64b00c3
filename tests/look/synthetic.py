"""A plausible isometric test fed to a live view: no physics worth the name, only its looks."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from analysis.layouts import layouts as names
from daq.live.live import LiveView

LENGTHS_MM = (55.0, 60.0, 65.0, 70.0)
PRESSURES_KPA = (100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0, 500.0)
STEP_S = 3.0


def force_n(pressure_kpa: float, length_mm: float) -> float:
    """A straight line per length, about as steep as a small muscle's."""
    return max(0.0, (pressure_kpa - 60.0) * (0.05 + 0.011 * (length_mm - 52.0)))


def frame(length_mm: float, rng: np.random.Generator) -> tuple[bytes, list[tuple]]:
    """A JPEG of two dark marks on a light ground, and the edges that were found."""
    gap = (length_mm - 40.0) / 0.11
    left, right = 200.0, 200.0 + gap
    picture = np.full((480, 640), 170, np.uint8)
    picture[:, :] += np.linspace(0, 35, 640).astype(np.uint8)
    cv2.rectangle(picture, (110, 150), (200, 330), 35, -1)
    cv2.rectangle(picture, (round(right), 150), (round(right) + 70, 330), 40, -1)
    picture = cv2.GaussianBlur(picture, (5, 5), 1.2)
    noisy = np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)
    jpeg = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
    lines = [
        ((left, 150.0), (left, 330.0), "reference"),
        ((right, 150.0), (right, 330.0), "marker"),
        ((left, 240.0), (right, 240.0), f"{gap:.2f} px = {length_mm:.3f} mm"),
    ]
    return jpeg, lines


class SyntheticTest:
    """Steps through pressures at each length and shows it all to ``view``."""

    def __init__(self, view: LiveView, seed: int = 3) -> None:
        self.view = view
        self.rng = np.random.default_rng(seed)
        self.time_s = 0.0
        self.pressure_kpa = 0.0

    def step(self, length_mm: float, target_kpa: float, direction: str) -> None:
        """One settled point: 3 s of samples in batches of 50 ms, then the point."""
        view, rng = self.view, self.rng
        view.state(names.STATE, self.time_s, "settle")
        for batch in range(round(STEP_S / 0.05)):
            t = self.time_s + np.arange(50) * 1e-3
            error = target_kpa - self.pressure_kpa
            p = target_kpa - error * np.exp(-(t - self.time_s) / 0.25)
            self.pressure_kpa = float(p[-1])
            view.series(names.PRESSURE, t, p + rng.normal(0, 0.6, 50))
            view.series(names.SET_POINT, t[:1], [target_kpa])
            ripple = 6.0 * (rng.random(50) < 0.5)
            view.series(names.INLET, t, np.clip(error * 4, 0, 100) + ripple)
            view.series(names.OUTLET, t, np.clip(-error * 4, 0, 100) + 6.0 - ripple)
            if batch % 2 == 0:
                f = force_n(self.pressure_kpa, length_mm) + rng.normal(0, 0.03)
                view.series(names.FORCE, t[:1], [f])
            if batch % 20 == 10:
                measured = length_mm + rng.normal(0, 0.004)
                jpeg, lines = frame(measured, rng)
                view.image(names.CAMERA, float(t[0]), jpeg, lines)
                view.series(names.LENGTH, t[:1], [measured])
                view.series(names.SET_LENGTH, t[:1], [length_mm])
            if batch == 40:
                view.state(names.STATE, float(t[0]), "point")
            self.time_s += 0.05
        if direction == "precondition":
            return
        label = f"{length_mm:g} mm"
        f = force_n(target_kpa, length_mm) * (1.0 if direction == "up" else 1.03)
        p = target_kpa + rng.normal(0, 0.5)
        view.points(names.POINTS, p, f + rng.normal(0, 0.05), label)
        view.text(self.time_s, f"{label}, {target_kpa:g} kPa {direction}: {f:.2f} N")

    def run(self, lengths: tuple[float, ...] = LENGTHS_MM, last_down: int = 9) -> None:
        """Every length up and down."""
        view = self.view
        view.text(0.0, "armed; preconditioning 3 cycles")
        view.state(names.FAULT, 0.0, "none")
        for cycle in range(3):
            view.state(names.STATE, self.time_s, "precondition")
            self.step(lengths[0], (400.0, 0.0, 50.0)[cycle], "precondition")
        for length_mm, direction in itertools.product(lengths, ("up", "down")):
            final = length_mm == lengths[-1] and direction == "down"
            steps = PRESSURES_KPA if direction == "up" else PRESSURES_KPA[::-1]
            view.state(names.STATE, self.time_s, "move")
            for target in steps[: last_down if final else None]:
                self.step(length_mm, target, direction)
