"""Measures the muscle length in camera frames."""

import os as _os

# Limits the number of pixels that OpenCV allocates for a picture; set before OpenCV is loaded.
# Bench cameras have up to 20 million pixels, but a small file can declare a thousand million.
# If a program loads OpenCV before pamrig, OpenCV's default limit applies.
_most = _os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "25000000")
MOST_PIXELS = int(_most) if _most.isdigit() else 25_000_000
