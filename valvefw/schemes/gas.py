"""Flow through the two orifices in integer arithmetic: prediction of the pressure.

Pressures are absolute, in 1/256 of a count. ISO 6358 with a critical ratio of one half:
dP/dt = rate * P_upstream * psi(P_downstream / P_upstream), rate in millionths per ms. Every
product stays below 2**30.
"""

from array import array

from valvefw.native import const, micropython, ptr16, ptr32, words

STEP = const(1000)  # us
_CELLS = const(64)
_ATM = const(0)
_SUPPLY = const(1)
_RATE_IN = const(2)
_RATE_OUT = const(3)


def _root(square: int) -> int:
    root = 0
    while (root + 1) * (root + 1) <= square:
        root += 1
    return root


def _psi(cell: int) -> int:
    past = max(0, 2 * cell - _CELLS) * 256 // _CELLS
    return _root(65536 - past * past)


# psi in 1/256 for pressure ratios in 1/64; two more entries for interpolation.
PSI = array("H", [_psi(cell) for cell in range(_CELLS + 1)] + [0])


@micropython.viper
def inflow(g: ptr32, p: int) -> int:
    """Pressure rise in 1/256 count per ms with an open inlet at pressure ``p``."""
    psi = ptr16(PSI)  # type: ignore[misc,call-arg]
    supply = g[_SUPPLY]
    ratio = (p << 2) // supply  # in 1/1024
    share = 256
    if ratio >= 1024:
        share = 0
    elif ratio > 512:
        cell = ratio >> 4
        share = psi[cell] + ((psi[cell + 1] - psi[cell]) * (ratio & 15) >> 4)
    return (supply * share >> 6) * g[_RATE_IN] // 15625


# The share of the choked flow is computed in both: a call of machine code costs more than it.
@micropython.viper
def outflow(g: ptr32, p: int) -> int:
    """Pressure fall in 1/256 count per ms with an open outlet at pressure ``p``."""
    psi = ptr16(PSI)  # type: ignore[misc,call-arg]
    ratio = (g[_ATM] << 18) // p
    share = 256
    if ratio >= 1024:
        share = 0
    elif ratio > 512:
        cell = ratio >> 4
        share = psi[cell] + ((psi[cell + 1] - psi[cell]) * (ratio & 15) >> 4)
    return ((p >> 4) * share >> 10) * g[_RATE_OUT] // 15625


@micropython.viper
def after(g: ptr32, p: int, fill_at: int, fill_end: int, vent_at: int, vent_end: int) -> int:
    """Pressure after inlet and outlet were open in these time spans, us.

    A step takes one millisecond, or less if a valve switches in it.
    """
    t = fill_at
    if vent_at < t:
        t = vent_at
    end = fill_end
    if vent_end > end:
        end = vent_end
    while t < end:
        stop = t + STEP
        if t < fill_at and fill_at < stop:
            stop = fill_at
        if t < fill_end and fill_end < stop:
            stop = fill_end
        if t < vent_at and vent_at < stop:
            stop = vent_at
        if t < vent_end and vent_end < stop:
            stop = vent_end
        change = 0
        if fill_at <= t and t < fill_end:
            change = int(inflow(g, p))
        if vent_at <= t and t < vent_end:
            change -= int(outflow(g, p))
        p += change * (stop - t) // STEP
        t = stop
    return p


class Gas:
    """One chamber between two orifices."""

    def __init__(self) -> None:
        self._g = words(4)

    def load(self, values: dict[str, int]) -> None:
        """Copy ``gas_*``."""
        g = self._g
        g[_ATM] = values["gas_atm"]
        g[_SUPPLY] = values["gas_supply"] + g[_ATM]
        g[_RATE_IN] = values["gas_rate_in"]
        g[_RATE_OUT] = values["gas_rate_out"]

    def inflow(self, p: int) -> int:
        """See ``inflow``."""
        return inflow(self._g, p)

    def outflow(self, p: int) -> int:
        """See ``outflow``."""
        return outflow(self._g, p)

    def after_fill(self, p: int, open_us: int) -> int:
        """Pressure after the inlet was open for ``open_us``."""
        return after(self._g, p, 0, open_us, 0, 0)

    def after_vent(self, p: int, open_us: int) -> int:
        """Pressure after the outlet was open for ``open_us``."""
        return after(self._g, p, 0, 0, 0, open_us)

    def after_both(self, p: int, fill_at: int, fill_end: int, vent_at: int, vent_end: int) -> int:
        """Pressure after inlet and outlet were open in these time spans, us."""
        return after(self._g, p, fill_at, fill_end, vent_at, vent_end)
