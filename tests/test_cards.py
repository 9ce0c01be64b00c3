"""Data acquisition cards: the drivers against stand-ins of the makers' packages."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.clock import RealClock
from daq.errors import ConfigError, DeviceError, LinkLost, PortError
from daq.store.derive import engineering
from protocol_runs import run_short
from rigs.bench.rig import open_rig
from rigs.devices.cards import opened
from rigs.devices.cards.card import Card, ScanClock
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.card_port import CardPort, RemoteCard
from rigs.virtual.emulators.cards import VirtualCard, library_of
from rigs.virtual.server import BenchServer

RIGS = ("virtual-labjack", "virtual-ni")


def changed(rig: str, folder: Path, *changes: tuple[str, str]) -> RigConfig:
    text = load_rig(rig).text
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "rig.toml"
    path.write_text(text)
    return load_rig(str(path))


@pytest.mark.parametrize("rig", RIGS)
def test_scans_become_rows_at_their_times(rig: str) -> None:
    with open_rig(load_rig(rig)) as opened_rig:
        seen: list[Any] = []
        reader = opened_rig.instruments["transducer"]
        reader.on_rows.append(lambda batch: seen.append(batch["host_ns"]))
        opened_rig.valve.progress(30.0)
        opened_rig.event_loop.for_seconds(20.0)
        ns = np.concatenate(seen)
        bench = opened_rig.bench
        assert bench is not None
        card = bench.extras.card
        assert card is not None
        assert len(ns) == pytest.approx(2000, abs=10)
        assert (np.diff(ns) > 0).all()
        # Each stamp against the moment at which the card truly scanned; rounds take 20 ms.
        k = np.arange(reader.rows - len(ns), reader.rows) + 1
        true_ns = np.array([bench.host_ns(round(card.begun_ns + n * card._period_ns)) for n in k])
        assert np.abs(ns - true_ns).max() < 21e6
        assert np.diff(ns).mean() == pytest.approx(10e6, rel=2e-4)
        assert reader.faults.counts == {}
        assert reader.identity["serial"] in load_rig(rig).text
        assert abs(reader.mean(100)) < 1.5


def test_the_clock_of_a_card_is_found_under_delays() -> None:
    rng = np.random.default_rng(1)
    clock, done, now = ScanClock(1000.0), 0, 0.0
    errors = []
    true_ns = 1e6 / (1 + 80e-6)
    while now < 60e9:
        now += rng.choice([5e6, 5e6, 5e6, 30e6]) + rng.exponential(2e5)
        made = int(now // true_ns)
        clock.add(made, round(now))
        stamps = clock.stamps(done + 1, made - done)
        if now > 10e9:
            errors += (stamps - np.arange(done + 1, made + 1) * true_ns).tolist()
        done = made
    assert np.abs(errors).max() < 2e6


@pytest.mark.parametrize("rig", RIGS)
def test_isometric_end_to_end(rig: str, tmp_path: Path) -> None:
    result, run, bench = run_short(
        "isometric", tmp_path, rig, lengths_mm=(58.0, 64.0), pressures_kpa=(200.0, 400.0)
    )
    assert result.outcome == "clean"
    assert run.problems == []
    kpa = engineering(run, "transducer")[0]["pressure_kpa"]
    assert np.sort(kpa)[-30:].mean() == pytest.approx(400.0, abs=4.0)
    commands = [e for e in run.events if e["kind"] == "command" and "setpoint_v" in e]
    assert {round(e["setpoint_v"], 3) for e in commands} >= {1.4, 2.8}
    assert bench.extras.card is not None
    assert bench.plant.pressure_kpa < 10.0
    assert run.final is not None
    assert run.final["counters"]["transducer"]["rows"] > 500


@pytest.mark.parametrize("rig", RIGS)
def test_hysteresis_end_to_end(rig: str, tmp_path: Path) -> None:
    result, run, _ = run_short("hysteresis", tmp_path, rig)
    assert result.outcome == "clean"
    assert run.problems == []


@pytest.mark.parametrize("what", ["gone", "mute"])
@pytest.mark.parametrize("rig", RIGS)
def test_a_card_that_is_lost_ends_the_run_vented(rig: str, what: str, tmp_path: Path) -> None:
    def begin(runner: Any) -> None:
        bench: VirtualBench = runner.rig.bench
        due_ns = runner.rig.clock.now_ns() + 6e9
        assert bench.extras.card is not None

        def pull() -> None:
            if runner.rig.clock.now_ns() > due_ns:
                setattr(bench.extras.card, what, True)

        runner.rig.event_loop.add(pull)

    result, run, bench = run_short("isometric", tmp_path, rig, begin=begin)
    assert result.outcome == "faulted"
    assert run.final is not None
    counted = run.final["counters"]["transducer"]
    assert counted.get("unplugged", 0) + counted.get("silent", 0) >= 1
    assert bench.plant.pressure_kpa < 10.0


def test_lost_scans_and_overloads_are_no_rows() -> None:
    with open_rig(load_rig("virtual-labjack")) as rig:
        assert rig.bench is not None
        card = rig.bench.extras.card
        assert card is not None
        reader = rig.instruments["cell"]
        card.skip = 3
        rig.event_loop.for_seconds(0.5)
        assert reader.faults.counts == {"damaged": 3}
        card._read["AIN1"] = lambda: 12.0
        rig.event_loop.for_seconds(0.5)
        assert reader.faults.counts["overload"] >= 40
        assert np.abs(reader.recent(1000)[0]).max() < 9.9
        assert "damaged" in rig.instruments["transducer"].faults.counts


@pytest.mark.parametrize("rig", RIGS)
def test_another_card_is_refused(rig: str, tmp_path: Path) -> None:
    config = load_rig(rig)
    assert config.instruments.card is not None
    with open_rig(config) as opened_rig:
        library = opened_rig.bench.extras.card_library  # type: ignore[union-attr]
        other = dataclasses.replace(config.instruments.card, serial="12345678")
        with pytest.raises(DeviceError, match=r"card\.serial: expected 12345678"):
            Card(opened.backend(other, opened_rig.clock, library), other, opened_rig.event_loop)


@pytest.mark.parametrize(("rig", "extra"), [("virtual-labjack", "labjack"), ("virtual-ni", "ni")])
def test_a_package_that_is_not_installed_is_named(
    rig: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = load_rig(rig).instruments.card
    assert device is not None

    def absent(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(opened, "import_module", absent)
    with pytest.raises(ConfigError, match=rf"pip install 'pamrig\[{extra}\]'"):
        opened.backend(device, None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [('kind = "labjack"', 'kind = "mcc"', "labjack, nidaqmx"),
     ("scale = 100.0", "scale = 0", "scale of 0"), ("[card.output]", "[card.outputs]", "outputs"),
     ('quantity = "force_n"', 'quantity = "torque"', "torque"),
     ('static_scheme = "reg"', 'static_scheme = "pwm"', "static_scheme"),
     ('sensor = "transducer"', 'sensor = "cell"', "reads no pressure"),
     ("[card.channels.cell]", "[card.channels.valve]", "not a valid name"),
     ("[card.output]", "[card.valves]\ninlet = 0\n[card.output]", "does not vent by itself")],
)  # fmt: skip
def test_a_rig_file_that_cannot_work_names_the_key(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=words):
        changed("virtual-labjack", tmp_path, (old, new))


class Served:
    """A simulated card behind its port, in a thread of its own."""

    def __init__(self, kind: str) -> None:
        config = load_rig("virtual-labjack" if kind == "labjack" else "virtual-ni")
        assert config.instruments.card is not None
        device = config.instruments.card
        self.volts: list[tuple[str, float]] = []
        read = {channel.terminal: (lambda: 1.5) for channel in device.channels.values()}
        self.card = VirtualCard(device, read, lambda *out: self.volts.append(out), lambda s: None)
        self.port = CardPort(self.card)
        self.device = dataclasses.replace(device, port=self.port.address)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        now_ns = 0
        while not self._stop.is_set():
            now_ns += 1_000_000
            while self.card.next_ns is not None and self.card.next_ns <= now_ns:
                self.card.advance(now_ns)
            self.card.advance(now_ns)
            self.port.step()
            time.sleep(0.0002)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.port.close()


@pytest.fixture(params=["labjack", "nidaqmx"])
def served(request: pytest.FixtureRequest) -> Iterator[Served]:
    made = Served(request.param)
    yield made
    made.close()


def test_a_card_behind_a_port_is_read_and_set_by_its_package(served: Served) -> None:
    remote = RemoteCard(served.device)
    driver = opened.backend(served.device, RealClock(), library_of(remote))
    try:
        driver.open()
        channels = list(served.device.channels.values())
        driver.start(channels, served.device.rate_hz)
        seen, end = 0, time.monotonic() + 5.0
        while seen < 100 and time.monotonic() < end:
            block = driver.read()
            assert block.shape[1] == len(channels)
            assert (block == 1.5).all()
            seen += len(block)
        assert seen >= 100
        output = served.device.output
        assert output is not None
        driver.write(output.terminal, 2.5)
        assert served.volts == [(output.terminal, 2.5)]
        served.card.gone = True
        time.sleep(0.1)  # the next block is due
        with pytest.raises(LinkLost):
            _read_on(driver)
    finally:
        driver.close()
        remote.close()


def _read_on(driver: Any) -> None:
    for _ in range(100):
        driver.read()
        time.sleep(0.02)


def test_a_client_that_says_nonsense_is_hung_up_on(served: Served) -> None:
    where = served.device.port.removeprefix("tcp://").split(":")
    for words in (b"nonsense\n", b"[]\n", b'{"do": "write"}\n', b"x" * 100_000):
        with socket.create_connection((where[0], int(where[1])), 2.0) as client:
            with contextlib.suppress(OSError):
                client.sendall(words)
            client.settimeout(2.0)
            with contextlib.suppress(ConnectionError):
                assert client.recv(100) == b""
    assert served.volts == []


def test_nobody_at_the_address_is_said(served: Served) -> None:
    device = dataclasses.replace(served.device, port="tcp://127.0.0.1:1")
    with pytest.raises(PortError, match="pamrig virtual"):
        RemoteCard(device)


def test_the_rig_file_of_a_served_bench_names_the_port(tmp_path: Path) -> None:
    server = BenchServer(load_rig("virtual-ni"), tmp_path / "bench")
    try:
        assert server.card is not None
        mine = load_rig(str(server.rig_file))
        assert mine.instruments.card is not None
        assert mine.instruments.card.port == server.card.address
        assert "card" not in server.ports
    finally:
        server.close()
