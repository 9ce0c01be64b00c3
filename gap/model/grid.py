"""A data set made ready: every stage's inputs and outputs at the instants where they are compared.

Measured signals are fed into each block. Force is compared where it was read, with pressure and
length taken there; a hung load where the camera saw it; pressure at its own samples near valve
edges and at means over 20 ms elsewhere. No channel is filtered more than another.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gap.data.dataset import DataSet
from gap.data.motion import moves
from gap.data.simulator import compared, rough_error_n
from gap.data.trial import Channel, Trial
from gap.model import bins
from gap.model.clipping import CLIPPED_INPUT_KPA, CLIPPED_KPA
from gap.model.features import BLOCKS, Mean, Rows, stacked
from gap.model.nominal import nominal_law
from gap.model.signals import Signal, edges_of, smooth_slope
from gap.model.unobserved_flow import passing, unknown_gas
from plant.arrays import Array
from plant.effects.arguments import Points, Whole
from plant.effects.reference import FULL_PRESSURE_PA, TEMPERATURE_C, TYPICAL_FORCE_N
from plant.physics.muscle import braid_force, braid_force_slope, braid_volume, braid_volume_slope

Mask = npt.NDArray[np.bool_]
MOST_POINTS = 2400
QUIET_S = 0.02
# What no replicate shows because all share it: interpolation, integration, edges in time.
_FORCE_FLOOR_N = 0.015
_SLOPE_M = 0.1e-3
_LENGTH_FLOOR_M = 0.008e-3
_EDGE_FLOOR_S = 0.03e-3


@dataclass(frozen=True)
class Grid:
    """Points of every block, their rows, and the valve edges; see `make_grid`."""

    data: DataSet
    points: dict[str, Points]
    rows: Rows
    offset: dict[str, int]
    first_edge: Whole
    edge_s: Array
    edge_to: Array
    edge_of: Whole
    supply: Array
    regulated: tuple[bool, ...]

    def spacing_s(self, blocks: Iterable[str]) -> float:
        """Least median time in s between the points of some blocks; 0 where they have none."""
        found = []
        for points in (self.points[block] for block in blocks if block in self.points):
            steps = np.diff(points.time_s)[(np.diff(points.trial) == 0) & ~points.settled[1:]]
            found += [float(np.median(steps))] if len(steps) else []
        return min(found, default=0.0)


def make_grid(data: DataSet) -> Grid:
    """Points and feature rows of a data set. Trials without what a block needs are absent in it."""
    edges = [edges_of(trial) for trial in data.trials]
    ends: dict[tuple[str, str], Array] = {}
    gathered: dict[str, list[_Piece]] = {name: [] for name in BLOCKS}
    supply: list[Array] = []
    regulated: list[bool] = []
    alike = np.r_[same_conditions(data), 0.5]
    for index, trial in enumerate(data.trials):
        signal = Signal.of(trial, data.constants)
        marks = np.unique(edges[index][0]) if len(edges[index][0]) else np.empty(0)
        regulated.append(signal.regulated)
        for block, piece in _pieces(trial, signal, marks, data):
            piece.trial = index
            if block == "pressure":
                supply.append(piece.extra)
            _assign(piece, block, trial, marks, ends, alike)
            gathered[block].append(piece)
    points: dict[str, Points] = {}
    rows: list[Rows] = []
    offset: dict[str, int] = {}
    count = 0
    for number, block in enumerate(BLOCKS):
        if not gathered[block]:
            continue
        made, made_rows = _joined(gathered[block], number, data.mountings)
        points[block] = made
        rows.append(made_rows)
        offset[block] = count
        count += len(made_rows)
    whole = stacked(rows)
    lengths = np.array([len(e[0]) for e in edges], dtype=np.int64)
    return Grid(
        data=data,
        points=points,
        rows=whole,
        offset=offset,
        first_edge=np.r_[0, np.cumsum(lengths)].astype(np.int64),
        edge_s=np.concatenate([e[0] for e in edges]) if edges else np.empty(0),
        edge_to=np.concatenate([e[1] for e in edges]) if edges else np.empty(0),
        edge_of=np.concatenate([e[2] for e in edges]) if edges else np.empty(0, dtype=np.int64),
        supply=np.concatenate(supply) if supply else np.empty(0),
        regulated=tuple(regulated),
    )


_SAME = 0.02
"""Share of the range of pressure, and of length, by which equal conditions may differ."""


def same_conditions(data: DataSet) -> Array:
    """Difference of pressure (Pa) and length (m) up to which two conditions are the same."""
    made = []
    for name, scale, held in (("pressure_kpa", 1e3, ()), ("length_mm", 1e-3, ("held_length_mm",))):
        values = [trial[name].value for trial in data.trials if len(trial.get(name))]
        values += [np.array([getattr(trial, key)]) for trial in data.trials for key in held]
        whole = np.concatenate(values) if values else np.zeros(1)
        known = whole[np.isfinite(whole)]
        made.append(_SAME * scale * float(np.ptp(known)) if len(known) else 0.0)
    return np.array(made)


def trial_order(data: DataSet) -> Array:
    """Order of each trial, from 0; all zero where it is not known of every trial."""
    order = np.array([trial.order for trial in data.trials], dtype=np.float64)
    stated = len(order) > 0 and bool(np.isfinite(order).all())
    return np.asarray(order - order.min() if stated else np.zeros(len(order)))


_ONE_ROOM_K = 3.0
"""Difference of temperature up to which a room is the same."""


def room_temperature(data: DataSet) -> float:
    """Temperature of the room in degC: that of the trials nearest to the stated 21.

    The nominal plant holds there. What it is off by in all trials alike shows nothing of
    temperature, though the room be warmer than stated.
    """
    channels = [(trial.get("temperature_c"), trial.temperature_c) for trial in data.trials]
    means = [float(np.mean(one.value)) if len(one) else usual for one, usual in channels]
    known = np.array([value for value in means if np.isfinite(value)])
    if not len(known):
        return TEMPERATURE_C
    nearest = known[np.argmin(np.abs(known - TEMPERATURE_C))]
    return float(np.median(known[np.abs(known - nearest) <= _ONE_ROOM_K]))


def full_values(data: DataSet) -> tuple[float, float]:
    """Largest force in N and gauge pressure in Pa that were read, single spikes apart."""
    made = []
    for name, usual in (("force_n", TYPICAL_FORCE_N), ("pressure_kpa", FULL_PRESSURE_PA * 1e-3)):
        read = [np.abs(trial[name].value) for trial in data.trials if len(trial.get(name))]
        made.append(float(np.quantile(np.concatenate(read), _SPIKES)) if read else usual)
    return max(made[0], 1.0), max(made[1], 1.0) * 1e3


_SPIKES = 0.99
"""Share of the readings that are no spikes."""


@dataclass
class _Piece:
    """The points of one trial in one block, before its rows are numbered.

    `inertia_n` is `Signal.bend_noise_m_s2` times a hung load's mass.
    """

    time_s: Array
    weight: Array
    pressure: Array
    pressure_slope: Array
    path: Array
    length: Array
    rate: Array
    rate_sd: Array
    acceleration: Array
    held: bool
    temperature: Array
    mass: float
    reading: Array
    direction: Array
    taken: Array
    extra: Array
    settled: bool
    doubt: Array
    floor: Array
    clipped: Mask
    unfollowed: Mask
    trial: int = 0
    bin: Whole | None = None
    adrift: Array | None = None
    inertia_n: float = 0.0


def _pieces(trial: Trial, signal: Signal, marks: Array, data: DataSet) -> list[tuple[str, _Piece]]:
    made: list[tuple[str, _Piece]] = []
    if "pressure_kpa" in trial and not signal.regulated and signal.has_length:
        made.append(("pressure", _chamber(trial, signal, marks, data)))
    if "force_n" in trial and "pressure_kpa" in trial and signal.has_length:
        piece = _piece(trial, signal, trial["force_n"], 1.0, data)
        piece.floor = np.hypot(piece.floor, _rough_error(data))
        made.append(("force", _kept(piece, _in_domain(piece, data))))
    if signal.loaded and "length_mm" in trial and ("pressure_kpa" in trial or "force_n" in trial):
        piece = _piece(trial, signal, trial["length_mm"], 1e-3, data)
        # A load without a force reading is compared with the force of the muscle model.
        force = trial.get("force_n")
        piece.reading = (
            _at(force, piece.time_s) if len(force) else np.full_like(piece.time_s, np.nan)
        )
        piece.mass = trial.load_kg
        piece.floor = np.hypot(piece.floor, _rough_error(data))
        piece.inertia_n = trial.load_kg * signal.bend_noise_m_s2
        piece.doubt = piece.doubt + trial.load_kg * signal.acceleration_doubt_at(piece.time_s)
        # What the load's inertia makes of a swing is what the muscle's stiffness makes of it.
        piece.doubt = piece.doubt + _stiffness(signal, piece.time_s, data) * _hidden_swing(
            signal, piece.time_s, data
        )
        free = signal.free_of_stops(piece.time_s) & _in_domain(piece, data)
        if free.sum() >= 3 or trial.settled:
            made.append(("load", _kept(piece, free)))
    # A length that never moves, not even by noise, is a label copied into a column.
    if signal.held and "length_mm" in trial and np.ptp(trial["length_mm"].value) > 0.0:
        piece = _piece(trial, signal, trial["length_mm"], 1e-3, data)
        piece.floor = np.zeros(len(piece.time_s))
        made.append(("camera", piece))
    return [(block, piece) for block, piece in made if len(piece.time_s)]


def _in_domain(piece: _Piece, data: DataSet) -> Mask:
    """Points at which a simulator's force law holds."""
    return compared(data.simulator, piece.pressure * 1e-3, piece.length * 1e3)


