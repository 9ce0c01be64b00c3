"""The Modbus transmitter: byte pairs, injected faults, and pymodbus's own server."""

from __future__ import annotations

import asyncio
import dataclasses
import math
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench_process import BUSY
from daq.clock import RealClock, VirtualClock
from daq.link.transport import SerialLink, memory_pair
from instrument_desk import Desk
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.modbus import ModbusInstrument
from rigs.rigfile.modbus_form import KINDS, ORDERS, ModbusForm
from rigs.virtual.emulators.modbus import VirtualModbus, crc16

FORM = ModbusForm(
    quantity="pressure_kpa",
    unit="kPa",
    device_id=7,
    register=100,
    kind="float32",
    word_order="CDAB",
    unit_register=104,
    unit_code=3,
    overload=9.9e9,
    underload=-9.9e9,
    low=-100.0,
    high=1100.0,
    timeout_s=0.1,
)


def desk_of(form: ModbusForm = FORM) -> tuple[Desk, ModbusInstrument]:
    desk = Desk(lambda read, send: VirtualModbus(form, read, send))
    driver = ModbusInstrument(
        desk.host, desk.event_loop, "pressure_transmitter", form, reopen=desk.reopen
    )
    desk.watch(driver)
    return desk, driver


# ---- byte pairs -----------------------------------------------------------------------


def test_the_question_and_the_answer_byte_by_byte() -> None:
    """Device 1, holding registers 0 and 1, 550.25 kPa as float32 ABCD = 44 09 90 00."""
    clock = VirtualClock()
    host, end = memory_pair(clock, "line")
    event_loop = EventLoop(clock, 0.005)
    form = ModbusForm("pressure_kpa", "kPa", 1, 0, loopback=False)
    driver = ModbusInstrument(host, event_loop, "pressure_transmitter", form)
    event_loop.add(driver.poll)
    event_loop.step()
    assert end.read()[0].data == bytes.fromhex("01 03 00 00 00 02 c4 0b")
    body = bytes.fromhex("01 03 04 44 09 90 00")
    end.write(body + crc16(body))
    event_loop.for_seconds(0.15)
    assert driver.recent(1)[0].tolist() == [550.25]


def test_the_checksum_is_the_one_of_the_standard() -> None:
    assert crc16(bytes.fromhex("01 03 00 00 00 02")) == bytes.fromhex("c4 0b")


@given(
    st.sampled_from(sorted(KINDS)),
    st.sampled_from(sorted(ORDERS)),
    st.integers(-30_000, 30_000),
)
def test_every_kind_and_word_order_gives_back_its_number(
    kind: str, order: str, number: int
) -> None:
    form = dataclasses.replace(FORM, kind=kind, word_order=order)
    number = abs(number) if kind == "uint16" else number
    assert form.number(form.words(number)) == number


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ("ABCD", [0x4409, 0x9000]),
        ("CDAB", [0x9000, 0x4409]),
        ("BADC", [0x0944, 0x0090]),
        ("DCBA", [0x0090, 0x0944]),
    ],
)
def test_word_orders_as_makers_print_them(order: str, words: list[int]) -> None:
    assert dataclasses.replace(FORM, word_order=order).number(words) == 550.25


def test_scaling_is_the_rig_files() -> None:
    form = ModbusForm("pressure_kpa", "kPa", 1, 0, kind="int16", scale=0.1, offset=-20.0)
    assert form.parse([5000]).value == pytest.approx(480.0)
    assert form.parse([0xFFFF]).value == pytest.approx(-20.1)


def test_not_a_number_is_a_flag() -> None:
    form = ModbusForm("pressure_kpa", "kPa", 1, 0)
    assert form.parse(form.words(math.nan)).fault == "overload"


# ---- injected faults --------------------------------------------------------------------------


def test_readings_come_and_are_right() -> None:
    desk, driver = desk_of()
    driver.connect("")
    desk.event_loop.for_seconds(10.0)
    assert len(desk.rows) == pytest.approx(50, abs=3)
    assert driver.faults.counts == {}
    # The registers were read when the answer was made: some ms before it was all here.
    assert desk.worst() < 0.002


@pytest.mark.parametrize(
    ("fault", "kinds"),
    [
        ("half", {"half"}),
        ("double", {"stale"}),
        ("checksum", {"checksum", "damaged", "half"}),
        ("late", {"no_answer", "late"}),
        ("stale", {"stale"}),
        ("garbage", {"half", "damaged"}),
        ("drop", {"no_answer"}),
    ],
)
def test_an_injected_fault_is_counted_and_never_a_wrong_value(fault: str, kinds: set[str]) -> None:
    desk, driver = desk_of()
    driver.connect("")
    for _ in range(5):
        desk.device.wire.arrange(fault)
        desk.event_loop.for_seconds(3.0)
    assert driver.faults.total >= 5
    assert set(driver.faults.counts) <= kinds
    assert desk.worst() < 0.002
    before = driver.rows
    desk.event_loop.for_seconds(2.0)
    assert driver.rows >= before + 8


