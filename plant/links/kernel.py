"""Compiled Newton-Euler recursion: one state at a time, or batches of states.

An arm is a table, float64 (n, 16), one row per link: cosine and sine of alpha, a, d, offset, mass,
centre of mass (3), tensor about it (xx, yy, zz, xy, xz, yz), joint damping. SI units, in the
link's own frame, see `plant.links.arm.Link`.

The recursion is the thesis's equations 2-4 to 2-13 in link frames (Luh, Walker and Paul 1980),
with the two misprints of equations 2-9 and 2-12 corrected: the moment on the previous link is
n(i) = n(i+1) + p(i) x f(i+1) + (p(i) + s(i)) x F(i) + N(i).
Callers provide the work space, so that nothing is allocated inside a simulation.
"""

from __future__ import annotations

import math

import numpy as np

from plant.arrays import Array
from plant.compiled import called, entry_point
from plant.links.layout import WORK

CA, SA, A, D, OFFSET, MASS, COM, INERTIA, DAMPING = 0, 1, 2, 3, 4, 5, 6, 9, 15
"""Columns of an arm's table."""
COLUMNS = 16


@called
def turn(table: Array, q: Array, work: Array) -> None:
    """Set cosine and sine of the joint angles in `work` for the other functions."""
    for i in range(table.shape[0]):
        angle = q[i] + table[i, 4]
        work[i, 0] = math.cos(angle)
        work[i, 1] = math.sin(angle)


@called
def recurse(table: Array, gravity: Array, qd: Array, qdd: Array, work: Array, out: Array) -> None:
    """Torques (n) without damping for accelerations `qdd` at rates `qd`; call `turn` first.

    `out` must not be `qdd`.
    """
    n = table.shape[0]
    wx = wy = wz = ex = ey = ez = 0.0
    # Gravity is modelled as an upward acceleration of the base.
    ax, ay, az = -gravity[0], -gravity[1], -gravity[2]
    for i in range(n):
        ca, sa, ct, st = table[i, 0], table[i, 1], work[i, 0], work[i, 1]
        rate, push = qd[i], qdd[i]
        # Rate and acceleration of this link, in the axes of the previous frame (2-4, 2-5).
        ux, uy, uz = ex + wy * rate, ey - wx * rate, ez + push
        vz = wz + rate
        # Into the link's own axes: about z by -theta, then about x by -alpha.
        t = ct * wy - st * wx
        wx, wy, wz = ct * wx + st * wy, ca * t + sa * vz, ca * vz - sa * t
        t = ct * uy - st * ux
        ex, ey, ez = ct * ux + st * uy, ca * t + sa * uz, ca * uz - sa * t
        t = ct * ay - st * ax
        ax, ay, az = ct * ax + st * ay, ca * t + sa * az, ca * az - sa * t
        # omega' x + omega x (omega x ) as one matrix, used for both points of the link (2-6, 2-7).
        xx, yy, zz = wx * wx, wy * wy, wz * wz
        xy, xz, yz = wx * wy, wx * wz, wy * wz
        m00, m01, m02 = -yy - zz, xy - ez, xz + ey
        m10, m11, m12 = xy + ez, -xx - zz, yz - ex
        m20, m21, m22 = xz - ey, yz + ex, -xx - yy
        px, py, pz = table[i, 2], table[i, 3] * sa, table[i, 3] * ca
        ax += m00 * px + m01 * py + m02 * pz
        ay += m10 * px + m11 * py + m12 * pz
        az += m20 * px + m21 * py + m22 * pz
        sx, sy, sz, mass = table[i, 6], table[i, 7], table[i, 8], table[i, 5]
        work[i, 2] = mass * (ax + m00 * sx + m01 * sy + m02 * sz)
        work[i, 3] = mass * (ay + m10 * sx + m11 * sy + m12 * sz)
        work[i, 4] = mass * (az + m20 * sx + m21 * sy + m22 * sz)
        ixx, iyy, izz, ixy, ixz, iyz = (
            table[i, 9],
            table[i, 10],
            table[i, 11],
            table[i, 12],
            table[i, 13],
            table[i, 14],
        )
        hx = ixx * wx + ixy * wy + ixz * wz
        hy = ixy * wx + iyy * wy + iyz * wz
        hz = ixz * wx + iyz * wy + izz * wz
        work[i, 5] = ixx * ex + ixy * ey + ixz * ez + wy * hz - wz * hy
        work[i, 6] = ixy * ex + iyy * ey + iyz * ez + wz * hx - wx * hz
        work[i, 7] = ixz * ex + iyz * ey + izz * ez + wx * hy - wy * hx
    fx = fy = fz = nx = ny = nz = 0.0
    for i in range(n - 1, -1, -1):
        ca, sa, ct, st = table[i, 0], table[i, 1], work[i, 0], work[i, 1]
        px, py, pz = table[i, 2], table[i, 3] * sa, table[i, 3] * ca
        bx, by, bz = px + table[i, 6], py + table[i, 7], pz + table[i, 8]
        nx += py * fz - pz * fy + by * work[i, 4] - bz * work[i, 3] + work[i, 5]
        ny += pz * fx - px * fz + bz * work[i, 2] - bx * work[i, 4] + work[i, 6]
        nz += px * fy - py * fx + bx * work[i, 3] - by * work[i, 2] + work[i, 7]
        fx += work[i, 2]
        fy += work[i, 3]
        fz += work[i, 4]
        # Into the axes of the previous frame, where the joint axis is z (2-13).
        t = ca * ny - sa * nz
        nx, ny, nz = ct * nx - st * t, st * nx + ct * t, sa * ny + ca * nz
        t = ca * fy - sa * fz
        fx, fy, fz = ct * fx - st * t, st * fx + ct * t, sa * fy + ca * fz
        out[i] = nz


