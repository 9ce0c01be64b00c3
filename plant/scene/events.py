"""Compiled detection and logging of the events that end a substep of a scene early."""

from __future__ import annotations

from plant.compiled import inlined
from plant.scene import layout as sc
from plant.scene.layout import World

# Tolerance of the static friction limit, N.
GRIP = 1e-6
_NEAR = 1e-12
_STILL = 1e-12


@inlined
def log(w: World, time: float, kind: float, which: float, value: float) -> None:
    """Log an event; when the log is full, only the count increases."""
    row = int(w.clock[sc.LOGGED])
    if row < w.log.shape[0]:
        w.log[row, sc.LOG_TIME] = time
        w.log[row, sc.LOG_KIND] = kind
        w.log[row, sc.LOG_WHICH] = which
        w.log[row, sc.LOG_VALUE] = value
    w.clock[sc.LOGGED] = row + 1.0


@inlined
def release(w: World, now: float) -> None:
    """Release every stuck coordinate whose net force (row TORQUE) exceeds its static friction.

    Its acceleration (row DQD) then comes from the remaining force.
    """
    for j in range(w.coords.shape[0]):
        coulomb = w.coords[j, sc.COULOMB]
        if coulomb > 0.0 and w.motion[sc.SLIDING, j] == 0.0:
            push = w.work[sc.TORQUE, j]
            if abs(push) >= coulomb - GRIP:
                way = 1.0 if push > 0.0 else -1.0
                w.motion[sc.SLIDING, j] = way
                w.work[sc.DQD, j] = (push - way * coulomb) / w.coords[j, sc.MASS]
                log(w, now, sc.LOG_FREED, float(j), push)


@inlined
def first_event(w: World) -> float:
    """Fraction of the last trial substep at which the first event occurs; 1 if there is none.

    End values within rounding of an event are set exactly to it.
    """
    share = 1.0
    for j in range(w.coords.shape[0]):
        before, after = w.motion[sc.PLACE, j], w.work[sc.Q, j]
        for stop in (w.coords[j, sc.LOW], w.coords[j, sc.HIGH]):
            if (before - stop) * (after - stop) < 0.0:
                if abs(after - stop) < _NEAR:
                    w.work[sc.Q, j] = stop
                else:
                    share = min(share, (stop - before) / (after - before))
        coulomb = w.coords[j, sc.COULOMB]
        if coulomb > 0.0:
            way = w.motion[sc.SLIDING, j]
            if way != 0.0:
                begin, end = w.motion[sc.RATE, j], w.work[sc.QD, j]
                if end * way < 0.0 and begin * way > _STILL:
                    if abs(end) < _STILL:
                        w.work[sc.QD, j] = 0.0
                    else:
                        share = min(share, begin / (begin - end))
            else:
                begin = abs(w.motion[sc.PUSH, j]) - coulomb
                end = abs(w.work[sc.TORQUE, j]) - coulomb
                if end > GRIP and begin < 0.0:
                    share = min(share, begin / (begin - end))
    return share


@inlined
def _between(w: World, j: int, step: float, share: float) -> float:
    """Position of coordinate `j` at a fraction of the substep, by cubic Hermite interpolation."""
    q0, q1 = w.motion[sc.PLACE, j], w.work[sc.Q, j]
    v0, v1 = w.motion[sc.RATE, j] * step, w.work[sc.QD, j] * step
    s = share
    rise = s * s * (3.0 - 2.0 * s)
    return float(q0 + (q1 - q0) * rise + v0 * s * (1.0 - s) ** 2 - v1 * s * s * (1.0 - s))


@inlined
def log_switches(w: World, begin: float, step: float) -> None:
    """Log each proximity switch that went on or off in the substep, at its exact time."""
    for i in range(w.switches.shape[0]):
        j = int(w.switches[i, sc.SWITCH_COORD])
        at = w.switches[i, sc.SWITCH_AT]
        reach = w.switches[i, sc.SWITCH_REACH]
        # The coordinate may pass both edges of the window in one substep.
        low = 0.0
        for _ in range(2):
            on = w.switches[i, sc.SWITCH_ON] != 0.0
            edge = reach + w.switches[i, sc.SWITCH_GAP] if on else reach
            here = abs(_between(w, j, step, low) - at) - edge
            found = -1.0
            for part in range(1, 5):
                high = low + (1.0 - low) * part / 4.0
                there = abs(_between(w, j, step, high) - at) - edge
                if (there > 0.0 if on else there <= 0.0) and (here <= 0.0 if on else here > 0.0):
                    found = high
                    break
            if found < 0.0:
                break
            left, right = low, found
            for _bisection in range(40):
                middle = 0.5 * (left + right)
                outside = abs(_between(w, j, step, middle) - at) - edge > 0.0
                if outside == on:
                    right = middle
                else:
                    left = middle
            w.switches[i, sc.SWITCH_ON] = 0.0 if on else 1.0
            log(w, begin + right * step, sc.LOG_SWITCH, float(i), 0.0 if on else 1.0)
            low = right


@inlined
def settle(w: World, now: float) -> None:
    """After an accepted substep, log contacts with stops and coordinates stopped by friction."""
    for j in range(w.coords.shape[0]):
        q, rate = w.motion[sc.PLACE, j], w.motion[sc.RATE, j]
        if q == w.coords[j, sc.LOW] and rate < 0.0:
            log(w, now, sc.LOG_LOW, float(j), rate)
        elif q == w.coords[j, sc.HIGH] and rate > 0.0:
            log(w, now, sc.LOG_HIGH, float(j), rate)
        if w.coords[j, sc.COULOMB] > 0.0:
            way = w.motion[sc.SLIDING, j]
            if way != 0.0 and rate * way <= 0.0:
                w.motion[sc.RATE, j] = 0.0
                w.motion[sc.SLIDING, j] = 0.0
                log(w, now, sc.LOG_STUCK, float(j), q)
