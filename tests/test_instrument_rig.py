"""The optional instruments on a rig: in the record, in the doctor, on ports, lost in mid-run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench_process import BUSY
from bench_runs import quick, run_isometric
from daq.errors import ConfigError
from daq.interrupt import StopFlag
from daq.store.derive import engineering
from daq.store.run import Run, open_run
from rigs.bench.doctor import examine
from rigs.bench.rig import open_rig
from rigs.execution.session import Result
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.server import open_server

STREAMS = ["balance", "flow", "hygrometer", "load_cell", "pressure_transmitter", "supply",
           "thermometer", "valve"]  # fmt: skip


def rig_file(folder: Path, *changes: tuple[str, str], cut: tuple[str, ...] = ()) -> str:
    """The shipped rig with every instrument, changed; tables in ``cut`` are taken out."""
    text = load_rig("virtual-instruments").text
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    for table in cut:
        at = text.index(f"\n[{table}]")
        text = text[:at] + text[text.index("\n[", at + 1) :]
    path = folder / "rig.toml"
    path.write_text(text)
    return str(path)


def run(
    config: RigConfig,
    root: Path,
    during: Callable[[VirtualBench, int], None] | None = None,
    **changes: Any,
) -> tuple[Result, Run]:
    """A short isometric test; ``during(bench, now_ns)`` is called as its time passes."""

    def start(runner: Any, record: object) -> None:
        del record
        bench = runner.rig.bench
        if during is not None:
            runner.rig.event_loop.add(lambda: during(bench, runner.rig.clock.now_ns()))

    values: dict[str, Any] = {"lengths_mm": (60.0,), "pressures_kpa": (200.0, 400.0), **changes}
    result = run_isometric(
        config, quick(config, **values), root, stop=StopFlag(), on_start=start, derive=False
    )
    return result, open_run(result.folder)


def test_every_instrument_becomes_a_stream_with_its_calibration_beside_it(tmp_path: Path) -> None:
    result, record = run(load_rig("virtual-instruments"), tmp_path)
    assert result.outcome == "clean"
    assert record.problems == []
    assert [s for s in record.streams if s != "supply"] == [s for s in STREAMS if s != "supply"]
    values, units = engineering(record, "thermometer")
    assert units["temperature_c"] == "degC"
    assert values["temperature_c"].mean() == pytest.approx(21.0, abs=1.0)
    # Muscle pressure by the transmitter, in the same record as the controller's own.
    kpa = engineering(record, "pressure_transmitter")[0]["pressure_kpa"]
    assert np.sort(kpa)[-5:].mean() == pytest.approx(400.0, abs=3.0)
    # The load cell pulls with the muscle as the balance does.
    pull = engineering(record, "load_cell")[0]["force_n"].max()
    assert pull == pytest.approx(engineering(record, "balance")[0]["force_n"].max(), abs=1.5)
    assert record.manifest["instrument_calibrations"]["flow"]["quantity"] == "velocity_m_s"
    assert record.final is not None
    counted = record.final["counters"]["thermometer"]
    assert set(counted) == {"rows"}  # no fault of any kind
    assert 0 <= counted["rows"] - len(values["temperature_c"]) <= 5  # some came before the record


def test_the_temperature_of_the_record_is_the_thermometers_else_the_rig_files(
    tmp_path: Path,
) -> None:
    config = load_rig("virtual-instruments")
    _, record = run(config, tmp_path)
    conditions = record.manifest["conditions"]
    assert conditions["temperature_source"] == "thermometer"
    assert conditions["temperature_c"] == pytest.approx(21.0, abs=1.0)
    _, record = run(load_rig("virtual"), tmp_path)
    assert record.manifest["conditions"]["temperature_c"] == 21.0
    assert "instrument_calibrations" not in record.manifest


def test_a_load_cell_in_the_place_of_the_balance_gives_the_same_force(tmp_path: Path) -> None:
    path = rig_file(
        tmp_path,
        ('force_source = "balance"    # or "load_cell"\n', ""),
        ("scale = -0.00980665         # weight taken off the balance", "scale = 0.00980665"),
        ("u_offset = 0.05\n", "u_offset = 0.3\n"),
        cut=("balance",),
    )
    config = load_rig(path)
    assert config.force_source == "load_cell"
    benches: list[float] = []

    def remember(bench: VirtualBench, now_ns: int) -> None:
        benches.append(bench.plant.force_n)

    from dataclasses import replace

    base = quick(config).settle
    result, record = run(config, tmp_path, remember, settle=replace(base, drift_n=1.0))
    assert result.outcome == "clean", result.error
    force = engineering(record, "balance")[0]["force_n"]
    assert force.max() == pytest.approx(max(benches), abs=1.5)
    raw = record.samples("load_cell")["reading"]
    assert len(raw) >= len(force) > 50
    assert record.manifest["force_source"] == "load_cell"


def test_a_thermometer_pulled_out_in_mid_run_is_a_gap_and_two_events(tmp_path: Path) -> None:
    seen = {"out": 0, "in": 0}

    def pull(bench: VirtualBench, now_ns: int) -> None:
        if not seen["out"]:
            seen["out"] = now_ns
            bench.unplug("thermometer")
        elif not seen["in"] and now_ns > seen["out"] + 5e9:
            seen["in"] = now_ns
            bench.replug("thermometer")

    result, record = run(load_rig("virtual-instruments"), tmp_path, pull)
    assert result.outcome == "clean"
    kinds = [e["fault"] for e in record.events if e["kind"] == "instrument"]
    assert kinds == ["unplugged", "replugged"]
    times = record.samples("thermometer")["host_ns"]
    assert ((times > seen["out"] + 1e8) & (times < seen["in"])).sum() == 0
    assert (times > seen["in"]).sum() >= 3
    assert record.final is not None
    assert record.final["counters"]["thermometer"]["unplugged"] == 1


def test_the_force_source_pulled_out_in_mid_run_ends_it(tmp_path: Path) -> None:
    path = rig_file(
        tmp_path,
        ('force_source = "balance"', 'force_source = "load_cell"'),
        ("scale = -0.00980665 ", "scale = 0.00980665 "),
    )

    def pull(bench: VirtualBench, now_ns: int) -> None:
        if "load_cell" not in bench._unplugged:
            bench.unplug("load_cell")

    result, record = run(load_rig(path), tmp_path, pull)
    assert result.outcome == "faulted"
    assert "load_cell" in str(result.error)
    assert any(e["kind"] == "vented" and e["confirmed"] for e in record.events)


def test_without_voltage_the_inlet_stays_shut_and_with_it_the_muscle_fills() -> None:
    with open_rig(load_rig("virtual-instruments")) as rig:
        assert rig.supply is not None
        reached = {}
        for volts in (3.0, 12.0):
            rig.supply.set_voltage(volts)
            rig.valve.progress(30.0)
            if rig.valve.fault_latched:  # it had noticed that nothing rose
                rig.valve.request("clear")
            if not rig.valve.armed:
                rig.valve.arm()
                assert rig.event_loop.until(lambda: rig.valve.armed, 2.0)
            rig.valve.request("scheme pwm")
            rig.valve.set_point(float(rig.config.calibrations["pressure_kpa"].raw(300.0)))
            rig.event_loop.for_seconds(2.0)
            assert rig.bench is not None
            reached[volts] = rig.bench.plant.pressure_kpa
        assert reached[3.0] < 1.0
        assert reached[12.0] == pytest.approx(300.0, abs=10.0)
        rig.supply.set_voltage(0.0)
        assert rig.vent() < 10.0  # and venting has the voltage that it needs
        assert rig.supply.set_v == 12.0


def test_the_doctor_lists_them_all(tmp_path: Path) -> None:
    findings = {f.what: f for f in examine("virtual-instruments", tmp_path)}
    for name in ("thermometer", "load_cell", "flow", "hygrometer", "pressure_transmitter"):
        assert findings[f"{name} readings"].status == "ok"
    assert findings["supply"].status == "ok"
    assert "set by hand" in findings["manual temperature"].detail
    assert not [f for f in findings.values() if f.status == "stop"]


def test_the_doctor_names_what_measures_the_force(tmp_path: Path) -> None:
    by_rig = {
        rig: {f.what: f for f in examine(rig, tmp_path)} for rig in ("virtual-weights", "virtual")
    }
    assert by_rig["virtual-weights"]["force"].detail.startswith("from [load_cell], noise 0.0")
    assert by_rig["virtual"]["force"].detail.startswith("from [balance], noise 0.0")
    assert not [what for what in by_rig["virtual-weights"] if "balance" in what]


def test_the_doctor_looks_for_no_marks_on_a_simulated_ram(tmp_path: Path) -> None:
    assert {f.status for f in examine("virtual-ram", tmp_path)} == {"ok", "warn"}


def test_the_doctor_names_the_one_that_does_not_answer(tmp_path: Path) -> None:
    path = rig_file(
        tmp_path, ("device_id = 7", "device_id = 7\nlow = 50.0"), ("low = -100.0\n", "")
    )
    stops = [f for f in examine(path, tmp_path) if f.status == "stop"]
    assert len(stops) == 1
    assert "pressure_transmitter" in stops[0].detail
    assert "beyond what the instrument can read" in stops[0].detail


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('form = "thermometer"', 'form = "hygrometer"', "measures humidity_percent"),
        ('form = "thermometer"', 'form = "thermometre"', "no shipped instrument of that name"),
        ('word_order = "CDAB"', 'word_order = "CDBA"', "is not one of ABCD"),
        ("voltage_v = 12.0", "voltage_v = 30.0", "outside 0.1 to 24"),
        ("[instruments.hygrometer]", "[instruments.flow]", "name of a table of its own"),
        ('check = "thermometer"', 'check = "thermostat"', "not a sensor of this rig"),
        ("baud = 19200", "baud = 19200\nparity = 1", "parity: unknown key"),
        ('force_source = "balance"', 'force_source = "cell"', "is not one of balance, load_cell"),
        ('[thermometer]\nport = "virtual"', '[thermometer]\nport = "/dev/x"', "mixes both"),
    ],
)
def test_a_wrong_table_is_refused_by_its_key(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    path = rig_file(tmp_path, (old, new))
    with pytest.raises(ConfigError, match=words), open_rig(load_rig(path)):
        pass


def test_no_source_of_force_at_all_is_refused(tmp_path: Path) -> None:
    path = rig_file(
        tmp_path,
        ('force_source = "balance"    # or "load_cell"\n', ""),
        cut=("balance", "load_cell"),
    )
    with pytest.raises(ConfigError, match=r"there is no table \[balance\]"):
        load_rig(path)


@pytest.mark.realtime
def test_the_same_bytes_over_ports_in_real_time(tmp_path: Path) -> None:
    """The whole rig as a client meets it: every instrument on a pseudo-terminal of its own."""
    import threading
    import time

    stop = threading.Event()
    with open_server(load_rig("virtual-instruments"), tmp_path / "bench") as server:

        def serve() -> None:
            while not stop.is_set():
                server.step()
                time.sleep(0.0008)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with open_rig(load_rig(str(server.rig_file))) as rig:
                rig.valve.progress(10.0)
                rig.event_loop.for_seconds(2.0)
                late = time.monotonic() + 30.0
                while time.monotonic() < late and any(i.rows < 2 for i in rig.instruments.values()):
                    rig.event_loop.for_seconds(0.5)
                assert rig.supply is not None
                assert rig.supply.measure()[0] == pytest.approx(12.0, abs=0.02)
                for name, instrument in rig.instruments.items():
                    assert instrument.rows >= 2, name
                    wrong = set(instrument.faults.counts) - BUSY
                    assert not wrong, f"{name}: {instrument.faults.counts}"
                assert rig.instruments["thermometer"].mean(2) == pytest.approx(21.0, abs=1.0)
        finally:
            stop.set()
            thread.join()