@called
def mass_matrix(table: Array, work: Array, d: Array) -> None:
    """Inertia matrix D (n, n) at the angles last given to `turn`.

    For each joint, the composite body after it (mass, first moment, tensor about the joint) rotates
    at unit rate. The moments of its momentum about the joints before are a column of D (Walker and
    Orin 1982, third method).
    """
    n = table.shape[0]
    mass = hx = hy = hz = 0.0
    xx = yy = zz = xy = xz = yz = 0.0
    for i in range(n - 1, -1, -1):
        ca, sa, ct, st = table[i, 0], table[i, 1], work[i, 0], work[i, 1]
        # Add this link to the composite body, about the origin of its own frame.
        m, sx, sy, sz = table[i, 5], table[i, 6], table[i, 7], table[i, 8]
        xx += table[i, 9] + m * (sy * sy + sz * sz)
        yy += table[i, 10] + m * (sx * sx + sz * sz)
        zz += table[i, 11] + m * (sx * sx + sy * sy)
        xy += table[i, 12] - m * sx * sy
        xz += table[i, 13] - m * sx * sz
        yz += table[i, 14] - m * sy * sz
        mass += m
        hx += m * sx
        hy += m * sy
        hz += m * sz
        # Shift to the joint: the previous frame has its origin at -p.
        px, py, pz = table[i, 2], table[i, 3] * sa, table[i, 3] * ca
        gx, gy, gz = 2.0 * hx + mass * px, 2.0 * hy + mass * py, 2.0 * hz + mass * pz
        xx += gy * py + gz * pz
        yy += gx * px + gz * pz
        zz += gx * px + gy * py
        xy -= hx * py + hy * px + mass * px * py
        xz -= hx * pz + hz * px + mass * px * pz
        yz -= hy * pz + hz * py + mass * py * pz
        hx += mass * px
        hy += mass * py
        hz += mass * pz
        # Into its axes: about x by alpha, then about z by theta.
        hy, hz = ca * hy - sa * hz, sa * hy + ca * hz
        hx, hy = ct * hx - st * hy, st * hx + ct * hy
        xy, xz = ca * xy - sa * xz, sa * xy + ca * xz
        t, u = ca * yy - sa * yz, ca * yz - sa * zz
        v, w = sa * yy + ca * yz, sa * yz + ca * zz
        yy, yz, zz = ca * t - sa * u, sa * t + ca * u, sa * v + ca * w
        xz, yz = ct * xz - st * yz, st * xz + ct * yz
        t, u = ct * xx - st * xy, ct * xy - st * yy
        v, w = st * xx + ct * xy, st * xy + ct * yy
        xx, xy, yy = ct * t - st * u, st * t + ct * u, st * v + ct * w
        # Unit rate about z: angular momentum (xz, yz, zz), momentum z x h.
        d[i, i] = zz
        nx, ny, nz, fx, fy, fz = xz, yz, zz, -hy, hx, 0.0
        for j in range(i - 1, -1, -1):
            cb, sb, cj, sj = table[j, 0], table[j, 1], work[j, 0], work[j, 1]
            px, py, pz = table[j, 2], table[j, 3] * sb, table[j, 3] * cb
            nx += py * fz - pz * fy
            ny += pz * fx - px * fz
            nz += px * fy - py * fx
            t = cb * ny - sb * nz
            nx, ny, nz = cj * nx - sj * t, sj * nx + cj * t, sb * ny + cb * nz
            t = cb * fy - sb * fz
            fx, fy, fz = cj * fx - sj * t, sj * fx + cj * t, sb * fy + cb * fz
            d[i, j] = nz
            d[j, i] = nz


