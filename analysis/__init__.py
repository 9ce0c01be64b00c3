"""Runs become tables, uncertainties, findings, figures, reports and exports; free of hardware."""

import vision as _vision  # noqa: F401 - bounds the pictures that OpenCV takes, before it is loaded
