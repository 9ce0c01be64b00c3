"""Streams of the simulated sensors except pressure, and of the true state.

``balance`` (and ``force-NAME`` for each further muscle) has the force readings of a load cell.
``place`` has the readings of length, height or joint angles (noise, step, delay). ``edges`` has
every valve edge with its time, ``truth`` the true state at every tick.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from daq.record.writer import RecordWriter
from plant.physics import layout as at
from plant.scene import layout as sc
from plant.scene.scene import Scene
from rigs.devices.instruments.balance import BALANCE_SCHEMA, BALANCE_UNITS
from studies.simulation.scenario import Scenario

TRUTH_BATCH = 200
SMALL_BATCH = 20
GRAMS_PER_N = 1000.0 / 9.80665


class _Rows:
    """Buffered rows of a stream."""

    def __init__(
        self,
        record: RecordWriter,
        name: str,
        schema: dict[str, str],
        units: dict[str, str],
        batch: int,
    ) -> None:
        record.stream(name, schema, units)
        self._record = record
        self._name = name
        self._schema = schema
        self._batch = batch
        self._held: list[tuple[float, ...]] = []
        self.count = 0

    def add(self, host_ns: int, *values: float) -> None:
        self._held.append((self.count, host_ns, *values))
        self.count += 1
        if len(self._held) >= self._batch:
            self.flush()

    def flush(self) -> None:
        if not self._held:
            return
        columns = zip(*self._held, strict=True)
        self._record.append(
            self._name,
            {
                key: np.array(values, dtype=kind)
                for (key, kind), values in zip(self._schema.items(), columns, strict=True)
            },
        )
        self._held = []


class Readings:
    """Sensor readings and true state of one simulation; call `take` at every tick."""

    def __init__(self, scenario: Scenario, scene: Scene, record: RecordWriter) -> None:
        self._scene = scene
        self._record = record
        self._s = scenario.sensors
        self._rng = np.random.default_rng([scenario.seed, 1000])
        self._scale = scenario.mechanism.scale
        unit = scenario.mechanism.unit
        muscles = [m.name for m in scenario.muscles]
        names = list(scenario.mechanism.names)
        head = {"row": "int64", "host_ns": "int64"}
        self._forces = [
            _Rows(record, "balance" if k == 0 else f"force-{name}", BALANCE_SCHEMA, BALANCE_UNITS,
                  SMALL_BATCH)
            for k, name in enumerate(muscles)
        ]  # fmt: skip
        # If nothing moves, the position is the held length of the muscle.
        self._held = not names
        places = [f"{name}_{unit}" for name in names] or ["length_mm"]
        schema = {**head, **dict.fromkeys(places, "float64")}
        units = {"host_ns": "ns", **dict.fromkeys(places, unit)}
        self._places = _Rows(record, "place", schema, units, SMALL_BATCH)
        truth: dict[str, str] = {}
        for name in muscles:
            truth |= {
                f"{name}_pressure_kpa": "kPa",
                f"{name}_length_mm": "mm",
                f"{name}_force_n": "N",
                f"{name}_inlet_open": "",
                f"{name}_outlet_open": "",
            }
        for name in names:
            truth |= {f"{name}_{unit}": unit, f"{name}_{unit}_s": f"{unit}/s"}
        schema = {**head, **dict.fromkeys(truth, "float64")}
        self._truth = _Rows(
            record, "truth", schema, {"host_ns": "ns"} | {k: u for k, u in truth.items() if u},
            TRUTH_BATCH,
        )  # fmt: skip
        self._edges = _Rows(
            record, "edges", {**head, "muscle": "int64", "solenoid": "uint8", "open": "uint8"},
            {"host_ns": "ns"}, SMALL_BATCH,
        )  # fmt: skip
        self._muscles = {name: k for k, name in enumerate(muscles)}
        self._late: deque[tuple[float, np.ndarray]] = deque()
        self._next_force_s = 0.0
        self._next_place_s = 0.0

    def rows(self) -> dict[str, list[int]]:
        """Row numbers of the next readings, by stream."""
        self.flush()
        return {
            "valve": [self._record.rows("valve")],
            "balance": [self._forces[0].count],
            "place": [self._places.count],
        }

    def flush(self) -> None:
        """Write all buffered rows to the record."""
        for rows in (*self._forces, self._places, self._truth, self._edges):
            rows.flush()

    def take(self, ticks: int) -> None:
        """Store the true state and the readings that are due at a tick."""
        scene, host_ns = self._scene, ticks * 1_000_000
        now = ticks * 1e-3
        u = scene.world.units
        truth: list[float] = []
        for k in range(len(scene.units)):
            state = u[k]
            truth += [state[at.PRESSURE] * 1e-3, state[at.LENGTH] * 1e3, state[at.FORCE]]
            truth += [state[at.INLET_OPEN], state[at.OUTLET_OPEN]]
        places = scene.world.motion[sc.PLACE] / self._scale
        rates = scene.world.motion[sc.RATE] / self._scale
        for place, rate in zip(places, rates, strict=True):
            truth += [place, rate]
        self._truth.add(host_ns, *truth)
        if now >= self._next_force_s - 1e-9:
            self._next_force_s += 1.0 / self._s.force_rate_hz
            step = self._s.force_step_n
            for k, rows in enumerate(self._forces):
                read = float(u[k, at.FORCE]) + self._s.force_noise_n * float(
                    self._rng.standard_normal()
                )
                rows.add(host_ns, round(read / step) * step * GRAMS_PER_N, 1)
        seen = np.array([u[0, at.LENGTH] * 1e3]) if self._held else places
        self._late.append((now, seen))
        while len(self._late) > 1 and self._late[1][0] <= now - self._s.place_delay_s + 1e-9:
            self._late.popleft()
        if now >= self._next_place_s - 1e-9:
            self._next_place_s += 1.0 / self._s.place_rate_hz
            noise = self._s.place_noise * self._rng.standard_normal(len(seen))
            read_at = np.round((self._late[0][1] + noise) / self._s.place_step)
            self._places.add(host_ns, *(read_at * self._s.place_step))
        self._log_events()

    def _log_events(self) -> None:
        """Store valve edges in their stream; stops and switches as events with their time."""
        if not self._scene.world.clock[sc.LOGGED]:
            return
        for event in self._scene.take_events():
            if event.kind in ("inlet", "outlet"):
                self._edges.add(
                    round(event.time_s * 1e9),
                    self._muscles[event.which],
                    1 if event.kind == "outlet" else 0,
                    int(event.value),
                )
            elif event.kind in ("switch", "low stop", "high stop"):
                self._record.event(
                    "switch" if event.kind == "switch" else "stop",
                    time_s=event.time_s,
                    what=event.kind,
                    which=event.which,
                    value=event.value,
                )