@called
def inverse(
    table: Array, gravity: Array, q: Array, qd: Array, qdd: Array, work: Array, out: Array
) -> None:
    """Torques `out` (n) for one state: D q'' + h + c + damping q'."""
    turn(table, q, work)
    recurse(table, gravity, qd, qdd, work, out)
    for i in range(table.shape[0]):
        out[i] += table[i, DAMPING] * qd[i]


@called
def solve(d: Array, x: Array) -> bool:
    """Solve D x = b in place, b given in `x`, by Cholesky; `d` becomes its factor.

    False if D is not positive definite (a joint that moves no mass); `x` is then invalid.
    """
    n = d.shape[0]
    for j in range(n):
        most = d[j, j]
        pivot = most
        for k in range(j):
            pivot -= d[j, k] * d[j, k]
        if not pivot > 1e-13 * most:
            return False
        root = math.sqrt(pivot)
        d[j, j] = root
        total = x[j]
        for k in range(j):
            total -= d[j, k] * x[k]
        x[j] = total / root
        for i in range(j + 1, n):
            total = d[i, j]
            for k in range(j):
                total -= d[i, k] * d[j, k]
            d[i, j] = total / root
    for j in range(n - 1, -1, -1):
        total = x[j]
        for k in range(j + 1, n):
            total -= d[k, j] * x[k]
        x[j] = total / d[j, j]
    return True


@called
def forward(
    table: Array,
    gravity: Array,
    q: Array,
    qd: Array,
    torque: Array,
    work: Array,
    d: Array,
    out: Array,
) -> bool:
    """Accelerations `out` (n) of one state; `d` (n, n) is scratch. False if D is singular."""
    n = table.shape[0]
    turn(table, q, work)
    for i in range(n):
        d[0, i] = 0.0
    recurse(table, gravity, qd, d[0], work, out)
    for i in range(n):
        out[i] = torque[i] - table[i, DAMPING] * qd[i] - out[i]
    mass_matrix(table, work, d)
    return solve(d, out)


