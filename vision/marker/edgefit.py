"""Iterates the fit of one edge to convergence; fit statistics (model: ``edgesweep``)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from vision.marker.edgeprofile import TABLE
from vision.marker.edgesweep import (
    CORE_MAX,
    HIST,
    PARAMETERS,
    Rows,
    Sums,
    median_from,
    shift_levels,
    sweep,
)


@njit(cache=True, nogil=True)
def invert(matrix, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric positive matrix by scaled Cholesky factorisation with a ridge."""
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
def times(matrix, vector, product):  # type: ignore[no-untyped-def]
    """Matrix times vector, without a linear algebra library and its threads."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        product[i] = total


@njit(cache=True, nogil=True)
def drop_misfits(misfit, used, levels):  # type: ignore[no-untyped-def]
    """Disable groups with a much larger misfit or a much smaller contrast than most; count them."""
    count = 0
    values = np.empty(misfit.shape[0])
    contrast = np.empty(misfit.shape[0])
    for k in range(misfit.shape[0]):
        if used[k] and misfit[k] >= 0.0:
            values[count] = misfit[k]
            contrast[count] = levels[k, 1] - levels[k, 0]
            count += 1
    if count < 4:
        return 0
    middle = np.median(values[:count])
    spread = 1.4826 * np.median(np.abs(values[:count] - middle))
    limit = middle + max(6.0 * spread, 0.35 * middle)
    typical = np.median(contrast[:count])
    dropped = 0
    for k in range(misfit.shape[0]):
        if used[k] == 0:
            continue
        c = levels[k, 1] - levels[k, 0]
        if misfit[k] > limit or c * typical < 0.35 * typical * typical:
            used[k] = 0
            dropped += 1
    return dropped


@njit(cache=True, nogil=True)
def refine(view, line, least_scale, may_bend, resid, keep, out):  # type: ignore[no-untyped-def]
    """Iterate ``sweep`` to convergence; fills ``line``, resid, keep and out.

    out: 0..2 covariance aa, ab, bb (white noise), 3 noise sd near the edge, 4 share of outlier
    pixels near the edge, 5 rows used, 6 rows rejected, 7 mean contrast, 8 over-exposed rows, 9
    share of outliers in the flat parts, 10 groups rejected, 11 1 if kappa was fitted, 12
    variance of sums over 8 image rows relative to white noise, 13 the same for sums over all
    rows, 14 the variance (grey levels squared) that scales the covariance, 15 ``row_scatter``.
    ``may_bend`` False: p and levels come from an earlier fit, kappa stays 0. Returns True if the
    fit converged on enough rows.
    """
    img, rows, group_of, y_mid, room, box_left, box_right, hot_from = view
    p, levels, used = line
    groups = levels.shape[0]
    table = np.empty((3, TABLE))
    hist = np.zeros(HIST, np.int64)
    normal = np.zeros((PARAMETERS, PARAMETERS))
    inverse = np.zeros((PARAMETERS, PARAMETERS))
    wide = np.zeros((PARAMETERS, PARAMETERS))
    right = np.zeros(PARAMETERS)
    step = np.zeros(PARAMETERS)
    trial = np.zeros(PARAMETERS)
    stats = np.zeros(12)
    blocks = np.zeros((groups, 2, PARAMETERS + 1))
    misfit = np.zeros(groups)
    none = np.zeros((0, CORE_MAX), np.float32)
    stride = max(1, groups // 24)
    chosen = np.flatnonzero(group_of % stride == stride // 2)
    some = rows[chosen]
    some_group = group_of[chosen]
    some_keep = np.zeros(some.shape[0], np.uint8)
    part = Rows(img, some, some_group, y_mid, room, box_left, box_right, hot_from)
    every = Sums(table, hist, normal, right, blocks, misfit, keep, resid, stats)
    some_sums = Sums(table, hist, normal, right, blocks, misfit, some_keep, none, stats)
    some_ids = np.unique(some_group)
    all_ids = np.arange(groups)
    scale = max(least_scale, 0.3 * abs(np.median(levels[:, 1] - levels[:, 0])))
    coarse = 6
    if not may_bend:  # repeat of a converged fit
        scale = least_scale
        coarse = 0
    fine = 0
    free = bool(0)  # for the constant False `sweep` would be compiled a second time
    dropped = 0
    pruned = False
    da = 0.0
    for it in range(18):
        full = it >= coarse
        if full:
            sweep(view, line, scale, free, every)
        else:
            sweep(part, line, scale, free, some_sums)
        if stats[1] < 4 or (full and stats[1] < 8):
            if scale > 60.0:
                return False
            if not full:
                coarse = it + 1
            scale *= 2.0
            continue
        bend = normal[4, 4]
        if not free:
            normal[4, 4] = 1e30
        invert(normal, inverse)
        times(inverse, right, step)
        da = min(1.0, max(-1.0, step[0]))
        step[0] = da
        step[1] = min(0.02, max(-0.02, step[1]))
        step[2] = min(0.6, max(-0.6, step[2]))
        p[0] += step[0]
        p[1] += step[1]
        p[2] = min(8.0, max(0.12, p[2] + step[2]))
        p[3] += step[3]
        p[4] += step[4]
        shift_levels(levels, blocks, all_ids if full else some_ids, step)
        new_scale = min(60.0, max(least_scale, 1.4826 * median_from(hist)))
        settled = abs(new_scale - scale) < 0.1 * scale
        if full:
            tight = 0.2 * math.sqrt(max(1e-12, inverse[0, 0])) * scale + 1e-5
            fine += 1
            if settled and not pruned:
                pruned = True
                now = drop_misfits(misfit, used, levels)
                dropped += now
                if now > 0:
                    scale = new_scale
                    continue
            if settled and fine >= 2 and abs(da) < tight:
                if free:
                    break
                # test whether kappa is significant
                normal[4, 4] = bend
                invert(normal, wide)
                times(wide, right, trial)
                kappa = trial[4]
                u_kappa = math.sqrt(max(1e-30, wide[4, 4])) * scale
                if not may_bend or scale < 0.5 or abs(kappa) < 4.0 * u_kappa:
                    break
                free = True
        elif settled and abs(da) < 0.01 and abs(step[2]) < 0.02:
            coarse = it + 1
        scale = new_scale
    count = stats[2]
    if stats[1] < 8 or stats[5] <= 0.0:
        return False
    s2 = (stats[4] / count) / (stats[5] / count) ** 2 * count / max(1.0, count - stats[1])
    factor = s2 * stats[6] / count
    out[0] = inverse[0, 0] * factor
    out[1] = inverse[0, 1] * factor
    out[2] = inverse[1, 1] * factor
    out[3] = scale
    out[4] = stats[3] / count
    out[5] = stats[1]
    out[6] = stats[0]
    out[7] = stats[7] / stats[1]
    out[8] = stats[8]
    out[9] = 1.0 - stats[11] / max(1.0, stats[10]) / max(0.05, stats[6] / (count - stats[3]))
    out[10] = dropped
    out[11] = 1.0 if free else 0.0
    out[14] = factor
    out[12], out[13] = row_correlation(resid, rows, keep)
    out[15] = row_scatter(view, line, resid, keep)
    return True


@njit(cache=True, nogil=True)
def row_correlation(resid, rows, keep):  # type: ignore[no-untyped-def]
    """Variance of residual sums over 8 aligned rows, and over all rows, relative to white noise."""
    columns = resid.shape[1]
    one = 0.0
    eight = 0.0
    every = 0.0
    block = np.zeros(columns)
    total = np.zeros(columns)
    seen = np.zeros(columns)
    at = -1
    for i in range(rows.shape[0] + 1):
        if i == rows.shape[0] or rows[i] // 8 != at:
            for j in range(columns):
                eight += block[j] * block[j]
                block[j] = 0.0
            if i == rows.shape[0]:
                break
            at = rows[i] // 8
        if keep[i] == 0:
            continue
        for j in range(columns):
            r = resid[i, j]
            if r != 0.0:
                one += r * r
                block[j] += r
                total[j] += r
                seen[j] += 1.0
    for j in range(columns):
        every += total[j] * total[j]
    if one <= 0.0:
        return 1.0, 1.0
    return eight / one, every / one


@njit(cache=True, nogil=True)
def row_scatter(view, line, resid, keep):  # type: ignore[no-untyped-def]
    """Variance of the edge's place in parts of its rows, relative to that of independent rows.

    The rows are split into 6 to 48 parts. Dirt and light that lie across the edge shift it in
    some parts only, so that the parts scatter more than their rows. 1 where no split has a
    scatter that chance would give in fewer than 1 of 10,000 edges.
    """
    _, rows, group_of, y_mid, _, _, _, _ = view
    p, levels, _ = line
    columns = resid.shape[1]
    pull = np.zeros(rows.shape[0])  # of a row's residuals on the place of the edge
    count = 0
    total = 0.0
    inv2 = 0.5 / (p[2] * p[2] + 1.0 / 12.0)
    for i in range(rows.shape[0]):
        if keep[i] == 0:
            continue
        x0 = p[0] + p[1] * (rows[i] - y_mid)
        first = math.floor(x0) - columns // 2 + 0.5 - x0
        s = 0.0
        for j in range(columns):
            if resid[i, j] != 0.0:
                s += resid[i, j] * math.exp(-inv2 * (first + j) ** 2)
        s *= levels[group_of[i], 1] - levels[group_of[i], 0]
        pull[count] = s
        total += s * s
        count += 1
    worst = 1.0
    for parts, limit in ((6, 5.9), (12, 3.6), (24, 2.45), (48, 1.9)):
        if count < 2 * parts or total <= 0.0:
            break
        scatter = 0.0
        for part in range(parts):
            s = 0.0
            for i in range(part * count // parts, (part + 1) * count // parts):
                s += pull[i]
            scatter += s * s
        ratio = scatter / total * parts / (parts - 2)
        if ratio > limit:
            worst = max(worst, ratio)
    return worst
