"""Joint robust fit of one straight blurred edge to all pixels near it.

Model of the light at column x, row y, with d = x - a - b*(y - y_mid), for the group of four
rows that contains y:

    I = p (1 + gamma d) (1 - F(d)) + q (1 + gamma d) F(d) + kappa d (2 F(d) - 1)

p and q are the levels left and right of the edge, separate for every group. Uneven light, glare
and bands of the shutter therefore do not disturb the fit, since each row has information on the
position. F is the response of a unit pixel to a step with Gaussian blur of sd sigma: the normal
density integrated twice. (Motion blur is another symmetric kernel. It increases sigma and does
not change the position.) gamma is the relative change of light across the edge. kappa, a non-
proportional change of light, stays 0 unless it is significant. Gauss-Newton steps with Tukey's
biweight (c = 4.685, 95 % efficient for Gaussian noise) find the parameters; the levels are
eliminated group by group. Rows in which more than a third of the pixels near the edge are
outliers are rejected, and groups that fit much worse than the others.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from vision.marker.edgeprofile import fill_table

PARAMETERS = 5  # a, b, sigma, gamma, kappa
TUKEY = 4.685
GROUP = 4  # rows with a common pair of levels
RHO_MAX = 22.0  # contribution of one outlier to its group's misfit, squared sds
HIST = 2048
HIST_STEP = 1.0 / 32.0
CORE_MAX = 64  # widest stored residual window


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _flat(line, x_from, x_to, x0, level, slope, inv2):  # type: ignore[no-untyped-def]
    """Weighted sums of 1, d, d^2, r, r d over pixels of one level."""
    s0 = s1 = s2 = r0 = r1 = rho = np.float32(0.0)
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
        rho += min(one, r * r * inv32)
    return float(s0), float(s1), float(s2), float(r0), float(r1), float(rho)


@njit(cache=True, nogil=True)
def _eliminate(u, v, c, arm, block, normal, right):  # type: ignore[no-untyped-def]
    """Eliminate the levels from one group's sums and add the rest to the normal equations.

    ``block`` (2, PARAMETERS + 1) receives what ``shift_levels`` needs.
    """
    m00 = u[2, 2]
    m11 = u[3, 3]
    m01 = u[2, 3]
    det = m00 * m11 - m01 * m01
    if m00 <= 0.0 or m11 <= 0.0 or det < 1e-6 * m00 * m11:
        return False
    kinds = (0, 0, 1, 4, 5)
    factor = (-c, -c * arm, c, 1.0, 1.0)
    for m in range(PARAMETERS):
        k = kinds[m]
        e = u[2, k] if k > 2 else u[k, 2]
        f = u[3, k] if k > 3 else u[k, 3]
        block[0, m] = factor[m] * (m11 * e - m01 * f) / det
        block[1, m] = factor[m] * (m00 * f - m01 * e) / det
    block[0, PARAMETERS] = (m11 * v[2] - m01 * v[3]) / det
    block[1, PARAMETERS] = (m00 * v[3] - m01 * v[2]) / det
    for m in range(PARAMETERS):
        km = kinds[m]
        e = (u[2, km] if km > 2 else u[km, 2]) * factor[m]
        f = (u[3, km] if km > 3 else u[km, 3]) * factor[m]
        right[m] += factor[m] * v[km] - e * block[0, PARAMETERS] - f * block[1, PARAMETERS]
        for n in range(m, PARAMETERS):
            kn = kinds[n]
            normal[m, n] += factor[m] * factor[n] * u[km, kn] - e * block[0, n] - f * block[1, n]
    return True


class Rows(NamedTuple):
    """Pixels for the fit of an edge.

    Attributes:
        img: the grey picture, (h, w).
        rows: row numbers, (n,), in groups with a common pair of levels.
        group_of: group of each row, (n,).
        y_mid: reference row of the edge's column.
        room: columns left and right of the edge that belong to it, (2,).
        box_left, box_right: columns of the box, the last one excluded.
        hot_from: grey level that counts as over-exposed.
    """

    img: Any
    rows: Any
    group_of: Any
    y_mid: float
    room: Any
    box_left: int
    box_right: int
    hot_from: float


class Line(NamedTuple):
    """The current fit: ``p`` (PARAMETERS,), ``levels`` (groups, 2), ``used`` (groups,)."""

    p: Any
    levels: Any
    used: Any


class Sums(NamedTuple):
    """Output arrays of a pass, allocated once per fit."""

    table: Any
    hist: Any
    normal: Any
    right: Any
    blocks: Any
    misfit: Any
    keep: Any
    resid: Any
    stats: Any


@njit(cache=True, nogil=True)
def sweep(view, line, scale, near_only, sums):  # type: ignore[no-untyped-def]
    """One pass over the pixels: normal equations, residual histogram, statistics.

    ``view`` is a ``Rows``, ``line`` a ``Line`` (groups with ``used`` 0 are skipped).
    ``near_only`` restricts the pass to the neighbourhood of the edge, where the light is still
    linear. In ``sums``, ``keep`` (rows) is 1 for each row used; ``misfit`` (groups) is the mean
    bounded squared residual; ``resid`` (rows, CORE_MAX) holds the weighted residuals near the
    edge, with the pixel on the edge in column CORE_MAX/2.
    """
    img, rows, group_of, y_mid, room, box_left, box_right, hot_from = view
    p, levels, used = line
    table, hist, normal, right, blocks, misfit, keep, resid, stats = sums
    a, b, sigma = p[0], p[1], p[2]
    core = max(2.3, 3.2 * sigma + 0.8)
    side, step = fill_table(sigma, table, core + 1.0)
    inv_step = 1.0 / step
    outer = 6.0 + 4.5 * sigma if near_only else 12.0 + 6.0 * sigma
    reach_l = min(outer, room[0])
    reach_r = min(outer, room[1])
    limit = TUKEY * scale
    inv2 = 1.0 / (limit * limit)
    inv_s2 = 1.0 / (scale * scale)
    normal[:] = 0.0
    right[:] = 0.0
    hist[:] = 0
    stats[:] = 0.0
    core_l = min(core, reach_l)
    core_r = min(core, reach_r)
    store = resid.shape[0] > 0
    u = np.zeros((6, 6))
    v = np.zeros(6)
    count_rows = rows.shape[0]
    at = -1  # group being summed
    members = 0
    arm = s_rho = n_rho = 0.0
    for i in range(count_rows + 1):
        if i == count_rows or group_of[i] != at:
            if at >= 0:
                misfit[at] = -1.0
                if members > 0:
                    c = levels[at, 1] - levels[at, 0]
                    if not _eliminate(u, v, c, arm / members, blocks[at], normal, right):
                        blocks[at] = 0.0
                    misfit[at] = s_rho / n_rho
                else:
                    blocks[at] = 0.0
            if i == count_rows:
                break
            at = group_of[i]
            u[:] = 0.0
            v[:] = 0.0
            members = 0
            arm = s_rho = n_rho = 0.0
        keep[i] = 0
        if used[at] == 0:
            continue
        y = rows[i]
        x0 = a + b * (y - y_mid)
        low = levels[at, 0]
        high = levels[at, 1]
        sl = p[3] * low - p[4]
        sh = p[3] * high + p[4]
        first = max(box_left, math.ceil(x0 - reach_l - 0.5))
        last = min(box_right - 1, math.floor(x0 + reach_r - 0.5))
        c_first = max(first, math.ceil(x0 - core_l - 0.5))
        c_last = min(last, math.floor(x0 + core_r - 0.5))
        if c_last - c_first < 2 or c_first + 0.5 - x0 > -0.5 or c_last + 0.5 - x0 < 0.5:
            stats[9] += 1.0
            continue
        shift = c_first - math.floor(x0) + CORE_MAX // 2
        bad = 0
        s_psi2 = s_dpsi = s_w = rho = 0.0
        hot = 0
        u00 = u01 = u02 = u03 = u04 = u05 = 0.0
        u11 = u12 = u13 = u14 = u15 = 0.0
        u22 = u23 = u24 = u25 = 0.0
        u33 = u34 = u35 = u44 = u45 = u55 = 0.0
        v0 = v1 = v2 = v3 = v4 = v5 = 0.0
        pixels = img[y]
        size = c_last - c_first + 1
        near = pixels[c_first : c_last + 1]
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
            if value >= hot_from:
                hot += 1
            bin_ = int(abs(r) * (1.0 / HIST_STEP))
            hist[np.uintp(bin_ if bin_ < HIST else HIST - 1)] += 1
            q = r * r * inv2
            if q >= 1.0:
                bad += 1
                rho += RHO_MAX
                continue
            m = 1.0 - q
            wt = m * m
            psi = wt * r
            s_psi2 += psi * psi
            s_dpsi += m * (1.0 - 5.0 * q)
            s_w += wt
            rho += min(RHO_MAX, r * r * inv_s2)
            if store and 0 <= j + shift < CORE_MAX:
                resid[i, j + shift] = psi
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
            s_rho += RHO_MAX * 0.2 * size
            n_rho += size
            continue
        if hot >= 2 and hot * 7 > size:
            stats[8] += 1.0
            continue
        upper = (u00, u01, u02, u03, u04, u05, u11, u12, u13, u14, u15,
                 u22, u23, u24, u25, u33, u34, u35, u44, u45, u55)  # fmt: skip
        entry = 0
        for m in range(6):
            for n in range(m, 6):
                u[m, n] += upper[entry]
                entry += 1
        for m, total in enumerate((v0, v1, v2, v3, v4, v5)):
            v[m] += total
        # flat parts affect levels and slopes only
        for part in range(2):
            if part == 0:
                x_from, x_to, level, slope, sign = first, c_first, low, sl, -1.0
            else:
                x_from, x_to, level, slope, sign = c_last + 1, last + 1, high, sh, 1.0
            s0, s1, s2, r0, r1, flat_rho = _flat(pixels, x_from, x_to, x0, level, slope, inv2)
            j = 2 + part
            u[j, j] += s0
            u[j, 4] += level * s1
            u[j, 5] += sign * s1
            u[4, 4] += level * level * s2
            u[4, 5] += sign * level * s2
            u[5, 5] += s2
            v[j] += r0
            v[4] += level * r1
            v[5] += sign * r1
            rho += flat_rho * RHO_MAX
            stats[10] += x_to - x_from
            stats[11] += s0
        keep[i] = 1
        arm += y - y_mid
        members += 1
        s_rho += rho
        n_rho += last - first + 1
        stats[1] += 1.0
        stats[2] += size
        stats[3] += bad
        stats[4] += s_psi2
        stats[5] += s_dpsi
        stats[6] += s_w
        stats[7] += high - low
    for m in range(PARAMETERS):
        for n in range(m):
            normal[m, n] = normal[n, m]


@njit(cache=True, nogil=True)
def shift_levels(levels, blocks, groups, step):  # type: ignore[no-untyped-def]
    """Move each group's levels to their optimum after a parameter step."""
    for at in groups:
        for k in range(2):
            change = blocks[at, k, PARAMETERS]
            for m in range(PARAMETERS):
                change -= blocks[at, k, m] * step[m]
            levels[at, k] += change


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
