"""A virtual bench that hides an effect: physics of the blind package, drawn from the OS's entropy.

Whoever tests it sees instruments on ports like any others, and the salted SHA-256 of the answer.
The answer leaves this process only on request (`Envelope.reveal`, `request_answer`).
"""

from __future__ import annotations

import base64
import contextlib
import json
import socket
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind.live import LiveBench, Secret, draw_secret
from blind.physics.readings import frame_delay_s, read_force
from blind.seal import opened
from daq.clock import VirtualClock
from daq.errors import ConfigError, PamrigError
from plant import tomlfile
from plant.constants import nominal
from plant.errors import PlantError
from plant.simulator.bench import BenchSim
from rigs.rigfile.config import RigConfig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.board.board import Advance
from rigs.virtual.board.solenoids import Solenoids
from rigs.virtual.emulators.sensor_error import SensorError
from rigs.virtual.withheld.plant import WithheldPlant, WithheldReading

NOTE = "withheld.json"
"""In the bench's folder: the seal, and where to ask while the bench runs."""
ENVELOPE = "withheld.sealed"
"""Left there when a bench ends without a request; coded, so that nobody reads it by accident."""
LARGEST = 16 << 20
"""Bytes of a note, packed or not."""
_STATED = (
    "supply_kpa", "atmosphere_kpa", "gas_temperature_k", "braid_length_mm", "turns",
    "inlet_conductance_m3_s_pa", "outlet_conductance_m3_s_pa", "critical_ratio",
    "dead_volume_ml", "polytropic_exponent", "length_min_mm", "length_max_mm",
    "stop_stiffness_n_mm", "stop_damping_n_s_mm", "load_damping_n_s_mm", "inlet_on_ms",
    "inlet_on_ms_per_kpa", "inlet_off_ms", "inlet_off_ms_per_kpa", "outlet_on_ms",
    "outlet_on_ms_per_kpa", "outlet_off_ms", "outlet_off_ms_per_kpa",
)  # fmt: skip


def draw(
    config: RigConfig,
    effects: Sequence[str] = (),
    entropy: int | None = None,
    held_out: bool = False,
) -> Secret:
    """A secret for this rig's muscle and valves; `entropy` None takes the operating system's.

    `held_out` draws a form that is held out, for a campaign alone.

    Raises:
        ConfigError: the rig has no virtual bench, or states an effect of its own.
    """
    if config.virtual is None:
        raise ConfigError(config.source, "has no [virtual] table, so it cannot be simulated")
    if config.virtual.effects:
        raise ConfigError(
            config.source, "states effects of its own", "a withheld bench draws its effect itself"
        )
    keys = {k: float(v) for k, v in config.virtual.plant.items() if k in _STATED}
    return draw_secret(entropy=entropy, keys=keys, effects=list(effects) or None, held_out=held_out)


class WithheldBench(VirtualBench):
    """A virtual bench on hidden physics; see :class:`rigs.virtual.bench.VirtualBench`.

    Args:
        config: a rig with a [virtual] table and no effects.
        secret: what it hides.
        clock, origin_ns: as for any virtual bench.
    """

    def __init__(
        self,
        config: RigConfig,
        secret: Secret,
        clock: VirtualClock | None = None,
        origin_ns: int = 0,
    ) -> None:
        self.live = LiveBench(secret=secret)
        self.digest, self._envelope = self.live.sealed()
        super().__init__(config, clock, origin_ns)

    def reveal(self) -> dict[str, Any]:
        """The envelope: answer and salt."""
        return self._envelope

    def _make_plant(self) -> BenchSim:
        try:
            constants = nominal().with_overrides(self._v.plant)
        except PlantError as error:
            raise ConfigError(f"{self.config.source}: virtual.plant", str(error)) from None
        limits = self.config.limits
        live = self.live
        nothing = np.zeros(1)
        return WithheldPlant(
            live,
            constants,
            self._v.source,
            (limits.length_min_mm + limits.length_max_mm) / 2 * 1e-3,
            zero_n=float(read_force(nothing, nothing, live.trial, live.effects)[0]),
            frames_late_s=float(frame_delay_s(nothing, live.effects)[0]),
        )

    def _make_sensor_error(self) -> SensorError:
        assert isinstance(self.plant, WithheldPlant)
        return WithheldReading(self.plant)

    def _make_step(self) -> Advance | None:
        assert isinstance(self.plant, WithheldPlant)
        if "supply" not in self.extras.devices:
            return self.plant.step
        return Solenoids(self.plant.constants, self.extras.solenoid_volts, self.plant.step).advance


class Envelope:
    """Keeps a bench's answer beside the running bench, and hands it out on request.

    Args:
        folder: the bench's folder, where the note goes.
        digest: the seal.
        envelope: answer and salt.
        bench: constants that may be known, for the note.
    """

    def __init__(
        self, folder: Path, digest: str, envelope: dict[str, Any], bench: dict[str, Any]
    ) -> None:
        self._folder = folder
        self._envelope = envelope
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        (folder / ENVELOPE).unlink(missing_ok=True)
        note = {"sha256": digest, "ask": self._server.getsockname()[1], "bench": bench}
        (folder / NOTE).write_text(json.dumps(note, indent=2) + "\n", encoding="utf-8")

    def step(self) -> None:
        """Answer whoever asks."""
        with contextlib.suppress(BlockingIOError, OSError):
            client, _ = self._server.accept()
            with client:
                client.settimeout(1.0)
                client.sendall(json.dumps(self._envelope).encode() + b"\n")

    def close(self) -> None:
        """The bench ends: leave the envelope, coded, for a later reveal."""
        self._server.close()
        coded = base64.b85encode(zlib.compress(json.dumps(self._envelope).encode()))
        (self._folder / ENVELOPE).write_bytes(coded + b"\n")


def request_answer(folder: Path) -> dict[str, Any]:
    """The answer of the withheld bench in `folder`, checked against the seal it began with.

    Raises:
        PamrigError: there is none, it cannot be asked, or the answer does not match its seal.
    """
    try:
        note = json.loads((folder / NOTE).read_text(encoding="utf-8"))
        digest, port = str(note["sha256"]), int(note["ask"])
    except (OSError, ValueError, KeyError, TypeError):
        raise PamrigError(
            str(folder), "holds no withheld bench", "start one with pamrig virtual --withheld"
        ) from None
    try:
        answer: dict[str, Any] = opened(_envelope(folder, port), digest)
    except (ValueError, KeyError, TypeError) as error:
        raise PamrigError(str(folder), f"cannot be revealed: {error}") from None
    return answer


def _unpacked(packed: bytes) -> bytes:
    """The packed note, if it is no larger than one can be: a few bytes can stand for gigabytes."""
    unpacking = zlib.decompressobj()
    data = unpacking.decompress(packed, LARGEST)
    if not unpacking.eof:
        raise ValueError("its file is incomplete or too large")
    return data


def _envelope(folder: Path, port: int) -> dict[str, Any]:
    left = folder / ENVELOPE
    try:
        if left.is_file():
            data = _unpacked(base64.b85decode(tomlfile.read_bytes(left, LARGEST).strip()))
        else:
            with socket.create_connection(("127.0.0.1", port), timeout=5.0) as client:
                data = b"".join(iter(lambda: client.recv(65536), b""))
        envelope = json.loads(data)
    except (OSError, ValueError, RecursionError, zlib.error) as error:
        raise PamrigError(
            str(folder), f"its bench does not answer ({error})", "is it still running?"
        ) from None
    if not isinstance(envelope, dict):
        raise PamrigError(str(folder), "its bench gives another answer")
    return envelope
