"""A chamber and a muscle with scipy.integrate: one function for each stage.

The chamber is isothermal; both valves are orifices with the flow of St Venant and Wantzel, and the
volume is that of a braid (Chou and Hannaford, 1996).
"""

import numpy as np
from scipy.integrate import solve_ivp

ATMOSPHERE_PA = 101325.0
BRAID_M, TURNS = 0.085, 1.75
HEAT_RATIO = 1.4


def _flow(up_pa, down_pa):
    """Flow through an orifice per area, relative to the choked flow from one pascal."""
    ratio = max(down_pa / up_pa, 0.528)
    k = HEAT_RATIO
    factor = ratio ** (2 / k) - ratio ** ((k + 1) / k)
    return up_pa * np.sqrt(max(factor, 0.0) / 0.0670)


def pressure(inputs, parameters):
    """Gauge pressure in kPa at every inputs["time_s"], from the commands of the valves."""
    t = inputs["time_s"]
    length = inputs["length_mm"] * 1e-3
    volume = length * (BRAID_M**2 - length**2) / (4 * np.pi * TURNS**2)
    volume = volume + parameters["dead_volume_ml"] * 1e-6
    supply = inputs.get("supply_kpa", np.full(len(t), 700.0)) * 1e3 + ATMOSPHERE_PA
    c = parameters["conductance_ml_s"] * 1e-6

    # Commands stand still between their edges: one integration for each piece.
    inlet, outlet = inputs["inlet_cmd"], inputs["outlet_cmd"]
    edges = np.flatnonzero((np.diff(inlet) != 0) | (np.diff(outlet) != 0)) + 1
    starts = np.r_[0, edges]
    ends = np.r_[edges, len(t) - 1]
    made = np.empty(len(t))
    now = inputs["pressure_start_kpa"][0] * 1e3 + ATMOSPHERE_PA
    for first, last in zip(starts, ends, strict=True):
        if first == last:
            made[last] = now
            continue

        def rate(time, p, at=first):
            v = np.interp(time, t, volume)
            gain = inlet[at] * _flow(supply[at], min(p[0], supply[at]))
            loss = outlet[at] * _flow(max(p[0], ATMOSPHERE_PA), ATMOSPHERE_PA)
            return [c * (gain - loss) / v]

        piece = solve_ivp(
            rate, (t[first], t[last]), [now], t_eval=t[first : last + 1], rtol=1e-6, max_step=0.05
        )
        made[first : last + 1] = piece.y[0]
        now = piece.y[0][-1]
    return (made - ATMOSPHERE_PA) * 1e-3


def force(inputs, parameters):
    """Force in N from the measured pressure and length, with the lag of the wall."""
    t = inputs["time_s"]
    length = inputs["length_mm"] * 1e-3
    area = (3 * length**2 - BRAID_M**2) / (4 * np.pi * TURNS**2)
    pull = inputs["pressure_kpa"] * 1e3 * area
    lag = parameters["lag_s"]
    if lag <= 0.0:
        return pull
    found = solve_ivp(
        lambda time, f: [(np.interp(time, t, pull) - f[0]) / lag],
        (t[0], t[-1]), [pull[0]], t_eval=t, rtol=1e-6, max_step=0.05,
    )  # fmt: skip
    return found.y[0]
