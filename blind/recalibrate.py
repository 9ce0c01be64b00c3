"""What is left of an effect once the nominal constants are fitted anew, linearised on a design.

The generator's own measure, not a diagnosis: it works on noise-free readings with the effect on
and off. Residuals are those of the stages: force against the force that the shown pressure and
length call for, pressure of valve trials against the commanded one, shown against written length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import cho_solve

from blind.design import Design
from blind.noise import Noise
from blind.physics import numbers as n
from blind.physics.bench import CONSTANTS, Trial, no_effect, tolerances
from blind.physics.entries import CATALOGUE, Hidden, draw
from blind.physics.readings import read_trial

Floats = np.ndarray
GRAVITY = 9.80665
# Independent looks that one channel of one trial gives, whatever its rate: noise is correlated.
LOOKS = 12.0
ROUGH = 4.0
END_SD = 3.0
MOST_STEPS = 10


@dataclass(frozen=True)
class Layout:
    """Where each trial's residuals stand in the long vector."""

    force: tuple[slice, ...]
    pressure: tuple[slice, ...]
    length: tuple[slice, ...]
    size: int


def instants(trial: Trial) -> tuple[Floats, Floats, Floats]:
    """Evaluation times of force, pressure and length residuals of a trial, s."""
    none = np.zeros(0)
    if trial.settled_s is not None:
        settled = trial.settled_s
        return settled, none, settled if trial.load_kg > 0.0 else none
    count = 60
    even = np.linspace(0.0, trial.duration_s, count, endpoint=False) + 1e-3
    if trial.valved:
        fine = [np.linspace(0.0, 0.08, 25) + edge for edge in trial.edges[:, 0]]
        p = np.unique(np.round(np.concatenate([even, *fine]), 4))
        p = p[p < trial.duration_s]
        if len(p) > 160:
            p = p[:: len(p) // 160 + 1]
    else:
        p = none
        if trial.protocol == "triangle":
            even = np.linspace(0.0, trial.duration_s, 200, endpoint=False) + 1e-3
    has_force = trial.force_hz > 0.0 or trial.load_kg > 0.0
    return (even if has_force else none), p, (even if trial.camera_hz > 0.0 else none)


def braid_slopes(p: Floats, length: Floats, c: Floats) -> tuple[Floats, Floats]:
    """Slopes of the nominal force over pressure (N/kPa) and length (N/mm)."""
    k = 1e-3 / (4.0 * np.pi * c[n.TURNS] ** 2)
    return k * (3.0 * length**2 - c[n.BRAID] ** 2), k * p * 6.0 * length


def touched_by_constant(place: int) -> Callable[[Trial], bool]:
    """Which trials a constant shows in."""
    if place in (n.BRAID, n.TURNS):
        return lambda _: True
    if place in (n.L_MIN, n.L_MAX, n.LOAD_C):
        return lambda trial: trial.load_kg > 0.0
    return lambda trial: trial.valved


def touched_by_effect(hidden: Hidden) -> Callable[[Trial], bool]:
    """Which trials an effect can show in."""
    if hidden.entry.stage in ("valve", "chamber"):
        return lambda trial: trial.valved
    if hidden.entry.needs == "load":
        return lambda trial: trial.load_kg > 0.0
    if hidden.id == "temperature_stiffening":
        return lambda trial: trial.temperature_c != 21.0
    if hidden.id == "length_label":
        return lambda trial: trial.held_mm is not None
    if hidden.id in ("viscosity", "camera_delay"):
        return lambda trial: trial.held_mm is None
    if hidden.id in ("camera_scale", "camera_distortion", "pixel_locking"):
        return lambda trial: trial.camera_hz > 0.0 or trial.load_kg > 0.0
    return lambda _: True


class Recalibration:
    """Signatures, floors and the fit of the nominal constants for one design."""

    def __init__(self, design: Design, noise: Noise) -> None:
        seen: dict[tuple[str, int], Trial] = {}
        for trial in design.trials:  # replicates of a mounting say the same without noise
            seen.setdefault((trial.slot, trial.mounting), trial)
        self.design = replace(design, trials=tuple(seen.values()))
        self.noise = noise
        self.times = {t.trial: instants(t) for t in self.design.trials}
        self.base = [self._read(t, design.true, no_effect()) for t in self.design.trials]
        self.layout = self._layout()
        self.floor = self._floors()
        self.weight = self._weights()
        self.jacobian, self.shift = self._jacobian()
        self._nuisances: tuple[Floats, Floats] | None = None
        self.warm: dict[tuple[Any, ...], tuple[Floats, Floats]] = {}

    def _read(self, trial: Trial, c: Floats, e: Floats) -> tuple[Floats, ...]:
        """Shown pressure and pull at the force instants, pressure, length there and on its own."""
        tf, tp, tl = self.times[trial.trial]
        at_p = np.concatenate([tf, tp])
        grid = np.unique(at_p)
        r = read_trial(trial, c, e, grid, tf, tf if len(tf) else tl, ROUGH)
        p_f = r.pressure[np.searchsorted(grid, tf)]
        p_p = r.pressure[np.searchsorted(grid, tp)]
        if trial.load_kg > 0.0 and trial.force_hz == 0.0 and len(tf):
            pull = trial.load_kg * (GRAVITY - 1e-3 * r.acceleration)
            pull = np.where(r.length > c[n.L_MAX] - 0.05, np.nan, pull)
        else:
            pull = r.force
        return p_f, pull, p_p, r.length

    def _layout(self) -> Layout:
        at = 0
        places: list[list[slice]] = [[], [], []]
        for trial in self.design.trials:
            tf, tp, tl = self.times[trial.trial]
            held = trial.held_mm is not None
            for kind, size in enumerate((len(tf), len(tp), len(tl) if held else 0)):
                places[kind].append(slice(at, at + size))
                at += size
        return Layout(tuple(places[0]), tuple(places[1]), tuple(places[2]), at)

    def _floors(self) -> Floats:
        """Replicate scatter of each residual, 1 sd: zeros, gains, noise, mountings."""
        q, out = self.noise, np.zeros(self.layout.size)
        for i, trial in enumerate(self.design.trials):
            p, pull, p_p, _ = self.base[i]
            length = self._length(trial, self.base[i])
            fp, fl = braid_slopes(p, length, self.design.stated)
            sp2 = q.pressure_zero_kpa**2 + (q.pressure_gain * p) ** 2 + (0.4 * q.pressure_kpa) ** 2
            force = np.nan_to_num(pull)
            sf2: Any
            if trial.load_kg > 0.0 and trial.force_hz == 0.0:
                sf2 = np.full_like(p, 1e-6)
            elif q.balance and trial.force_hz <= 10.0:
                sf2 = 0.05**2 + (0.0002 * force) ** 2
            else:
                sf2 = q.force_n**2 + q.force_slow_n**2 + q.force_zero_n**2
                sf2 = sf2 + (q.force_gain * force) ** 2
            sl2: Any = q.mounting_mm**2
            if trial.held_mm is None:
                sl2 += q.length_mm**2 + q.length_zero_mm**2 + (q.length_gain * 60.0) ** 2
            out[self.layout.force[i]] = np.sqrt(sf2 + fp**2 * sp2 + fl**2 * sl2)
            out[self.layout.pressure[i]] = np.sqrt(
                q.pressure_kpa**2 + q.pressure_zero_kpa**2 + (q.pressure_gain * p_p) ** 2
            )
            out[self.layout.length[i]] = np.sqrt(
                q.length_mm**2 + q.length_zero_mm**2 + q.mounting_mm**2
                + (q.length_gain * 60.0) ** 2
            )  # fmt: skip
        return out

    def _weights(self) -> Floats:
        w = np.zeros(self.layout.size)
        for kind in (self.layout.force, self.layout.pressure, self.layout.length):
            for place in kind:
                size = place.stop - place.start
                if size:
                    w[place] = np.sqrt(min(LOOKS, size) / size) / self.floor[place]
        return w

    def _length(self, trial: Trial, read: tuple[Floats, ...]) -> Floats:
        """Length a diagnosis would believe, at the force instants, mm."""
        if trial.held_mm is not None:
            return np.full(len(read[0]), trial.held_mm)
        return read[3][: len(read[0])]

    def difference(
        self, c: Floats, e: Floats, touches: Callable[[Trial], bool] = lambda _: True
    ) -> Floats:
        """Stage residuals with constants c and effects e, less those of the plain bench.

        Trials that `touches` says are not touched are skipped.
        """
        out = np.zeros(self.layout.size)
        for i, trial in enumerate(self.design.trials):
            if not touches(trial):
                continue
            off = self.base[i]
            on = self._read(trial, c, e)
            before = self._length(trial, off)
            # Pull that shown pressure and length call for: exact difference, not a slope.
            k = 1e-3 / (4.0 * np.pi * self.design.stated[n.TURNS] ** 2)
            b2 = self.design.stated[n.BRAID] ** 2
            after = self._length(trial, on)
            call = k * (on[0] * (3.0 * after**2 - b2) - off[0] * (3.0 * before**2 - b2))
            out[self.layout.force[i]] = np.nan_to_num(on[1] - off[1] - call)
            out[self.layout.pressure[i]] = on[2] - off[2]
            if self.layout.length[i].stop > self.layout.length[i].start:
                out[self.layout.length[i]] = on[3] - off[3]
        return out

    def _jacobian(self) -> tuple[Floats, Floats]:
        """Residuals of one sd of each constant, and how far this bench's own are from stated."""
        true, stated = self.design.true, self.design.stated
        sd = tolerances(stated)
        columns, shift = [], []
        for name, place, _, tolerance, _ in CONSTANTS:
            if tolerance == 0.0:
                continue
            c = true.copy()
            c[place] += 0.5 * sd[place]
            off = true[place] - stated[place]
            if name == "atmosphere_kpa":
                c[n.SUPPLY] += 0.5 * sd[place]  # the supply is a gauge pressure
            elif name == "supply_kpa":
                off -= true[n.ATMOSPHERE] - stated[n.ATMOSPHERE]
            touches = touched_by_constant(place)
            columns.append(self.difference(c, no_effect(), touches) / 0.5)
            # A slope of delays that is stated as none is known to be none.
            shift.append(off / sd[place] if sd[place] > 0.0 else 0.0)
        return np.column_stack(columns), np.array(shift)

    def constants(self, x: Floats) -> Floats:
        """Constants x sd from the stated ones; the supply is a gauge pressure."""
        c, sd = self.design.stated.copy(), tolerances(self.design.stated)
        kept = [(name, place) for name, place, _, tolerance, _ in CONSTANTS if tolerance > 0.0]
        for (name, place), amount in zip(kept, x, strict=True):
            c[place] += amount * sd[place]
            if name == "atmosphere_kpa":
                c[n.SUPPLY] += amount * sd[place]
        return c

    def left_of(self, hidden: list[Hidden]) -> Floats:
        """What effects leave once the stated constants are fitted to the bench that has them.

        The bench's own constants are off too, and the fit starts from the stated ones: an effect
        that leads back to them is no gap. Each constant has its tolerance as prior, and three sd
        as its end. Gauss-Newton with Broyden's update of the slopes.
        """
        signal = self.signature_of(hidden)
        slopes, w = self.jacobian * self.weight[:, None], self.weight
        x, left = self.shift.copy(), signal
        cost = float(np.sum((left * w) ** 2) + x @ x)

        def tried(at: Floats) -> tuple[Floats, float]:
            made = signal - self.difference(self.constants(at), no_effect())
            return made, float(np.sum((made * w) ** 2) + at @ at)

        key = tuple((h.id, h.variant) for h in hidden)
        if key in self.warm:  # the same effect at another strength: start where that ended
            start, bent = self.warm[key]
            made, fresh_cost = tried(start)
            if fresh_cost < cost:
                x, left, cost, slopes = start, made, fresh_cost, bent
        failed = 0
        for _ in range(MOST_STEPS):
            step = self._step(slopes, left * w, x)
            if float(np.abs(step).max()) < 0.02:
                break
            before = cost
            for length in (1.0, 0.4):
                fresh = np.clip(x + length * step, -END_SD, END_SD)
                made, fresh_cost = tried(fresh)
                moved = fresh - x
                miss = (left - made) * w - slopes @ moved
                slopes = slopes + np.outer(miss, moved) / max(float(moved @ moved), 1e-12)
                if fresh_cost < cost:
                    x, left, cost = fresh, made, fresh_cost
                    break
            failed += cost > 0.97 * before
            if failed == 2:
                break
        self.warm[key] = x, slopes
        return left

    @staticmethod
    def _step(slopes: Floats, white: Floats, x: Floats) -> Floats:
        """Step of the constants that fits best and stays within three sd."""
        free = np.ones(len(x), dtype=bool)
        step = np.zeros_like(x)
        for _ in range(6):
            a = slopes[:, free]
            rest = white - slopes[:, ~free] @ step[~free]
            h = a.T @ a + np.eye(int(free.sum()))
            step[free] = np.linalg.solve(h, a.T @ rest - x[free])
            beyond = free & (np.abs(x + step) > END_SD + 1e-9)
            if not beyond.any():
                break
            step[beyond] = np.clip(x + step, -END_SD, END_SD)[beyond] - x[beyond]
            free &= ~beyond
        return step

    def blocks(self) -> Iterator[tuple[str, str, Floats]]:
        """Channel, protocol (or 'all') and the indices of its residuals."""
        names = sorted({t.protocol for t in self.design.trials})
        for channel, places in (
            ("force_n", self.layout.force),
            ("pressure_kpa", self.layout.pressure),
            ("length_mm", self.layout.length),
        ):
            for name in ["all", *names]:
                found = [
                    np.arange(s.start, s.stop)
                    for s, t in zip(places, self.design.trials, strict=True)
                    if name in ("all", t.protocol)
                ]
                index = np.concatenate(found) if found else np.zeros(0, dtype=int)
                if len(index):
                    yield channel, name, index.astype(int)

    def ratio(self, left: Floats) -> dict[str, float]:
        """Gap over floor (rms over rms): of the clearest channel, and of the clearest block."""
        best, local = 0.0, 0.0
        for _, protocol, index in self.blocks():
            r = float(np.sqrt(np.mean(left[index] ** 2)) / np.sqrt(np.mean(self.floor[index] ** 2)))
            local = max(local, r)
            if protocol == "all":
                best = max(best, r)
        return {"gap_over_floor": best, "gap_over_floor_block": local}

    def signature(self, hidden: Hidden) -> Floats:
        """Stage residuals of one effect."""
        e = no_effect()
        hidden.put(e)
        return self.difference(self.design.true, e, touched_by_effect(hidden))

    def signature_of(self, hidden: list[Hidden]) -> Floats:
        """Stage residuals of several effects at once."""
        e = no_effect()
        for one in hidden:
            one.put(e)
        return self.difference(self.design.true, e)

    def nuisances(self) -> tuple[Floats, Floats]:
        """Whitened columns of constants, zeros and gains, and the Cholesky factor of their fit.

        The priors are one sd each, so the normal matrix is A'A + 1.
        """
        if self._nuisances is not None:
            return self._nuisances
        q, columns = self.noise, [self.jacobian[:, j] for j in range(self.jacobian.shape[1])]
        for i, trial in enumerate(self.design.trials):
            p, pull, p_p, _ = self.base[i]
            length = self._length(trial, self.base[i])
            fp, _ = braid_slopes(p, length, self.design.stated)
            place, valve = self.layout.force[i], self.layout.pressure[i]
            for zero, gain in ((True, False), (False, True)):
                column = np.zeros(self.layout.size)
                size = q.pressure_zero_kpa if zero else q.pressure_gain
                column[place] = -fp * size * (1.0 if zero else p)
                column[valve] = size * (1.0 if zero else p_p)
                columns.append(column)
                column = np.zeros(self.layout.size)
                force = np.nan_to_num(pull)
                column[place] = q.force_zero_n if zero else q.force_gain * force * gain
                columns.append(column)
        a = np.column_stack(columns) * self.weight[:, None]
        factor = np.linalg.cholesky(a.T @ a + np.eye(a.shape[1]))
        self._nuisances = a, factor
        return self._nuisances

    def bare(self, signal: Floats) -> Floats:
        """Whitened residual clear of all that constants, zeros and gains can take.

        The prior's rows follow, so that inner products of bare residuals are those of the fit.
        """
        a, factor = self.nuisances()
        white = signal * self.weight
        x = cho_solve((factor, True), a.T @ white)
        return np.concatenate([white - a @ x, -x])

    def rivals(self) -> Iterator[Hidden]:
        """Every catalogue entry, plain and in another form, at every edge and side."""
        rng = np.random.default_rng(0)
        for entry in CATALOGUE:
            for form in (0, 1):
                for variant in entry.variants or (None,):
                    one = draw(entry, rng, self.design.stated, form)
                    yield Hidden(entry.id, form, abs(one.strength), one.shape, variant)

    def rival_signatures(self) -> tuple[list[Hidden], Floats]:
        """All rivals that show on this design, and their bare unit signatures as columns."""
        found, columns = [], []
        for rival in self.rivals():
            bare = self.bare(self.signature(rival))
            size = float(np.linalg.norm(bare))
            if size > 0.05:
                found.append(rival)
                columns.append(bare / size)
        return found, np.column_stack(columns) if columns else np.zeros((0, 0))