@pytest.mark.parametrize(
    ("change", "fault"),
    [({"unit_code": 4}, "unit"), ({"flag": "overload"}, "overload"),
     ({"flag": "underload"}, "underload")],
)  # fmt: skip
def test_keypad_and_flags_are_faults(change: dict[str, object], fault: str) -> None:
    desk, driver = desk_of()
    driver.connect("")
    desk.event_loop.for_seconds(1.0)
    for key, value in change.items():
        setattr(desk.device, key, value)
    rows = driver.rows
    desk.event_loop.for_seconds(2.0)
    assert driver.rows <= rows + 1
    assert driver.faults.counts[fault] >= 8
    assert desk.worst() < 0.002


def test_unplugged_and_plugged_in_again() -> None:
    desk, driver = desk_of()
    driver.connect("")
    desk.unplug()
    desk.event_loop.for_seconds(3.0)
    rows = driver.rows
    desk.replug()
    desk.event_loop.for_seconds(3.0)
    assert driver.rows > rows + 5
    assert (driver.faults.counts["unplugged"], driver.faults.counts["replugged"]) == (1, 1)
    assert desk.worst() < 0.002


def test_a_refusal_is_told_by_its_number() -> None:
    desk, driver = desk_of(dataclasses.replace(FORM, function="input", unit_register=-1))
    driver.connect("")
    desk.device._form = FORM  # now it has holding registers only
    desk.event_loop.for_seconds(1.0)
    assert driver.faults.counts["refused"] >= 3
    assert "Modbus exception 1" in driver.faults.last


# ---- pymodbus's own server ------------------------------------------------------------


@pytest.fixture
def server_port(tmp_path: Path) -> Iterator[str]:
    """pymodbus's RTU server on one end of two joined pseudo-terminals; yields the other."""
    import tty

    from pymodbus.framer import FramerType
    from pymodbus.server import ModbusSerialServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    masters, paths = [], []
    for _ in range(2):
        master, slave = os.openpty()
        tty.setraw(slave)
        masters.append((master, slave))
        paths.append(os.ttyname(slave))
    stop = threading.Event()

    def shovel(source: int, target: int) -> None:
        os.set_blocking(source, False)
        while not stop.wait(0.001):
            try:
                os.write(target, os.read(source, 4096))
            except OSError:
                continue

    pairs = [(masters[0][0], masters[1][0]), (masters[1][0], masters[0][0])]
    threads = [threading.Thread(target=shovel, args=pair) for pair in pairs]

    loop = asyncio.new_event_loop()
    servers: list[ModbusSerialServer] = []
    ready = threading.Event()

    async def serve() -> None:
        device = SimDevice(
            id=7,
            simdata=[
                SimData(100, values=[0x9000, 0x4409], datatype=DataType.REGISTERS),
                SimData(102, values=[0, 0, 3], datatype=DataType.REGISTERS),
            ],
        )
        server = ModbusSerialServer(device, framer=FramerType.RTU, port=paths[0], baudrate=19200)
        servers.append(server)
        await server.serve_forever(background=True)
        ready.set()

    async def end() -> None:
        await servers[0].shutdown()

    threads.append(threading.Thread(target=loop.run_forever))
    for thread in threads:
        thread.start()
    asyncio.run_coroutine_threadsafe(serve(), loop)
    assert ready.wait(10.0)
    yield paths[1]
    asyncio.run_coroutine_threadsafe(end(), loop).result(10.0)
    stop.set()
    loop.call_soon_threadsafe(loop.stop)
    for thread in threads:
        thread.join(5.0)
    loop.close()
    for master, slave in masters:
        os.close(master)
        os.close(slave)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs pseudo-terminals")
@pytest.mark.realtime
def test_it_talks_to_pymodbus_own_server(server_port: str) -> None:
    clock = RealClock()
    link = SerialLink(server_port, 19200, clock)
    event_loop = EventLoop(clock, 0.005)
    form = dataclasses.replace(FORM, timeout_s=0.5, rate_hz=20.0)
    driver = ModbusInstrument(link, event_loop, "pressure_transmitter", form, baud=19200)
    try:
        driver.connect("")
        assert event_loop.until(lambda: driver.rows >= 5, 60.0)
    finally:
        link.close()
    assert set(driver.recent(100)[0].tolist()) == {550.25}
    assert set(driver.faults.counts) <= BUSY