def _rough_error(data: DataSet) -> float:
    """What the error of a simulator's form, in N, has that is too fine for `nominal.ModelError`."""
    simulator = data.simulator
    if simulator is None:
        return 0.0
    return float(np.hypot(_ROUGH_SHARE * simulator.model_error_n, rough_error_n(simulator)))


_ROUGH_SHARE = 0.05
"""Share of the error of a law's form that is not smooth. Set on: two muscles of another generator
with fitted laws and nothing hidden, with 1 and 4 N of error beside floors of 0.4 and 0.8 N."""
_FOLLOWED = 0.4
"""Share of the frame rate up to which frames follow a swing."""


_OF_ROWS = ("doubt", "floor", "unfollowed")
"""What rows hold and points need not."""
_UNFOLLOWED_M = 0.03e-3
"""Swing that frames cannot follow from which it is more than their scatter."""
_UNFOLLOWED_SHARE = 0.5
"""Share of the samples of a point that must show it."""


def _kept(piece: _Piece, keep: npt.NDArray[np.bool_]) -> _Piece:
    for name in _ARRAYS:
        setattr(piece, name, getattr(piece, name)[keep])
    return piece


_ARRAYS = (
    "time_s", "weight", "pressure", "pressure_slope", "path", "length", "rate", "rate_sd",
    "acceleration", "temperature", "reading", "direction", "taken", "doubt", "floor", "clipped",
    "unfollowed",
)  # fmt: skip


