"""What reports say about work and efficiency."""

from __future__ import annotations

ENERGY_COLUMNS = (
    ("work_j", "work of the stroke, J"), ("exergy_j", "exergy of the air, J"),
    ("efficiency", "efficiency"),
)  # fmt: skip
ENERGY_WORDS = (
    "Work of a stroke: weight times stroke. Over the whole cycle it is zero: what was lifted comes"
    " down again. Exergy of the air: (p_high V_high − p_low V_low) ln(p_supply / p_atmosphere),"
    " with absolute pressures and the stated volume: the most work that the air used in a cycle"
    " could give. Efficiency: work of the stroke over that exergy.",
)
NOT_KNOWN = (
    "The volume of the muscle is not known: the protocol file has no [air], so neither the exergy"
    " of the air nor an efficiency is given."
)
