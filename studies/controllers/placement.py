"""Pole placement with an observer (section 1.6.1, Figures 1-6 and 1-7), all joints at once.

Design, on the nominal linear model at the reference's middle posture, sampled at the host's rate:

- state feedback: every oscillation keeps its frequency and gets a damping ratio of 0.7. Poles that
  are real or sufficiently damped do not change, so that no control effort is spent on them;
- observer: from the angles it estimates rates, pressure differences and a constant disturbance per
  joint (in kPa), which is subtracted from the input (integral action). Its poles are real, 40 to
  90 1/s; plant poles faster than 150 1/s do not change;
- the dead time of the pressure loop is compensated by a prediction with the model, from the
  estimate over the inputs that have not arrived yet.
"""

from __future__ import annotations

import warnings
from collections import deque

import numpy as np
from scipy.signal import place_poles

from plant.arrays import Array
from studies.controllers.loop import HOST_MS
from studies.controllers.model import Linear
from studies.controllers.reference import Reference

DAMPING = 0.7
OBSERVER = (40.0, 90.0)
KEPT_ABOVE = 150.0


def feedback_rates(rates: Array, damping: float = DAMPING) -> Array:
    """Target poles (complex, 1/s): oscillations damped, other poles unchanged."""
    out = np.array(rates, dtype=complex)
    for index, pole in enumerate(rates):
        size = abs(pole)
        if abs(pole.imag) > 1e-6 and -pole.real < damping * size:
            along = np.sqrt(1.0 - damping**2) * size
            out[index] = -damping * size + 1j * np.sign(pole.imag) * along
    return out


class PolePlacement:
    """State feedback with an observer. `dead_s` is the dead time of the pressures."""

    def __init__(self, model: Linear, dead_s: float, limit_kpa: float = 250.0) -> None:
        step = HOST_MS * 1e-3
        self.model = model
        n = model.degrees
        self._n = n
        self._limit = limit_kpa
        self._ahead = max(1, round(dead_s / step))
        self.a, self.b = model.sampled(step)
        self.feedback_poles = np.exp(feedback_rates(np.asarray(model.rates)) * step)
        self.k = _placed(self.a, self.b, self.feedback_poles)
        # Model of the observer: a constant disturbance is added to the input.
        self.a_wide = np.block([[self.a, self.b], [np.zeros((n, 3 * n)), np.eye(n)]])
        self.c_wide = np.zeros((n, 4 * n))
        self.c_wide[:, :n] = np.eye(n)
        kept = [z for z in np.linalg.eigvals(self.a) if abs(z) < np.exp(-KEPT_ABOVE * step)]
        free = 4 * n - len(kept)
        self.observer_poles = np.concatenate(
            [np.exp(-np.linspace(*OBSERVER, free) * step), np.array(kept)]
        )
        self.gain = _placed(self.a_wide.T, self.c_wide.T, self.observer_poles).T
        self._estimate = np.zeros(4 * n)
        self._sent: deque[Array] = deque([np.zeros(n)] * self._ahead, maxlen=self._ahead)
        self._reference: Reference | None = None

    def start(self, reference: Reference, q: Array) -> None:
        """Start with an estimate at rest at `q`."""
        n = self._n
        self._reference = reference.smooth
        self._estimate = np.zeros(4 * n)
        self._estimate[:n] = q - self.model.q0
        self._sent = deque([np.zeros(n)] * self._ahead, maxlen=self._ahead)

    def delta(self, time_s: float, q: Array) -> Array:
        """Correct the estimate by the reading, predict, feed back."""
        assert self._reference is not None
        n, model = self._n, self.model
        x = self._estimate
        x = x + np.linalg.solve(self.a_wide, self.gain) @ (q - model.q0 - x[:n])
        state, disturbance = x[: 3 * n], x[3 * n :]
        ahead = state
        for u in self._sent:
            ahead = self.a @ ahead + self.b @ (u + disturbance)
        # The command of now acts on the state at that later time.
        wanted, rate, _ = self._reference.at(time_s + self._ahead * HOST_MS * 1e-3)
        goal = np.zeros(3 * n)
        goal[:n] = wanted - model.q0
        goal[n : 2 * n] = rate
        goal[2 * n :] = np.linalg.solve(model.gain, model.stiffness @ goal[:n])
        u = goal[2 * n :] - disturbance - self.k @ (ahead - goal)
        total = np.clip(model.delta0 + u, -self._limit, self._limit)
        arriving = self._sent[0]
        self._sent.append(total - model.delta0)
        self._estimate = np.concatenate(
            [self.a @ state + self.b @ (arriving + disturbance), disturbance]
        )
        return np.asarray(total)


def _placed(a: Array, b: Array, poles: Array) -> Array:
    """Gain k for these poles of a - b k; equal poles are separated slightly."""
    apart = np.array(poles, dtype=complex)
    inputs = np.linalg.matrix_rank(b)
    for index in range(len(apart)):
        twins = np.sum(np.abs(apart[:index] - apart[index]) < 1e-9)
        if twins >= inputs:
            apart[index] += 1e-4 * twins
    with warnings.catch_warnings():
        # scipy warns if more iterations could improve the conditioning; the poles are correct.
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(place_poles(a, b, apart).gain_matrix.real)
