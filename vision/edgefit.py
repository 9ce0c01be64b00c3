"""Joint robust fit of one straight blurred edge to all pixels near it.

Model of the light at column x, row y (t = (y - y_mid)/half_height), d = x - a - b*(y - y_mid):

    I = L (1 + gamma d) (1 - F(d)) + H (1 + gamma d) F(d) + kappa d (2 F(d) - 1)
    L = p0 + p1 t + p2 t^2,  H = q0 + q1 t + q2 t^2

where F is the step seen by a unit pixel through a Gaussian blur of sd sigma and, where
motion shows, a box of width w: twice integrated normal density. Parameters are found by
Gauss-Newton steps with Tukey's biweight (c = 4.685, 95 % efficient on Gaussian noise);
rows in which more than a third of the pixels near the edge are outliers are left out.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

PARAMETERS = 11  # a, b, sigma, p0 p1 p2, q0 q1 q2, gamma, kappa
TABLE = 1024  # longest profile table
STEPS_A_SIGMA = 24.0
TUKEY = 4.685
GROUP = 4  # rows that share one t in the equations
BASIS_OF = (0, 0, 1, 2, 2, 2, 3, 3, 3, 4, 5)
HIST = 2048
HIST_STEP = 1.0 / 32.0
CORE_MAX = 64  # widest stored residual window

F64 = npt.NDArray[np.float64]

_SQRT_HALF = math.sqrt(0.5)
_INV_SQRT_2PI = 1.0 / math.sqrt(2.0 * math.pi)


@njit(cache=True, nogil=True)
def _phi2(t, sigma):  # type: ignore[no-untyped-def]
    """First integral of the normal distribution function."""
    z = t / sigma
    return t * 0.5 * (1.0 + math.erf(z * _SQRT_HALF)) + sigma * _INV_SQRT_2PI * math.exp(
        -0.5 * z * z
    )


@njit(cache=True, nogil=True)
def _phi3(t, sigma):  # type: ignore[no-untyped-def]
    """Second integral of the normal distribution function."""
    z = t / sigma
    cdf = 0.5 * (1.0 + math.erf(z * _SQRT_HALF))
    pdf = _INV_SQRT_2PI * math.exp(-0.5 * z * z)
    return 0.5 * ((t * t + sigma * sigma) * cdf + t * sigma * pdf)


@njit(cache=True, nogil=True)
def fill_table(sigma, w, table, core):  # type: ignore[no-untyped-def]
    """Tabulate F, dF/dd and dF/dsigma for |d| <= core at ``sigma/24`` or finer.

    Returns the number of entries to one side; entry k + side stands at d = k * step.
    """
    step = max(sigma, 0.5) / STEPS_A_SIGMA
    side = int(math.ceil(core / step)) + 1
    if side > TABLE // 2 - 1:
        side = TABLE // 2 - 1
        step = core / (side - 1)
    inv = 1.0 / sigma
    for k in range(0, side + 1):
        d = k * step
        z1 = (d + 0.5) * inv
        z0 = (d - 0.5) * inv
        if w < 0.05:
            f = _phi2(d + 0.5, sigma) - _phi2(d - 0.5, sigma)
            g = 0.5 * (math.erf(z1 * _SQRT_HALF) - math.erf(z0 * _SQRT_HALF))
            h = _INV_SQRT_2PI * (math.exp(-0.5 * z1 * z1) - math.exp(-0.5 * z0 * z0))
        else:
            half = 0.5 * w
            f = 0.0
            g = 0.0
            h = 0.0
            for i in range(4):
                sx = 0.5 if i % 2 == 0 else -0.5
                sw = half if i < 2 else -half
                sign = 1.0 if (i == 0 or i == 3) else -1.0
                z = (d + sx + sw) * inv
                f += sign * _phi3(d + sx + sw, sigma)
                g += sign * _phi2(d + sx + sw, sigma)
                h += sign * sigma * 0.5 * (1.0 + math.erf(z * _SQRT_HALF))
            f /= w
            g /= w
            h /= w
        table[0, side + k] = f
        table[1, side + k] = g
        table[2, side + k] = h
        table[0, side - k] = 1.0 - f
        table[1, side - k] = g
        table[2, side - k] = -h
    return side, step


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _flat(line, x_from, x_to, x0, level, slope, inv2):  # type: ignore[no-untyped-def]
    """Weighted sums of 1, d, d^2, r, r d over pixels of one level."""
    s0 = np.float32(0.0)
    s1 = np.float32(0.0)
    s2 = np.float32(0.0)
    r0 = np.float32(0.0)
    r1 = np.float32(0.0)
    start = np.float32(x_from + 0.5 - x0)
    level32 = np.float32(level)
    slope32 = np.float32(slope)
    inv32 = np.float32(inv2)
    one = np.float32(1.0)
    zero = np.float32(0.0)
    for j in range(x_to - x_from):
        d = start + np.float32(j)
        r = np.float32(line[x_from + j]) - (level32 + slope32 * d)
        m = max(zero, one - r * r * inv32)
        wt = m * m
        s0 += wt
        s1 += wt * d
        s2 += wt * d * d
        r0 += wt * r
        r1 += wt * r * d
    return float(s0), float(s1), float(s2), float(r0), float(r1)


@njit(cache=True, nogil=True)
def _spread(u, v, t, half, c, work, normal, right):  # type: ignore[no-untyped-def]
    """Add sums over the six functions of d, taken over rows near t, to the normal equations.

    A few rows share one t: that touches the weights of the equations, never the residuals.
    """
    work[0] = -c
    work[1] = -c * t * half
    work[2] = c
    work[3] = 1.0
    work[4] = t
    work[5] = t * t
    work[6] = 1.0
    work[7] = t
    work[8] = t * t
    work[9] = 1.0
    work[10] = 1.0
    for m in range(PARAMETERS):
        km = BASIS_OF[m]
        right[m] += work[m] * v[km]
        for n in range(m, PARAMETERS):
            normal[m, n] += work[m] * work[n] * u[km, BASIS_OF[n]]


@njit(cache=True, nogil=True)
def sweep(  # type: ignore[no-untyped-def]
    img, rows, y_mid, half, p, w, room, box_left, box_right,
    scale, tukey, table, work, hist, normal, right, keep, resid, spread, stats,
):
    """One pass over the pixels: normal equations, residual histogram, statistics.

    ``p`` are the PARAMETERS; ``room`` the (left, right) px that belong to this edge.
    ``keep`` (rows) gets 1 where the row counted; ``resid`` (rows, CORE_MAX) the weighted
    residuals near the edge; ``spread`` (bins, 2) the mean residual profile at 1/4 px.
    """
    a = p[0]
    b = p[1]
    sigma = p[2]
    core = 3.6 * sigma + 0.5 + 0.5 * w + 0.3
    side, step = fill_table(sigma, w, table, core + 1.0)
    inv_step = 1.0 / step
    outer = 12.0 + 6.0 * sigma + 0.5 * w
    reach_l = min(outer, room[0])
    reach_r = min(outer, room[1])
    limit = tukey * scale
    inv2 = 1.0 / (limit * limit)
    normal[:] = 0.0
    right[:] = 0.0
    hist[:] = 0
    stats[:] = 0.0
    core_l = min(core, reach_l)
    core_r = min(core, reach_r)
    store = resid.shape[0] > 0
    n_par = PARAMETERS
    group_u = np.zeros((6, 6))
    group_v = np.zeros(6)
    y_group = -(10**9)
    t_group = 0.0
    c_group = 1.0
    u = np.zeros((6, 6))
    v = np.zeros(6)
    for i in range(rows.shape[0]):
        y = rows[i]
        t = (y - y_mid) / half
        x0 = a + b * (y - y_mid)
        low = p[3] + p[4] * t + p[5] * t * t
        high = p[6] + p[7] * t + p[8] * t * t
        sl = p[9] * low - p[10]
        sh = p[9] * high + p[10]
        c = high - low
        first = max(box_left, int(math.ceil(x0 - reach_l - 0.5)))
        last = min(box_right - 1, int(math.floor(x0 + reach_r - 0.5)))
        c_first = max(first, int(math.ceil(x0 - core_l - 0.5)))
        c_last = min(last, int(math.floor(x0 + core_r - 0.5)))
        keep[i] = 0
        if c_last - c_first < 2 or c_first + 0.5 - x0 > -0.5 or c_last + 0.5 - x0 < 0.5:
            continue
        bad = 0
        s_psi2 = 0.0
        s_dpsi = 0.0
        s_w = 0.0
        hot = 0
        u00 = 0.0
        u01 = 0.0
        u02 = 0.0
        u03 = 0.0
        u04 = 0.0
        u05 = 0.0
        u11 = 0.0
        u12 = 0.0
        u13 = 0.0
        u14 = 0.0
        u15 = 0.0
        u22 = 0.0
        u23 = 0.0
        u24 = 0.0
        u25 = 0.0
        u33 = 0.0
        u34 = 0.0
        u35 = 0.0
        u44 = 0.0
        u45 = 0.0
        u55 = 0.0
        v0 = 0.0
        v1 = 0.0
        v2 = 0.0
        v3 = 0.0
        v4 = 0.0
        v5 = 0.0
        line = img[y]
        size = c_last - c_first + 1
        near = line[c_first : c_last + 1]
        d0 = c_first + 0.5 - x0
        for j in range(size):
            d = d0 + j
            z = d * inv_step
            kk = int(z + side + 0.5)
            dk = d - (kk - side) * step
            k = np.uintp(kk)
            g = table[1, k]
            f = table[0, k] + g * dk
            h = table[2, k]
            e = 1.0 - f
            value = near[j]
            r = value - ((low + sl * d) * e + (high + sh * d) * f)
            if value >= 254.5 or value <= 0.5:
                hot += 1
            bin_ = int(abs(r) * (1.0 / HIST_STEP))
            hist[np.uintp(bin_ if bin_ < HIST else HIST - 1)] += 1
            q = r * r * inv2
            if q >= 1.0:
                bad += 1
                if store and j < CORE_MAX:
                    resid[i, j] = 0.0
                continue
            m = 1.0 - q
            wt = m * m
            psi = wt * r
            s_psi2 += psi * psi
            s_dpsi += m * (1.0 - 5.0 * q)
            s_w += wt
            if store and j < CORE_MAX:
                resid[i, j] = psi
            wg = wt * g
            wh = wt * h
            we = wt * e
            wf = wt * f
            de = d * (low * e + high * f)
            df = d * (f - e)
            u00 += wg * g
            u01 += wg * h
            u02 += wg * e
            u03 += wg * f
            u04 += wg * de
            u05 += wg * df
            u11 += wh * h
            u12 += wh * e
            u13 += wh * f
            u14 += wh * de
            u15 += wh * df
            u22 += we * e
            u23 += we * f
            u24 += we * de
            u25 += we * df
            u33 += wf * f
            u34 += wf * de
            u35 += wf * df
            u44 += wt * de * de
            u45 += wt * de * df
            u55 += wt * df * df
            v0 += psi * g
            v1 += psi * h
            v2 += psi * e
            v3 += psi * f
            v4 += psi * de
            v5 += psi * df
        if bad * 3 > size:
            stats[0] += 1.0
            continue
        if hot * 5 > size * 2:
            stats[8] += 1.0
        u[0, 0] = u00
        u[0, 1] = u01
        u[0, 2] = u02
        u[0, 3] = u03
        u[0, 4] = u04
        u[0, 5] = u05
        u[1, 1] = u11
        u[1, 2] = u12
        u[1, 3] = u13
        u[1, 4] = u14
        u[1, 5] = u15
        u[2, 2] = u22
        u[2, 3] = u23
        u[2, 4] = u24
        u[2, 5] = u25
        u[3, 3] = u33
        u[3, 4] = u34
        u[3, 5] = u35
        u[4, 4] = u44
        u[4, 5] = u45
        u[5, 5] = u55
        v[0] = v0
        v[1] = v1
        v[2] = v2
        v[3] = v3
        v[4] = v4
        v[5] = v5
        # flat parts: only levels and slopes
        for part in range(2):
            if part == 0:
                x_from, x_to = first, c_first
            else:
                x_from, x_to = c_last + 1, last + 1
            level = low if part == 0 else high
            slope = sl if part == 0 else sh
            s0, s1, s2, r0, r1 = _flat(line, x_from, x_to, x0, level, slope, inv2)
            j = 2 + part
            sign = -1.0 if part == 0 else 1.0
            u[j, j] += s0
            u[j, 4] += level * s1
            u[j, 5] += sign * s1
            u[4, 4] += level * level * s2
            u[4, 5] += sign * level * s2
            u[5, 5] += s2
            v[j] += r0
            v[4] += level * r1
            v[5] += sign * r1
        keep[i] = 1
        stats[1] += 1.0
        stats[2] += size
        stats[3] += bad
        stats[4] += s_psi2
        stats[5] += s_dpsi
        stats[6] += s_w
        stats[7] += c
        if y - y_group >= GROUP:
            _spread(group_u, group_v, t_group, half, c_group, work, normal, right)
            group_u[:] = 0.0
            group_v[:] = 0.0
            y_group, t_group, c_group = y, t, c
        for m_ in range(6):
            group_v[m_] += v[m_]
            for n_ in range(m_, 6):
                group_u[m_, n_] += u[m_, n_]
    _spread(group_u, group_v, t_group, half, c_group, work, normal, right)
    for m_ in range(n_par):
        for n_ in range(m_):
            normal[m_, n_] = normal[n_, m_]


@njit(cache=True, nogil=True)
def median_from(hist):  # type: ignore[no-untyped-def]
    """Median of the absolute residuals in ``hist``, grey levels."""
    total = 0
    for k in range(hist.shape[0]):
        total += hist[k]
    run = 0.0
    for k in range(hist.shape[0]):
        if run + hist[k] >= 0.5 * total and hist[k] > 0:
            return (k + (0.5 * total - run) / hist[k]) * HIST_STEP
        run += hist[k]
    return hist.shape[0] * HIST_STEP


@njit(cache=True, nogil=True)
def invert(matrix, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric positive matrix by a scaled Cholesky with a tiny ridge."""
    n = matrix.shape[0]
    d = np.empty(n)
    for i in range(n):
        d[i] = 1.0 / math.sqrt(matrix[i, i]) if matrix[i, i] > 0.0 else 1.0
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = matrix[i, j] * d[i] * d[j]
            if i == j:
                s += 1e-9
                if matrix[i, i] <= 0.0:
                    s = 1.0
            for k in range(j):
                s -= low[i, k] * low[j, k]
            if i == j:
                if s < 1e-12:
                    s = 1e-12
                low[i, i] = math.sqrt(s)
            else:
                low[i, j] = s / low[j, j]
    for col in range(n):
        for i in range(n):
            s = 1.0 if i == col else 0.0
            for k in range(i):
                s -= low[i, k] * inverse[k, col]
            inverse[i, col] = s / low[i, i]
        for i in range(n - 1, -1, -1):
            s = inverse[i, col]
            for k in range(i + 1, n):
                s -= low[k, i] * inverse[k, col]
            inverse[i, col] = s / low[i, i]
    for i in range(n):
        for j in range(n):
            inverse[i, j] *= d[i] * d[j]


