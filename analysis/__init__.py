"""Analysis of runs: tables, uncertainties, findings, figures, reports, exports. No hardware."""

import vision as _vision  # noqa: F401 - limits picture sizes before OpenCV is loaded