@called
def energy(table: Array, gravity: Array, q: Array, qd: Array, work: Array, d: Array) -> float:
    """Kinetic plus potential energy, J; the potential is zero at the base origin."""
    n = table.shape[0]
    turn(table, q, work)
    mass_matrix(table, work, d)
    total = 0.0
    for i in range(n):
        for k in range(n):
            total += 0.5 * qd[i] * d[i, k] * qd[k]
    # First moment of the whole arm, transformed from the tip to the base frame.
    mass = hx = hy = hz = 0.0
    for i in range(n - 1, -1, -1):
        ca, sa, ct, st = table[i, 0], table[i, 1], work[i, 0], work[i, 1]
        m = table[i, 5]
        mass += m
        hx += m * table[i, 6] + mass * table[i, 2]
        hy += m * table[i, 7] + mass * table[i, 3] * sa
        hz += m * table[i, 8] + mass * table[i, 3] * ca
        hy, hz = ca * hy - sa * hz, sa * hy + ca * hz
        hx, hy = ct * hx - st * hy, st * hx + ct * hy
    return float(total - gravity[0] * hx - gravity[1] * hy - gravity[2] * hz)


@entry_point(
    "void(float64[:,::1],float64[::1],float64[:,::1],float64[:,::1],float64[:,::1],float64[:,::1])"
)
def inverse_batch(
    table: Array, gravity: Array, q: Array, qd: Array, qdd: Array, out: Array
) -> None:
    """Torques for each row of a batch, all (batch, n)."""
    work = np.zeros((table.shape[0], WORK))
    for b in range(q.shape[0]):
        inverse(table, gravity, q[b], qd[b], qdd[b], work, out[b])


@entry_point("boolean(float64[::1],float64[::1],float64[::1],float64[::1])")
def inverse_one(pad: Array, q: Array, qd: Array, qdd: Array) -> bool:
    """Torques of one state, written to the end of `pad`; False if a size is wrong.

    `pad` holds gravity (3), table, work space and torques in one array, because each array argument
    costs a tenth of a microsecond, as much as half an arm.
    """
    n = (pad.shape[0] - 3) // (COLUMNS + WORK + 1)
    if q.shape[0] != n or qd.shape[0] != n or qdd.shape[0] != n:
        return False
    end = 3 + COLUMNS * n
    table = pad[3:end].reshape((n, COLUMNS))
    work = pad[end : end + WORK * n].reshape((n, WORK))
    inverse(table, pad[:3], q, qd, qdd, work, pad[end + WORK * n :])
    return True


@entry_point(
    "int64(float64[:,::1],float64[::1],float64[:,::1],float64[:,::1],float64[:,::1],float64[:,::1])"
)
def forward_batch(
    table: Array, gravity: Array, q: Array, qd: Array, torque: Array, out: Array
) -> int:
    """Accelerations for each row of a batch; returns the first row with a singular D, or -1."""
    n = table.shape[0]
    work, d = np.zeros((n, WORK)), np.zeros((n, n))
    for b in range(q.shape[0]):
        if not forward(table, gravity, q[b], qd[b], torque[b], work, d, out[b]):
            return b
    return -1


@entry_point("void(float64[:,::1],float64[:,::1],float64[:,:,::1])")
def mass_batch(table: Array, q: Array, out: Array) -> None:
    """D for each row of a batch: q (batch, n), out (batch, n, n)."""
    work = np.zeros((table.shape[0], WORK))
    for b in range(q.shape[0]):
        turn(table, q[b], work)
        mass_matrix(table, work, out[b])


@entry_point("void(float64[:,::1],float64[::1],float64[:,::1],float64[:,::1],float64[::1])")
def energy_batch(table: Array, gravity: Array, q: Array, qd: Array, out: Array) -> None:
    """Total energy for each row of a batch."""
    n = table.shape[0]
    work, d = np.zeros((n, WORK)), np.zeros((n, n))
    for b in range(q.shape[0]):
        out[b] = energy(table, gravity, q[b], qd[b], work, d)
