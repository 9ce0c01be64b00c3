"""What touches a bench: drivers, rig, test execution, protocols, calibration, virtual bench."""

import vision as _vision  # noqa: F401 - bounds the pictures that OpenCV takes, before it is loaded
