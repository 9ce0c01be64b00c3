"""Line-based instruments: bytes in, readings out, every injected fault counted, never measured."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.errors import ConfigError, DeviceError, DeviceTimeout, LinkLost
from instrument_desk import Desk
from rigs.devices.instruments.text import TextInstrument
from rigs.rigfile.form import TextForm, load_form
from rigs.virtual.emulators.text import VirtualText

FORMS = ("load-cell-stream", "load-cell-polled", "thermometer", "air-velocity", "hygrometer")
# Half of the last digit that each prints, and how far the ramp goes in a reply's time.
TOLERANCE = {"thermometer": 0.006, "air-velocity": 0.006, "hygrometer": 0.051}


def desk_of(name: str, serial: str = "T-1") -> tuple[Desk, TextInstrument, TextForm]:
    form = load_form(name)
    desk = Desk(lambda read, send: VirtualText(form, read, send, serial))
    driver = TextInstrument(desk.host, desk.event_loop, name, form, reopen=desk.reopen)
    desk.watch(driver)
    return desk, driver, form


def no_wrong_value(desk: Desk, name: str) -> None:
    assert desk.rows
    assert desk.worst() <= TOLERANCE.get(name, 0.0006) + 1e-9


# ---- byte pairs -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "line", "value"),
    [
        ("load-cell-stream", "ST,NT,-00001.250kg", -1.25),
        ("load-cell-stream", "US,GS,+00000.001kg", 0.001),
        ("load-cell-polled", "N+00012.345 kg S*15", 12.345),
        ("thermometer", "T= -3.50 C", -3.5),
        ("air-velocity", "V +065.12 m/s *1C", 65.12),
        ("hygrometer", "RH 100.0 %", 100.0),
    ],
)
def test_a_line_reads_as_its_value(name: str, line: str, value: float) -> None:
    parsed = load_form(name).parse(line)
    assert (parsed.fault, parsed.value) == ("", value)


@pytest.mark.parametrize(
    ("name", "line", "fault"),
    [
        ("load-cell-stream", "ST,NT,-00001,250kg", "comma"),
        ("load-cell-stream", "ST,NT,-00001.250lb", "unit"),
        ("load-cell-stream", "ST,NT,-0001.250kg", "damaged"),
        ("load-cell-stream", "ST,NT,-00ST,NT,-00001.250kg", "damaged"),
        ("load-cell-stream", "OL,NT,+99999.999kg", "overload"),
        ("load-cell-stream", "OL,NT,-99999.999kg", "underload"),
        ("load-cell-stream", "ST,NT,+00099.000kg", "range"),
        ("load-cell-polled", "N+00012.347 kg S*15", "checksum"),
        ("load-cell-polled", "N+00012.345 kg S", "damaged"),
        ("load-cell-polled", "N OVER*00", "checksum"),
        ("thermometer", "T= 70.47 F", "unit"),
        ("thermometer", "T=  .37 C", "damaged"),
        ("thermometer", "T=OPEN C", "underload"),
        ("hygrometer", "RH  45,2 %", "comma"),
    ],
)
def test_what_is_no_reading_is_a_fault_by_name(name: str, line: str, fault: str) -> None:
    assert load_form(name).parse(line).fault == fault


@settings(deadline=None)
@given(st.data())
def test_a_line_with_one_character_lost_changed_or_doubled_is_never_another_value(
    data: st.DataObject,
) -> None:
    """With a checksum no single slip reads as a wrong number; with a width no lost one does."""
    name = data.draw(st.sampled_from(["load-cell-polled", "air-velocity"]))
    form = load_form(name)
    value = data.draw(st.integers(-40_000, 40_000)) / 1000
    line = form.seal(form.template.format(value=value, unit=form.unit, status="S"))
    line = line.rstrip(b"\r\n")
    true = form.parse(line.decode()).value
    at = data.draw(st.integers(0, len(line) - 1))
    slip = data.draw(st.sampled_from(["lost", "doubled", "bit"]))
    if slip == "lost":
        line = line[:at] + line[at + 1 :]
    elif slip == "doubled":
        line = line[:at] + line[at : at + 1] + line[at:]
    else:
        bit = 1 << data.draw(st.integers(0, 6))
        line = line[:at] + bytes([line[at] ^ bit]) + line[at + 1 :]
    parsed = form.parse(line.decode("latin-1"))
    assert parsed.fault or parsed.value == true


# ---- the driver -----------------------------------------------------------------------


@pytest.mark.parametrize("name", FORMS)
def test_readings_come_at_their_rate_and_are_right(name: str) -> None:
    desk, driver, form = desk_of(name)
    driver.connect("")
    desk.event_loop.for_seconds(10.0)
    assert len(desk.rows) == pytest.approx(10 * form.rate_hz, abs=3)
    assert driver.faults.counts == {}
    no_wrong_value(desk, name)


INJECTED_FAULTS = {
    # injected fault: the kinds of fault that tell it, in a stream and when asked
    "half": ({"half", "damaged", "checksum"}, {"half"}),
    "double": ({"stale"}, {"stale", "damaged"}),
    "checksum": ({"checksum", "damaged"}, {"checksum", "damaged"}),
    "late": ({"late", "stale"}, {"no_answer", "late", "stale"}),
    "stale": ({"stale"}, {"stale", "damaged"}),
    "garbage": ({"damaged"}, {"damaged"}),
}


@pytest.mark.parametrize("fault", INJECTED_FAULTS)
@pytest.mark.parametrize("name", FORMS)
def test_an_injected_fault_is_counted_and_never_a_wrong_value(name: str, fault: str) -> None:
    desk, driver, form = desk_of(name)
    if fault == "checksum" and form.checksum == "none":
        pytest.skip("no checksum, no detection: see docs/reference/instruments.md")
    told: list[str] = []
    driver.faults.on_fault.append(lambda kind, words: told.append(kind))
    driver.connect("")
    for _ in range(5):
        desk.device.wire.arrange(fault)
        desk.event_loop.for_seconds(max(3.0, 3 / form.rate_hz))
    polled = bool(form.query)
    assert driver.faults.total >= 5
    assert set(driver.faults.counts) <= INJECTED_FAULTS[fault][polled]
    assert told == [k for k in told if k in driver.faults.counts]
    assert len(told) == driver.faults.total
    no_wrong_value(desk, name)
    before = driver.rows
    desk.event_loop.for_seconds(5.0)
    assert driver.rows > before  # and it goes on


OTHER_UNIT = {"thermometer": "F", "air-velocity": "fpm", "hygrometer": "g/m3"}


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"unit": ""}, "unit"),
        ({"comma": True}, "comma"),
        ({"flag": "overload"}, "overload"),
        ({"flag": "underload"}, "underload"),
    ],
)
@pytest.mark.parametrize("name", FORMS)
def test_what_somebody_does_at_the_keypad_is_a_fault_not_a_reading(
    name: str, change: dict[str, object], fault: str
) -> None:
    desk, driver, form = desk_of(name)
    driver.connect("")
    desk.event_loop.for_seconds(1.0)
    for key, value in change.items():
        setattr(desk.device, key, value if key != "unit" else OTHER_UNIT.get(name, "lb"))
    rows, seconds = driver.rows, max(3.0, 3.0 / form.rate_hz)
    desk.event_loop.for_seconds(seconds)
    assert driver.rows <= rows + 1
    assert driver.faults.counts[fault] >= 0.6 * seconds * form.rate_hz
    assert driver.faults.last
    no_wrong_value(desk, name)


def test_a_bus_held_up_for_a_while_does_not_bring_old_readings_under_new_times() -> None:
    """A stream that stops and then comes in a burst: the burst is counted and dropped."""
    desk, driver, _ = desk_of("air-velocity")
    driver.connect("")
    desk.event_loop.for_seconds(1.0)
    held: list[bytes] = []
    wire = desk.device.wire
    straight, wire._send = wire._send, held.append
    desk.event_loop.for_seconds(0.6)
    wire._send = straight
    for line in held:
        straight(line)
    desk.event_loop.for_seconds(2.0)
    assert driver.faults.counts["late"] == len(held)
    no_wrong_value(desk, "air-velocity")


@pytest.mark.parametrize("name", FORMS)
def test_unplugged_and_plugged_in_again_it_goes_on_and_says_both(name: str) -> None:
    desk, driver, _ = desk_of(name)
    driver.connect("")
    desk.event_loop.for_seconds(2.0)
    desk.unplug()
    desk.event_loop.for_seconds(3.0)
    rows = driver.rows
    desk.event_loop.for_seconds(2.0)
    assert driver.rows == rows
    desk.replug()
    desk.event_loop.for_seconds(6.0)
    assert driver.rows > rows
    assert (driver.faults.counts["unplugged"], driver.faults.counts["replugged"]) == (1, 1)
    no_wrong_value(desk, name)


def test_another_instrument_on_the_same_port_is_not_read() -> None:
    desk, driver, _ = desk_of("load-cell-polled", serial="LC-7")
    driver.connect("LC-7")
    desk.unplug()
    desk.event_loop.for_seconds(1.0)
    desk.device._serial = "LC-8"
    desk.replug()
    rows = driver.rows
    desk.event_loop.for_seconds(6.0)
    assert driver.rows == rows
    assert driver.faults.counts["stranger"] >= 1


def test_an_instrument_that_a_test_needs_is_lost_for_good() -> None:
    desk, _, form = desk_of("load-cell-stream")
    driver = TextInstrument(desk.host, desk.event_loop, "load_cell", form)
    driver.connect("")
    desk.unplug()
    with pytest.raises(LinkLost, match="load_cell on desk"):
        desk.event_loop.for_seconds(1.0)
    assert driver.faults.counts["unplugged"] == 1


def test_the_wrong_instrument_is_refused_by_name() -> None:
    _, driver, _ = desk_of("thermometer", serial="TH-9")
    with pytest.raises(DeviceError, match=r"key thermometer.serial: expected TH-1, got TH-9"):
        driver.connect("TH-1")


def test_an_instrument_that_says_nothing_that_reads_is_an_error_with_its_last_words() -> None:
    desk, driver, _ = desk_of("hygrometer")
    desk.device.unit = "g/m3"
    with pytest.raises(DeviceTimeout, match=r"no reading within .* 'g/m3' instead of '%'"):
        driver.connect("")


def test_a_stream_that_falls_silent_is_said_once() -> None:
    desk, driver, _ = desk_of("load-cell-stream")
    driver.connect("")
    desk.device.mute = True
    desk.event_loop.for_seconds(10.0)
    assert driver.faults.counts == {"silent": 1}


def test_tare_waits_for_readings_at_rest() -> None:
    desk, driver, _ = desk_of("load-cell-polled")
    driver.connect("")
    assert abs(driver.tare()) < 0.06
    desk.event_loop.for_seconds(1.0)
    assert driver.mean(1) < 0.5


# ---- descriptions ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("RH  45.2 %", "RH 45.2 %", r"example: does not read by this description"),
        ("(?P<value>", "(", r"pattern: has no group"),
        ("[ 0-9]{3}", "( 0-9{3}", r"pattern: is not a regular expression"),
        ("humidity_percent", "humidity", r"quantity: 'humidity' has no unit"),
        ("rate_hz", "rate_Hz", r"rate_Hz: unknown key"),
        ("{value:5.1f}", "{value.__class__}", r"template: .* is not a line with \{value\}"),
        ("{value:5.1f}", "{value:999999999}", r"template: .* is not a line with \{value\}"),
        ("{value:5.1f}", "{value:{unit}}", r"template: .* is not a line with \{value\}"),
        ("{value:5.1f}", "{0}", r"template: .* is not a line with \{value\}"),
        ("{value:5.1f}", "{value", r"template: .* is not a line with \{value\}"),
    ],
)
def test_a_description_that_cannot_work_is_refused(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    from rigs.rigfile.toml_reader import find_config

    text, _ = find_config("hygrometer", "instruments")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=words):
        load_form(str(path))
