"""Looks after the angle and the torque of a joint while both muscles are armed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from daq.clock import NS_PER_S
from rigs.bench.rig import Rig
from rigs.devices.interfaces import Instrument, Rows
from rigs.rigfile.tables.joint import LOAD_CELL
from rigs.steps.context import RunFault


class JointWatch:
    """Ends a run when an instrument of the joint falls silent or reads beyond its limit.

    Without a reading of the angle nobody knows whether a muscle drives the joint against its stop.
    On a rig without a joint it does nothing.

    Args:
        rig: open instruments.
    """

    def __init__(self, rig: Rig) -> None:
        self._clock = rig.clock
        self._joint = joint = rig.config.joint
        self._last_ns: dict[str, int] = {}
        self._beyond: tuple[str, str] | None = None
        self._instruments: dict[str, Instrument] = {}
        if joint is None:
            return
        self._instruments = {name: rig.instruments[name] for name in joint.instruments}
        limits = {joint.angle: (joint.low_deg, joint.high_deg, "deg")}
        if joint.torque:
            lever_m = joint.lever_mm * 1e-3 if joint.torque == LOAD_CELL else 1.0
            most, unit = joint.limit_n_m / lever_m, "N" if joint.torque == LOAD_CELL else "N m"
            limits[joint.torque] = (-most, most, unit)
        for name, instrument in self._instruments.items():
            instrument.on_rows.append(self._listener(name, instrument, *limits[name]))

    def _listener(
        self, name: str, instrument: Instrument, low: float, high: float, unit: str
    ) -> Callable[[Rows], None]:
        def listen(batch: Rows) -> None:
            self._last_ns[name] = int(batch["host_ns"][-1])
            values = instrument.apply(np.asarray(batch["reading"], dtype=np.float64))
            outside = values[(values < low) | (values > high)]
            if len(outside) and self._beyond is None:
                self._beyond = (
                    instrument.name,
                    f"reads {outside[0]:.4g} {unit}, outside {low:.4g} to {high:.4g} {unit}",
                )

        return listen

    def begin(self) -> None:
        """Judge what comes from now on."""
        self._beyond = None
        self._last_ns = dict.fromkeys(self._instruments, self._clock.now_ns())

    def look(self, blind: bool) -> None:
        """Called in every round of an armed run; ``blind`` where the computer is late.

        Raises:
            RunFault: an instrument is silent, or angle or torque beyond the limits of the rig file.
        """
        if self._joint is None:
            return
        if self._beyond is not None:
            raise RunFault(*self._beyond, "check mounting and protocol, or the limits in [joint]")
        now_ns = self._clock.now_ns()
        for name, instrument in self._instruments.items():
            if blind:
                self._last_ns[name] = now_ns
            elif now_ns - self._last_ns[name] > self._joint.silence_s(name) * NS_PER_S:
                detail = f" (last: {instrument.last_problem})" if instrument.last_problem else ""
                raise RunFault(
                    instrument.name,
                    f"no reading for {self._joint.silence_s(name):g} s{detail}",
                    "check its cable and power",
                )
