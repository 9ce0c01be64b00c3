"""The lower edge of a cloud of points: where a clock runs whose messages only come late."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def lower_edge(x: Floats, y: Floats) -> tuple[float, float]:
    """(value at x = 0, slope) of the edge of the lower convex hull at the mean of ``x``.

    Of all lines below all points it has the smallest sum of distances to them (S. Moon, P. Skelly,
    D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM
    1999).

    Args:
        x: ascending, shape (n,), at least two different values.
        y: shape (n,).
    """
    hull: list[int] = []
    for k in range(len(x)):
        while len(hull) >= 2:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (x[k] - x[a]) < (y[k] - y[a]) * (x[b] - x[a]):
                break
            hull.pop()
        hull.append(k)
    middle = float(x.mean())
    right = next(i for i in range(1, len(hull)) if x[hull[i]] >= middle)
    a, b = hull[right - 1], hull[right]
    slope = float((y[b] - y[a]) / (x[b] - x[a]))
    return float(y[a] - slope * x[a]), slope
