"""Flow through the two orifices in integer arithmetic: prediction of the pressure.

Pressures are absolute, in 1/256 of a count. ISO 6358 with a critical ratio of one half:
dP/dt = rate * P_upstream * psi(P_downstream / P_upstream), rate in millionths per ms. Every
product stays below 2**30.
"""

STEP_US = 1000
_CELLS = 64


def _root(square: int) -> int:
    root = 0
    while (root + 1) * (root + 1) <= square:
        root += 1
    return root


def _psi(cell: int) -> int:
    past = max(0, 2 * cell - _CELLS) * 256 // _CELLS
    return _root(65536 - past * past)


# psi in 1/256 for pressure ratios in 1/64; one more entry for interpolation.
_PSI = tuple([_psi(cell) for cell in range(_CELLS + 1)] + [0])


def psi(ratio: int) -> int:
    """Share of the choked flow in 1/256 at a pressure ratio in 1/1024."""
    if ratio <= 512:
        return 256
    if ratio >= 1024:
        return 0
    cell = ratio >> 4
    low = _PSI[cell]
    return low + ((_PSI[cell + 1] - low) * (ratio & 15) >> 4)


class Gas:
    """One chamber between two orifices."""

    def load(self, values: dict[str, int]) -> None:
        """Copy ``gas_*``."""
        self._atm = values["gas_atm"]
        self._supply = values["gas_supply"] + self._atm
        self._rate_in = values["gas_rate_in"]
        self._rate_out = values["gas_rate_out"]

    def inflow(self, p: int) -> int:
        """Pressure rise in 1/256 count per ms with an open inlet at pressure ``p``."""
        supply = self._supply
        ratio = (p << 2) // supply
        return (supply * psi(ratio) >> 6) * self._rate_in // 15625

    def outflow(self, p: int) -> int:
        """Pressure fall in 1/256 count per ms with an open outlet at pressure ``p``."""
        ratio = (self._atm << 18) // p
        return ((p >> 4) * psi(ratio) >> 10) * self._rate_out // 15625

    def after_fill(self, p: int, open_us: int) -> int:
        """Pressure after the inlet was open for ``open_us``."""
        while open_us >= STEP_US:
            p += self.inflow(p)
            open_us -= STEP_US
        return p + self.inflow(p) * open_us // STEP_US

    def after_vent(self, p: int, open_us: int) -> int:
        """Pressure after the outlet was open for ``open_us``."""
        while open_us >= STEP_US:
            p -= self.outflow(p)
            open_us -= STEP_US
        return p - self.outflow(p) * open_us // STEP_US

    def after_both(self, p: int, fill_at: int, fill_end: int, vent_at: int, vent_end: int) -> int:
        """Pressure after inlet and outlet were open in these time spans, us."""
        t = fill_at if fill_at < vent_at else vent_at
        end = fill_end if fill_end > vent_end else vent_end
        while t < end:
            stop = t + STEP_US
            # A step ends at the next switching time.
            if t < fill_at < stop:
                stop = fill_at
            if t < fill_end < stop:
                stop = fill_end
            if t < vent_at < stop:
                stop = vent_at
            if t < vent_end < stop:
                stop = vent_end
            change = 0
            if fill_at <= t < fill_end:
                change = self.inflow(p)
            if vent_at <= t < vent_end:
                change -= self.outflow(p)
            p += change * (stop - t) // STEP_US
            t = stop
        return p
