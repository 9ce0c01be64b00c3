"""What goes wrong with frames: specks, glare, missing rows, compression."""

from __future__ import annotations

import cv2
import numpy as np


def jpeg(frame, quality=75):
    data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)


def specks(frame, rng, kind, share=0.05):
    out = frame.copy()
    if kind == "blobs":
        for _ in range(int(share * frame.size / (np.pi * 4))):
            at = int(rng.integers(frame.shape[1])), int(rng.integers(frame.shape[0]))
            cv2.circle(out, at, 2, int(rng.integers(0, 60)), -1)
        return out
    hit = rng.random(frame.shape) < share
    value = {
        "black": np.zeros_like(frame),
        "white": np.full_like(frame, 255),
        "any": rng.integers(0, 256, frame.shape, dtype=np.uint8),
    }[kind]
    out[hit] = value[hit]
    return out


def missing_rows(frame, rng, kind):
    out = frame.copy()
    height = frame.shape[0]
    if kind.startswith("block"):
        first = int(rng.integers(0, height * 3 // 4))
        rows = np.arange(first, first + height // 4)
    else:
        rows = rng.permutation(height)[: height // 4]
    out[rows] = {"black": 0, "white": 255}[kind.split()[1]]
    return out


def glare(frame, rng, angle_deg):
    """A band of added light, hard or soft, clipped as a sensor clips."""
    height, width = frame.shape
    a = np.radians(angle_deg)
    x = np.arange(width)[None, :] - width * rng.uniform(0.1, 0.9)
    y = np.arange(height)[:, None] - height * rng.uniform(0.1, 0.9)
    d = x * np.cos(a) + y * np.sin(a)
    half = rng.uniform(10, 50)
    light = rng.uniform(30, 150)
    band = light * (np.abs(d) < half if rng.random() < 0.5 else np.exp(-0.5 * (d / half) ** 2))
    return np.clip(frame + band, 0, 255).astype(np.uint8)
