"""Calibrating the force sensor with dead weights: the laboratory method, top to bottom.

On a load cell they are hung one after the other, up and down; on a balance they all stand on the
pan, are tared away, and are taken off one after the other, as the muscle takes weight off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from analysis.regression.calibration_line import Reference
from daq.errors import ConfigError, PamrigError
from daq.interrupt import StopFlag
from rigs.bench.rig import Rig, open_rig
from rigs.calibration.run import (
    Calibrated,
    Point,
    add_point,
    block_mean,
    carry_out,
    check_values,
    finish,
    leave_out,
    open_record,
    over_range,
    request,
    up_and_down,
)
from rigs.devices.instruments.balance import Balance
from rigs.devices.instruments.load_cell import LoadCell
from rigs.execution.runner import Watch
from rigs.rigfile.config import NONE, RigConfig

TARES = 6
"""So many tares after the weights tell what a tare leaves."""


def calibrate_force(
    config: RigConfig,
    masses_kg: Sequence[float],
    root: Path,
    *,
    weights: Reference,
    seconds: float = 4.0,
    who: str = "",
    stop: StopFlag | None = None,
    watch: Watch | None = None,
) -> Calibrated:
    """Calibrate the force sensor with dead weights.

    Args:
        config: the rig; the load cell or the balance, whichever is its force_source.
        masses_kg: of the weights, each once going up and once going down; 0 is hung empty.
        root: folder for the record.
        weights: the set's identity; ``u_gain`` its relative uncertainty (class of the
            weights, local g), ``u_each`` of a single one in N.
        seconds: how long each weight is measured, after it has come to rest.
        who, stop, watch: as for the pressure.

    Raises:
        ConfigError: no force sensor, too few weights, or one beyond the rig's limit.
        DeviceTimeout: the load would not come to rest.
    """
    if config.force_source == NONE:
        raise ConfigError(
            config.source, "has no balance and no load cell to calibrate", "choose another --rig"
        )
    gravity = config.conditions.gravity_m_s2
    check_values(
        "--masses-kg", masses_kg, 0.0, config.limits.force_n / gravity, "kg",
        f"{config.source}: limits.force_n = {config.limits.force_n:g} N",
    )  # fmt: skip
    stop, watch = stop or StopFlag(), watch or Watch()
    parameters = {"masses_kg": list(masses_kg), "seconds": seconds, "gravity_m_s2": gravity}
    with open_rig(config) as rig:
        record = open_record(rig, root, "calibrate-force", weights, parameters, who)
        points: list[Point] = []
        zeros: list[float] = []

        def method() -> None:
            text = f"take the muscle off the {_sensor(rig)} and leave nothing on it"
            request(rig, "muscle off", 0.0, "kg", text)
            most = max(masses_kg)
            hangs = isinstance(rig.balance, LoadCell)
            loads = up_and_down(masses_kg)
            there = 0.0 if hangs else most
            if there:  # nobody is asked to do what is done
                _hang(rig, there, 0.0)
            _at_rest(rig)
            if isinstance(rig.balance, Balance):
                record.event("tare", grams=rig.balance.tare())
            for number, mass in enumerate(loads, 1):
                watch.state(f"calibrate force: {mass:g} kg, {number} of {len(loads)}")
                load = mass if hangs else most - mass
                if load != there:
                    _hang(rig, load, there)
                there = load
                found = _weigh(rig, seconds)
                if found is None:
                    name = rig.balance.name
                    leave_out(record, watch, f"calibrate force, {mass:g} kg", name, mass_kg=mass)
                else:
                    add_point(record, points, Point(*found, mass * gravity))
            watch.state(f"calibrate force: {TARES} tares, to see how well one sets zero")
            for _ in range(TARES):
                rig.balance.tare()
                zeros.append(_weigh_net(rig, min(seconds, 1.0)))
                record.event("tare_left", reading=zeros[-1])
            if there:
                _hang(rig, 0.0, there)
            request(rig, "muscle", 0.0, "kg", "mount the muscle again")

        carry_out(rig, record, method, stop)
        if isinstance(rig.balance, LoadCell):
            raw_unit, device = (
                rig.balance.indicator.unit,
                config.instruments.readers()[config.force_source].serial,
            )
        else:
            raw_unit, device = "g", rig.identities["balance"].get("serial", "")
        old = replace(config.calibrations["force_n"], raw_unit=raw_unit)
        return finish(record, rig, old, device, points, weights, zeros)


def _sensor(rig: Rig) -> str:
    """What the operator sees of the force sensor."""
    return "load cell" if isinstance(rig.balance, LoadCell) else "balance"


def _hang(rig: Rig, mass_kg: float, there_kg: float) -> None:
    """Ask for a load in place of another: a mass alone could mean the weight to add."""
    verb = "hang" if isinstance(rig.balance, LoadCell) else "put"
    if not mass_kg:
        text = "take all weights off"
    elif mass_kg < there_kg:
        text = f"take weights off: leave {mass_kg:g} kg on the {_sensor(rig)}"
    else:
        in_all = " in all" if there_kg else ""
        text = f"{verb} {mass_kg:g} kg{in_all} on the {_sensor(rig)}"
    request(rig, "dead weight", mass_kg, "kg", text)


def _at_rest(rig: Rig, seconds: float = 20.0) -> None:
    """Wait for readings that all say that they are stable, or that are none."""
    source = rig.balance
    start, n, before = source.rows, 5, over_range(source.counters())

    def still() -> bool:
        if over_range(source.counters()) >= before + n:
            return True
        return source.rows >= start + n and bool(source.recent(n)[1].all())

    rig.event_loop.until(still, seconds)


def _weigh_net(rig: Rig, seconds: float) -> float:
    """What a tare has left, in the unit of :func:`_weigh`."""
    source = rig.balance
    found = _weigh(rig, seconds)
    if found is None:
        raise PamrigError(source.name, f"is at the end of its range: {source.last_problem}")
    raw, _ = found
    return float(source.grams(raw)) / source.factor if isinstance(source, LoadCell) else raw


def _weigh(rig: Rig, seconds: float) -> tuple[float, float] | None:
    """Mean raw reading (g of a balance, the indicator's unit of a load cell) and its u.

    None where a reading was at the end of the range meanwhile.

    Raises:
        PamrigError: too few readings came.
    """
    source = rig.balance
    _at_rest(rig)
    rate_hz = source.indicator.rate_hz if isinstance(source, LoadCell) else 10.0
    n = max(3, round(seconds * rate_hz))
    start, over = source.rows, over_range(source.counters())
    whole = rig.event_loop.until(
        lambda: source.rows >= start + n or over_range(source.counters()) > over, 3 * seconds + 2.0
    )
    if over_range(source.counters()) > over:
        return None
    if not whole:
        raise PamrigError(source.name, "sent too few readings", source.last_problem)
    if isinstance(source, LoadCell):
        return block_mean(source.indicator.recent(n)[0], 0.001)
    return block_mean(source.recent(n)[0], 0.001)
