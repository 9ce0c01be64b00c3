"""Initial line and levels of an edge from the area under the mean profiles of groups of rows.

The area between a profile and its lower level gives the position of a step for any blur.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def start_line(img, box, y_mid, a, b, rising, reach_l, reach_r, group):  # type: ignore[no-untyped-def]
    """Line and levels from the area under the mean profile of each group of rows.

    Returns (a, b, left levels, right levels, used flags), the last three per group of rows; a <
    0 if too few groups agree.
    """
    left, top, width, height = box
    count = height // group
    n_l = int(reach_l)
    n_r = int(reach_r)
    size = n_l + n_r
    pos = np.zeros(count)
    rel = np.zeros(count)
    lows = np.zeros(count)
    highs = np.zeros(count)
    amp = np.zeros(count)
    used = np.zeros(count, np.uint8)
    profile = np.zeros(size)
    row_lo = np.zeros(group)
    row_hi = np.zeros(group)
    flank = max(2, min(4, size // 4))
    for k in range(count):
        y0 = top + k * group
        rel[k] = y0 + 0.5 * (group - 1) - y_mid
        start = round(a + b * rel[k]) - n_l
        if start < left or start + size > left + width:
            cut = 0
            if start < left:
                cut = left - start
            if start + size > left + width:
                cut = max(cut, start + size - left - width)
            if cut > min(n_l, n_r) - 3:
                continue
        profile[:] = 0.0
        for r in range(group):
            y = y0 + r
            lo = 0.0
            hi = 0.0
            for j in range(flank):
                lo += img[y, min(max(start + j, left), left + width - 1)]
                hi += img[y, min(max(start + size - 1 - j, left), left + width - 1)]
            row_lo[r] = lo / flank
            row_hi[r] = hi / flank
        lo = np.median(row_lo)
        hi = np.median(row_hi)
        near = 0.25 * abs(hi - lo)
        n_rows = 0
        for y in range(y0, y0 + group):
            r = y - y0
            if abs(row_lo[r] - lo) <= near and abs(row_hi[r] - hi) <= near:
                n_rows += 1
                for j in range(size):
                    value = float(img[y, min(max(start + j, left), left + width - 1)])
                    profile[j] += min(max(value, min(lo, hi) - near), max(lo, hi) + near)
        if n_rows * 3 < group:
            continue
        area = 0.0
        for j in range(size):
            area += profile[j] / n_rows - lo
        amp[k] = hi - lo if rising else lo - hi
        if amp[k] <= 0.0:
            continue
        lows[k] = lo
        highs[k] = hi
        pos[k] = start + size - area / (hi - lo)
        if pos[k] < start + 1 or pos[k] > start + size - 1:
            amp[k] = 0.0
    order = np.sort(amp)
    typical = order[int(0.85 * (count - 1))]
    if typical <= 0.0:
        return -1.0, 0.0, lows, highs, used
    n = 0
    for k in range(count):
        if amp[k] > 0.45 * typical:
            used[k] = 1
            n += 1
    if n < 3:
        return -1.0, 0.0, lows, highs, used
    idx = np.flatnonzero(used)
    res = np.empty(n)
    shift = np.empty(n)
    for i in range(n):
        shift[i] = pos[idx[i]] - a - b * rel[idx[i]]
    a += np.median(shift)
    for _ in range(8):
        for i in range(n):
            res[i] = pos[idx[i]] - a - b * rel[idx[i]]
        scale = max(0.1, 1.4826 * np.median(np.abs(res)))
        s0 = s1 = s2 = r0 = r1 = 0.0
        for i in range(n):
            q = res[i] / (4.685 * scale)
            wt = max(0.0, 1.0 - q * q) ** 2
            y = rel[idx[i]]
            s0 += wt
            s1 += wt * y
            s2 += wt * y * y
            r0 += wt * res[i]
            r1 += wt * res[i] * y
        det = s0 * s2 - s1 * s1
        if det <= 1e-9 * s0 * s0 or s0 < 2.0:
            break
        da = (s2 * r0 - s1 * r1) / det
        db = (s0 * r1 - s1 * r0) / det
        a += da
        b += db
        if abs(da) < 0.005:
            break
    for i in range(n):
        res[i] = pos[idx[i]] - a - b * rel[idx[i]]
    scale = max(0.1, 1.4826 * np.median(np.abs(res)))
    for i in range(n):
        if abs(res[i]) > max(1.0, 6.0 * scale):
            used[idx[i]] = 0
    return a, b, lows, highs, used
