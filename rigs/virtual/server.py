"""`pamrig virtual`: the bench in real time, on pseudo-terminals or TCP, for any client.

The bench runs in one loop that wakes each millisecond; the camera answers from a thread of
its own. Where there is no pseudo-terminal (Windows) each port is a loopback TCP socket,
which pyserial opens as ``socket://127.0.0.1:PORT``.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
import time
import tomllib
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from daq.clock import VirtualClock
from daq.errors import ConfigError, PamrigError
from daq.interrupt import stop_on_signals
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.byte_ports import LOOPBACK, Port, PtyPort, TcpPort
from rigs.virtual.card_port import CardPort
from rigs.virtual.operator_port import OperatorPort

TICK_NS = 1_000_000
STRETCH_NS = 20_000_000
"""Time that was missed is made good in stretches of at most this."""
TRUTH_NS = 10_000_000
LATENESS_KEPT = 2_000_000
BENCH_FILE = "bench.toml"
"""Beside the clients' rig file: what is known of the bench's plant, for whoever diagnoses it."""


class CameraPort:
    """Frames on request over loopback TCP; the protocol is in ``rigs.devices.camera.TcpCamera``."""

    def __init__(self, bench: VirtualBench, serial: str) -> None:
        self._bench = bench
        self._serial = serial
        self._server = socket.create_server((LOOPBACK, 0))
        self.address = f"tcp://{LOOPBACK}:{self._server.getsockname()[1]}"
        threading.Thread(target=self._serve, name="camera", daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            with client, client.makefile("rwb") as file, contextlib.suppress(OSError):
                self._talk(file)

    def _talk(self, file: Any) -> None:
        while request := file.readline(100):
            if request.strip() == b"I":
                file.write(f"ID {self._serial}\n".encode())
            elif request.strip() == b"T":
                seq, host_ns, gray = self._bench.expose()
                height, width = gray.shape
                file.write(f"FRAME {seq} {host_ns} {width} {height}\n".encode())
                file.write(gray.tobytes())
            file.flush()

    def close(self) -> None:
        """Refuse further clients."""
        self._server.close()


class BenchServer:
    """A virtual bench on ports, advanced in real time by :meth:`run`.

    Args:
        config: a rig with a [virtual] table.
        folder: where port names and the clients' rig file appear.
        tcp: TCP instead of pseudo-terminals.
        truth: file for the true state, or None.
        make: makes the bench of rig and host time at power-on.
    """

    def __init__(
        self,
        config: RigConfig,
        folder: Path,
        tcp: bool = False,
        truth: Path | None = None,
        make: Callable[[RigConfig, int], VirtualBench] | None = None,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.config = config
        self.lateness_ns = array("q")  # a list takes five times as much
        self._truth = truth.open("w", encoding="utf-8", buffering=1) if truth else None
        self._next_truth_ns = 0
        self._vent_seen_us = -1
        self._heartbeat_ns = 0
        self._start_ns = time.monotonic_ns()
        self.bench = (make or _plain)(config, self._start_ns)
        self.bench.board.forget_truth()  # it would grow for as long as the bench is up
        use_tcp = tcp or not hasattr(os, "openpty")
        self.ports: dict[str, Port] = {}
        card = self.bench.extras.card
        self.card = CardPort(card) if card is not None else None
        for name in self.bench.devices:
            if name == "card":
                continue
            port: Port = TcpPort() if use_tcp else PtyPort(folder / name)
            self.ports[name] = port
            self.bench.send[name] = lambda _, data, port=port: port.write(data)  # type: ignore[misc]
        self.camera = CameraPort(self.bench, config.camera.serial)
        self.person = OperatorPort(self.bench)
        self.rig_file = folder / "rig.toml"
        self.rig_file.write_text(self._client_rig(), encoding="utf-8")
        stated = config.virtual.plant if config.virtual is not None else {}
        (folder / BENCH_FILE).write_text(
            "".join(f"{key} = {json.dumps(value)}\n" for key, value in stated.items()),
            encoding="utf-8",
        )

    def _client_rig(self) -> str:
        """The rig file with real addresses in place of "virtual", text otherwise as it was."""
        out, table = [], ""
        for line in self.config.text.splitlines():
            word = line.strip()
            if word.startswith("["):
                table = word.strip("[]").split("#")[0].strip("[] ")
            if table.startswith(("virtual", "effects", "operator")):
                continue
            key = word.split("=")[0].strip()
            device = table.removeprefix("instruments.")
            if key == "port" and device == "card" and self.card is not None:
                line = f"port = {json.dumps(self.card.address)}"
            elif key == "port" and device in self.ports:
                line = f"port = {json.dumps(self.ports[device].address)}"
            elif key in ("calibration", "form", "dynamics", "marks"):
                line = self._from_here(key, word)
            elif key == "source" and table == "camera":
                line = f"source = {json.dumps(self.camera.address)}"
            out.append(line)
        out += ["", "[operator]", f"port = {json.dumps(self.person.address)}"]
        text = "\n".join(out) + "\n"
        tomllib.loads(text)
        return text

    def _from_here(self, key: str, line: str) -> str:
        """A file that stands beside the rig file is named so that the client finds it."""
        beside = Path(self.config.source).parent / str(tomllib.loads(line)[key])
        return f"{key} = {json.dumps(str(beside.resolve()))}" if beside.is_file() else line

    def step(self) -> None:
        """Bring the bench to now and move bytes.

        A board of its own never stands still, this process may. What the host said meanwhile is
        then heard over the time that is made good, not all in one instant: or a host that beat
        in time would count as silent, and the muscle would be vented under it.
        """
        now_ns = time.monotonic_ns()
        frames: dict[str, list[bytes]] = {}
        for name, port in self.ports.items():
            data = port.read()
            if not data:
                continue
            if name in self.bench.boards:
                frames[name] = [frame + b"\0" for frame in data.split(b"\0")]
                frames[name][-1] = frames[name][-1][:-1]  # what follows the last delimiter
            else:
                self.bench.feed(name, data)
        self.person.step()
        if self.card is not None:
            self.card.step()
        before = self.bench.board.bench_us
        begin_ns = self.bench.host_ns(before * 1000)
        stretches = max(1, -(-(now_ns - begin_ns) // STRETCH_NS))
        for k in range(stretches):
            for name, heard in frames.items():
                at, end = (len(heard) * j // stretches for j in (k, k + 1))
                self._hear(name, b"".join(heard[at:end]))
            self.bench.advance_to(begin_ns + (now_ns - begin_ns) * (k + 1) // stretches)
            if self._truth is not None:
                self._tell_truth(self.bench.host_ns(self.bench.board.bench_us * 1000))
            if k + 1 < stretches:
                self.rest()  # whoever reads the port has to keep up
        self._note_lateness(now_ns, before)

    def _hear(self, name: str, data: bytes) -> None:
        """Bytes for a valve controller."""
        if name == "valve" and b" hb " in data:
            # The firmware reads it at its next tick: bench time, as its deadline is.
            self._heartbeat_ns = self.bench.host_ns(self.bench.board.bench_us * 1000)
        if data:
            self.bench.feed(name, data)

    def _note_lateness(self, now_ns: int, before_us: int) -> None:
        """How late the ticks since ``before_us`` were carried out."""
        ticks = self.bench.board.bench_us // 1000 - before_us // 1000
        if ticks and len(self.lateness_ns) < LATENESS_KEPT:
            due = self.bench.host_ns(before_us * 1000) + TICK_NS
            self.lateness_ns.append(max(0, now_ns - due))
            self.lateness_ns.extend(
                max(0, now_ns - due - k * TICK_NS) for k in range(1, min(ticks, 1000))
            )

    def _tell_truth(self, now_ns: int) -> None:
        board = self.bench.board
        changed = board.vent_commanded_us != self._vent_seen_us
        if now_ns < self._next_truth_ns and not changed:
            return
        self._next_truth_ns = now_ns + TRUTH_NS
        self._vent_seen_us = board.vent_commanded_us
        line = {
            "t_ns": now_ns,
            "pressure_kpa": round(board.pressure_kpa, 3),
            "length_mm": round(self.bench.plant.length_mm, 4),
            "vent_commanded_ns": self.bench.host_ns(board.vent_commanded_us * 1000),
            "last_heartbeat_ns": self._heartbeat_ns,
            "armed": bool(board.controller.safety.armed),
            "faults": [str(f) for f in board.controller.safety.faults],
        }
        if (second := self.bench.boards.get("valve_b")) is not None:
            line["pressure_b_kpa"] = round(second.pressure_kpa, 3)
            line["armed_b"] = bool(second.controller.safety.armed)
        assert self._truth is not None
        self._truth.write(json.dumps(line) + "\n")

    def rest(self) -> None:
        """Leave the processor to others until the next tick is about due."""
        time.sleep(0.0008)

    def lateness_ms(self) -> dict[str, float]:
        """Lateness of the 1 kHz loop so far: median, p99.9 and worst, in ms."""
        late = np.array(self.lateness_ns or [0], dtype=np.float64) / 1e6
        return {
            "p50": float(np.median(late)),
            "p99.9": float(np.percentile(late, 99.9)),
            "worst": float(late.max()),
        }

    def close(self) -> None:
        """Close every port."""
        for port in self.ports.values():
            port.close()
        self.camera.close()
        self.person.close()
        if self.card is not None:
            self.card.close()
        if self._truth is not None:
            self._truth.close()


def _plain(config: RigConfig, origin_ns: int) -> VirtualBench:
    return VirtualBench(config, origin_ns=origin_ns)


@contextlib.contextmanager
def open_server(
    config: RigConfig,
    folder: Path,
    tcp: bool = False,
    truth: Path | None = None,
    make: Callable[[RigConfig, int], VirtualBench] | None = None,
) -> Iterator[BenchServer]:
    """A bench server that is closed on the way out.

    Raises:
        ConfigError: the rig has no virtual bench.
        PamrigError: the folder cannot be used.
    """
    if config.virtual is None:
        raise ConfigError(config.source, "has no [virtual] table, so it cannot be simulated")
    try:
        server = BenchServer(config, folder, tcp, truth, make)
    except OSError as error:
        raise PamrigError(
            str(folder), f"cannot hold the bench's ports: {error}", "use --dir"
        ) from None
    try:
        yield server
    finally:
        server.close()


def serve_bench(
    rig: str,
    folder: Path,
    *,
    seed: int | None = None,
    seconds: float = 0.0,
    truth: Path | None = None,
    tcp: bool = False,
) -> None:
    """Serve until Ctrl-C (or for ``seconds``), then say how well time was kept."""
    import typer

    config = load_rig(rig, seed)
    if config.virtual is not None:
        warm_up(config, typer.echo)
    with open_server(config, folder, tcp, truth) as server, stop_on_signals() as stop:
        for name, port in server.ports.items():
            typer.echo(f"{name:8} {port.address}")
        if server.card is not None:
            typer.echo(f"{'card':8} {server.card.address}")
        if config.camera.source:
            typer.echo(f"{'camera':8} {server.camera.address}")
        typer.echo(f"rig file {server.rig_file}")
        test = "isometric" if config.joint is None else "joint-static"
        until = f"for {seconds:g} s" if seconds > 0 else "until Ctrl-C"
        typer.echo(f"the bench runs {until}; meanwhile, in another terminal")
        typer.echo(f"try:     pamrig {test} --rig {server.rig_file} --protocol {test}-short")
        end = time.monotonic() + seconds if seconds > 0 else float("inf")
        while not stop.reason and time.monotonic() < end:
            server.step()
            server.rest()
        late = server.lateness_ms()
        typer.echo(
            f"steps of 1 ms late by: median {late['p50']:.2f} ms, p99.9 {late['p99.9']:.2f} ms, "
            f"worst {late['worst']:.2f} ms"
        )


PATIENCE_S = 3.0


def warm_up(
    config: RigConfig, report: Callable[[str], object], patience_s: float = PATIENCE_S
) -> None:
    """Run a bench like this one for a moment, so that the real one never stands still to compile.

    A fresh installation compiles the plant once, which takes a minute or more of a slow
    machine; that would come after the ports are open, and every client would time out.

    Args:
        config: a rig with a [virtual] table.
        report: takes what is being waited for, once it takes longer than ``patience_s``.

    Raises:
        ConfigError: the plant refuses a constant or an effect of the rig file.
    """
    slow = threading.Timer(
        patience_s, report, ("compiling the simulation; only the first start takes so long",)
    )
    slow.daemon = True
    slow.start()
    try:
        clock = VirtualClock()
        bench = VirtualBench(config, clock)
        clock.sleep(0.05)
        if config.camera.source:
            bench.expose()
    finally:
        slow.cancel()