def _at(channel: Channel, time_s: Array) -> Array:
    return np.interp(time_s, channel.time_s, channel.value)


def _piece(trial: Trial, signal: Signal, output: Channel, scale: float, data: DataSet) -> _Piece:
    """Points at the samples of `output`, neighbours averaged where there are very many."""
    time_s = output.time_s
    inside = signal.covered(time_s)
    time_s = time_s[inside]
    columns = [
        time_s,
        signal.pressure_at(time_s),
        signal.pressure_slope_at(time_s),
        signal.path_at(time_s),
        signal.length_at(time_s),
        signal.rate_at(time_s),
        signal.rate_sd_at(time_s),
        signal.acceleration_at(time_s),
        signal.temperature_at(time_s),
        output.value[inside] * scale,
        signal.direction_at(time_s),
        signal.taken_at(time_s),
        _stiffness(signal, time_s, data)
        * (signal.length_doubt_at(time_s) + _hidden_swing(signal, time_s, data)),
        _FORCE_FLOOR_N
        + _stiffness(signal, time_s, data) * _sync(signal)
        + _force_of_clipped(signal, time_s, data),
        signal.clipped_at(time_s),
        np.where(_hidden_swing(signal, time_s, data) > _UNFOLLOWED_M, 1.0, 0.0),
    ]
    block = 1 if trial.settled else -(-len(time_s) // MOST_POINTS)
    weight = np.full(len(time_s), 1.0)
    if block > 1:
        starts = np.arange(0, len(time_s), block)
        count = np.diff(np.r_[starts, len(time_s)]).astype(np.float64)
        columns = [np.add.reduceat(column, starts) / count for column in columns]
        weight = count
    (
        t, p, slope, path, length, rate, rate_sd, acceleration, temperature, reading, direction,
        taken, doubt, floor, clipped, unfollowed,
    ) = columns  # fmt: skip
    return _Piece(
        t, weight, p, slope, path, length, rate, rate_sd, acceleration, signal.held, temperature,
        np.nan, reading, direction, taken, np.empty(0), trial.settled, doubt, floor,
        clipped > _CLIPPED_SHARE, unfollowed > _UNFOLLOWED_SHARE,
    )  # fmt: skip


def _hidden_swing(signal: Signal, time_s: Array, data: DataSet) -> Array:
    """Swing in m of a hung load where frames are too few to follow it, else zero.

    A load bounces on its muscle at its own frequency; frames slower than twice that show it at a
    wrong one, and what they show between them means nothing.
    """
    if not signal.loaded or signal.trial.settled:
        return np.zeros(len(time_s))
    own_hz = np.sqrt(_stiffness(signal, time_s, data) / signal.trial.load_kg) / (2.0 * np.pi)
    hidden = own_hz > _FOLLOWED * signal.frame_rate_hz
    return np.where(hidden, signal.swing_at(time_s), 0.0)


def _sync(signal: Signal) -> float:
    """Least error in m of a moving length between frames."""
    return 0.0 if signal.held or signal.trial.settled else _LENGTH_FLOOR_M


def _force_of_clipped(signal: Signal, time_s: Array, data: DataSet) -> Array:
    """Error in N of the force where the pressure that makes it is clipped, else zero."""
    if not signal.clipped.any():
        return np.zeros(len(time_s))
    share = signal.clipped_at(time_s)
    length, c, law = signal.length_at(time_s), data.constants, nominal_law(data)
    beyond = np.full(len(time_s), 1e3 * CLIPPED_INPUT_KPA)
    force = braid_force(beyond, length, c.braid_length_m, c.turns)
    if law is not None:
        force = law(beyond, length) - law(np.zeros(len(time_s)), length)
    return np.where(share > _CLIPPED_SHARE, np.abs(np.nan_to_num(force)), 0.0)


def _stiffness(signal: Signal, time_s: Array, data: DataSet) -> Array:
    """Force per length at constant pressure, N/m."""
    pressure, length = signal.pressure_at(time_s), signal.length_at(time_s)
    law = nominal_law(data)
    if law is None:
        slope = braid_force_slope(pressure, length, data.constants.turns)
    else:
        slope = (law(pressure, length + _SLOPE_M) - law(pressure, length - _SLOPE_M)) / (
            2.0 * _SLOPE_M
        )
    return np.abs(np.nan_to_num(slope))


def _chamber(trial: Trial, signal: Signal, marks: Array, data: DataSet) -> _Piece:
    """Nodes of the pressure stage: dense while valves act, means over 20 ms elsewhere."""
    channel = trial["pressure_kpa"]
    time_s = channel.time_s
    spacing = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    dense = np.zeros(len(time_s), dtype=bool)
    for mark in marks:
        a, b = np.searchsorted(time_s, [mark - 0.005, mark + 0.4])
        dense[a:b] = True
    dense |= smooth_slope(channel, 0.01) > 300.0
    block = max(1, round(QUIET_S / spacing))
    starts: list[int] = []
    i = 0
    while i < len(time_s):
        starts.append(i)
        j = i + 1
        if not dense[i]:
            while j < len(time_s) and j - i < block and not dense[j]:
                if time_s[j] - time_s[j - 1] > 3.0 * spacing:
                    break
                j += 1
        i = j
    first = np.array(starts, dtype=np.int64)
    count = np.diff(np.r_[first, len(time_s)]).astype(np.float64)
    t = np.add.reduceat(time_s, first) / count
    p = np.add.reduceat(channel.value, first) / count * 1e3
    supply = trial.get("supply_kpa")
    feed = (
        _at(supply, t) * 1e3 if len(supply) else np.full(len(t), data.constants.supply_pa)
    )  # fmt: skip
    zero = np.zeros(len(t))
    length = signal.length_at(t)
    c = data.constants
    volume = braid_volume(length, c.braid_length_m, c.turns) + c.dead_volume_m3
    squeeze = braid_volume_slope(length, c.braid_length_m, c.turns) / volume
    share = np.abs(squeeze) * signal.length_doubt_at(t)
    kpa = (p + c.atmosphere_pa) * 1e-3
    adrift = unknown_gas(share, volume * kpa, passing(trial, t)) * kpa
    doubt = np.hypot(share * kpa, _SHAPE * adrift)
    floor = 0.02 + np.minimum(np.abs(np.gradient(p, t)), 1e7) * _EDGE_FLOOR_S * 1e-3
    clipped = np.add.reduceat(signal.clipped.astype(np.float64), first) / count
    floor = np.where(clipped > _CLIPPED_SHARE, CLIPPED_KPA, floor)
    return _Piece(
        t, count, p, zero, p, length, signal.rate_at(t), signal.rate_sd_at(t),
        signal.acceleration_at(t), signal.held, signal.temperature_at(t), np.nan, p, zero,
        np.full(len(t), np.nan), feed, False, doubt, floor, clipped > _CLIPPED_SHARE,
        np.zeros(len(t), dtype=bool), adrift=adrift,
    )  # fmt: skip


_CLIPPED_SHARE = 0.05
"""Share of readings at the end of the instrument's range from which a mean counts for nothing."""
_SHAPE = 0.3
"""Part of the doubt about unseen gas that need not be the same throughout a trial."""
FIRST_SETTLED = 500_000
"""Number of the first bin of settled points, beyond all bins in time."""
_MOST = {"pressure": 320, "force": 240, "load": 160, "camera": 12}


def _assign(
    piece: _Piece, block: str, trial: Trial, marks: Array, ends: dict[tuple[str, str], Array],
    alike: Array,
) -> None:  # fmt: skip
    """Give every point of a piece its bin; replicates share the bins of their slot.

    Settled points share a bin where their conditions differ by less than `alike`: in Pa, m and
    direction. The length of a hung load is no condition: at one pressure it is what comes out.
    """
    t = piece.time_s
    key = (trial.slot, block)
    if piece.settled:  # a slot may have trials with a time axis beside: those are no replicates
        at = piece.length if block != "load" else np.zeros_like(piece.length)
        condition = np.stack([piece.pressure, at, piece.direction], axis=1)
        known = ends.get((trial.slot, f"{block} settled"), np.empty((0, 3)))
        found, known = bins.matched(condition, known, alike)
        ends[trial.slot, f"{block} settled"] = known
        piece.bin = found + FIRST_SETTLED
        return
    turns = np.empty(0)
    swing = piece.length if moves(piece.length * 1e3) else piece.pressure
    if block in ("force", "load"):
        turns = bins.turning_points(t, swing, 0.1 * float(np.ptp(swing)) + 1e-9)
        if len(turns) > _MOST[block] / 4:
            piece.bin = bins.fold(t, swing, turns, 8)
            return
    if key not in ends:
        spacing = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
        if block == "pressure":
            spacing = min(spacing, 0.002)
        ends[key] = bins.bin_ends(
            float(t[0]), float(t[-1]), spacing, marks if block != "camera" else np.empty(0),
            turns, _MOST[block],
        )  # fmt: skip
        ends[trial.slot, f"{block} course"] = np.r_[t[0], turns, t[-1]]
        piece.bin = np.searchsorted(ends[key], t, side="right")
        ends[trial.slot, f"{block} swing"] = bins.means(piece.bin, swing, len(ends[key]) + 1)
        return
    course, first = (ends[trial.slot, f"{block} {name}"] for name in ("course", "swing"))
    piece.bin = bins.in_step(t, swing, turns, ends[key], course, first)


def _joined(pieces: list[_Piece], number: int, mountings: Whole) -> tuple[Points, Rows]:
    """All pieces of a block as one set of points, with its rows."""
    columns: dict[str, list[Any]] = {name: [] for name in _ARRAYS if name not in _OF_ROWS}
    blind = all(piece.unfollowed.all() for piece in pieces)
    row: list[Whole] = []
    sizes = np.zeros(len(mountings), dtype=np.int64)
    held: list[Array] = []
    settled: list[Array] = []
    mass: list[Array] = []
    made: list[Rows] = []
    count = 0
    for piece in pieces:
        assert piece.bin is not None
        found, inverse = np.unique(piece.bin, return_inverse=True)
        n = len(piece.time_s)
        sizes[piece.trial] = n
        for name in columns:
            columns[name].append(getattr(piece, name))
        row.append(inverse.astype(np.int64) + count)
        held.append(np.full(n, piece.held))
        settled.append(np.full(n, piece.settled))
        mass.append(np.full(n, piece.mass))
        samples = np.asarray(np.bincount(inverse, weights=piece.weight), dtype=np.float64)

        mean = Mean(inverse, piece.weight, samples)
        whole_s, followed_s = _spans(piece, inverse, len(found))
        made.append(
            Rows(
                block=np.full(len(found), number),
                trial=np.full(len(found), piece.trial),
                time_s=mean(piece.time_s),
                samples=samples,
                span_s=whole_s,
                compared_s=whole_s if blind else followed_s,
                bin=found,
                pressure=mean(piece.pressure),
                length=mean(piece.length),
                rate=mean(piece.rate),
                doubt=mean(piece.doubt),
                adrift=np.zeros(len(found)) if piece.adrift is None else mean(piece.adrift),
                floor=np.hypot(mean(piece.floor), piece.inertia_n * _bends(piece, inverse)),
            )
        )
        count += len(found)
    joined = {name: np.ascontiguousarray(np.concatenate(parts)) for name, parts in columns.items()}
    points = Points(
        first=np.r_[0, np.cumsum(sizes)].astype(np.int64),
        trial=np.repeat(np.arange(len(mountings)), sizes),
        mounting=np.repeat(mountings, sizes),
        row=np.concatenate(row),
        held=np.concatenate(held).astype(bool),
        settled=np.concatenate(settled).astype(bool),
        mass=np.concatenate(mass),
        **joined,
    )
    return points, stacked(made)


def _bends(piece: _Piece, inverse: Whole) -> Array:
    """What noise of one sd in every frame makes of the mean second difference of each row.

    Those of neighbours share frames: of a whole stretch its ends alone are left.
    """
    t = piece.time_s
    count = int(inverse.max(initial=-1)) + 1
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    total = 6.0 * np.bincount(inverse, minlength=count)
    for apart, product in ((1, -4.0), (2, 1.0)):
        near = (inverse[apart:] == inverse[:-apart]) & (
            t[apart:] - t[:-apart] < (apart + 0.5) * step
        )
        total = total + 2.0 * product * np.bincount(inverse[apart:][near], minlength=count)
    frames = np.bincount(inverse, weights=piece.weight, minlength=count)
    return np.asarray(np.sqrt(np.maximum(total, 0.0)) / frames)


def _spans(piece: _Piece, inverse: Whole, count: int) -> tuple[Array, Array]:
    """Seconds of the trial that each row stands for, and the same where frames followed all of it.

    Settled points stand for one each.
    """
    t = piece.time_s
    step = np.abs(np.gradient(t)) if len(t) > 1 else np.ones(1)
    if piece.settled:
        step = 1.0 / np.bincount(inverse, minlength=count)[inverse]
    span = np.asarray(np.bincount(inverse, weights=step, minlength=count), dtype=np.float64)
    lost = np.bincount(inverse, weights=piece.unfollowed, minlength=count)
    return span, np.asarray(np.where(lost > 0.0, 0.0, span))