@njit(cache=True, nogil=True)
def start_line(img, box, y_mid, a, b, rising, reach_l, reach_r, group):  # type: ignore[no-untyped-def]
    """Line and levels from groups of rows by the area under each mean profile.

    Returns (a, b, left level, right level, used flag per group); a < 0 when too few agree.
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
    flank = max(2, min(4, size // 4))
    for k in range(count):
        y0 = top + k * group
        rel[k] = y0 + 0.5 * (group - 1) - y_mid
        start = int(round(a + b * rel[k])) - n_l
        if start < left or start + size > left + width:
            cut = 0
            if start < left:
                cut = left - start
            if start + size > left + width:
                cut = max(cut, start + size - left - width)
            if cut > min(n_l, n_r) - 3:
                continue
        profile[:] = 0.0
        for y in range(y0, y0 + group):
            for j in range(size):
                x = min(max(start + j, left), left + width - 1)
                profile[j] += img[y, x]
        lo = 0.0
        hi = 0.0
        area = 0.0
        for j in range(flank):
            lo += profile[j]
            hi += profile[size - 1 - j]
        lo /= flank * group
        hi /= flank * group
        for j in range(size):
            area += profile[j] / group - lo
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
        return -1.0, 0.0, 0.0, 0.0, used
    n = 0
    for k in range(count):
        if amp[k] > 0.45 * typical:
            used[k] = 1
            n += 1
    if n < 3:
        return -1.0, 0.0, 0.0, 0.0, used
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
        s0 = 0.0
        s1 = 0.0
        s2 = 0.0
        r0 = 0.0
        r1 = 0.0
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
    low = np.median(lows[idx])
    high = np.median(highs[idx])
    return a, b, low, high, used


@njit(cache=True, nogil=True)
def refine(img, rows, y_mid, half, p, w, room, box_left, box_right, resid, keep, out):  # type: ignore[no-untyped-def]
    """Iterate ``sweep`` to convergence; fills p, resid, keep and out, returns True on success.

    out: 0..2 covariance aa, ab, bb (white noise), 3 rms noise near the edge, 4 share of
    outlier pixels, 5 rows used, 6 rows refused, 7 mean contrast, 8 over-exposed rows,
    9 information on a (px^-2 per grey^2), 10 mean weight.
    """
    table = np.empty((3, TABLE))
    work = np.empty(PARAMETERS)
    hist = np.zeros(HIST, np.int64)
    normal = np.zeros((PARAMETERS, PARAMETERS))
    inverse = np.zeros((PARAMETERS, PARAMETERS))
    right = np.zeros(PARAMETERS)
    stats = np.zeros(12)
    spread = np.zeros((1, 2))
    none = np.zeros((0, CORE_MAX), np.float32)
    n = rows.shape[0]
    stride = max(1, n // 90)
    some = rows[::stride].copy()
    some_keep = np.zeros(some.shape[0], np.uint8)
    scale = 0.3 * abs(p[6] - p[3])
    coarse = 5
    fine = 0
    free = False
    bend = 0.0
    wide = np.zeros((PARAMETERS, PARAMETERS))
    for it in range(14):
        full = it >= coarse
        if full:
            sweep(
                img, rows, y_mid, half, p, w, room, box_left, box_right, scale, TUKEY,
                table, work, hist, normal, right, keep, resid, spread, stats,
            )
        else:
            sweep(
                img, some, y_mid, half, p, w, room, box_left, box_right, scale, TUKEY,
                table, work, hist, normal, right, some_keep, none, spread, stats,
            )
        if stats[1] < 4 or (full and stats[1] < 8):
            if scale > 60.0:
                return False
            scale *= 2.0
            continue
        if not free:
            bend = normal[10, 10]
            normal[10, 10] = 1e30
        invert(normal, inverse)
        step = inverse @ right
        da = min(1.0, max(-1.0, step[0]))
        p[0] += da
        p[1] += min(0.02, max(-0.02, step[1]))
        p[2] = min(8.0, max(0.2, p[2] + min(0.6, max(-0.6, step[2]))))
        for k in range(3, PARAMETERS):
            p[k] += step[k]
        new_scale = min(60.0, max(0.3, 1.4826 * median_from(hist)))
        settled = abs(new_scale - scale) < 0.1 * scale
        if full:
            tight = 0.2 * math.sqrt(max(1e-12, inverse[0, 0])) * scale + 1e-5
            fine += 1
            if settled and fine >= 2 and abs(da) < tight:
                if free:
                    break
                # does the light change across the edge other than in proportion to it?
                normal[10, 10] = bend
                invert(normal, wide)
                kappa = (wide @ right)[10]
                if abs(kappa) < 4.0 * math.sqrt(max(1e-30, wide[10, 10])) * scale:
                    break
                free = True
        elif settled and abs(da) < 0.01 and abs(step[2]) < 0.02:
            coarse = it + 1
        scale = new_scale
    count = stats[2]
    if stats[1] < 8 or stats[5] <= 0.0:
        return False
    s2 = (stats[4] / count) / (stats[5] / count) ** 2 * count / max(1.0, count - PARAMETERS)
    mean_w = stats[6] / count
    factor = s2 * mean_w
    out[0] = inverse[0, 0] * factor
    out[1] = inverse[0, 1] * factor
    out[2] = inverse[1, 1] * factor
    out[3] = math.sqrt(stats[4] / max(1.0, count - stats[3])) / max(0.05, mean_w)
    out[4] = stats[3] / count
    out[5] = stats[1]
    out[6] = stats[0]
    out[7] = stats[7] / stats[1]
    out[8] = stats[8]
    out[9] = s2
    out[10] = mean_w
    return True
