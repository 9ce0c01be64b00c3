"""Audit of the thesis: every published figure recomputed from its own tables."""

from __future__ import annotations

import math

from plant.audit import lengths as audit_lengths
from plant.audit import ranks as audit_ranks
from plant.audit import rest as audit_rest
from plant.audit import temperature as audit_temperature
from plant.audit.printed import Row, verdict
from plant.fitting.table43 import MODELS, STATISTICS, Cell, recover_braid, table

WITHIN_N = 0.002
"""Two units of the last printed digit: the statistics come from unrounded b, n or K."""

REASONS = {
    "deterministic": ("b and n are not printed; b = {b:g} mm and n = {n:g} give all 24 statistics",
                      ("A76", "A79")),
    "Caldwell": ("geometry not printed (Eff fitted here, h = b, f = D_0): close to the deviations "
                 "from the SEMEANs, not to the printed ones, which contradict their own SEMEAN "
                 "in {bad} of 6 rows", ("A71", "A72", "A79")),
    "quasi-static": ("the SEMEANs are those of C-1, its training data; the printed deviations "
                     "contradict them in {bad} of 6 rows; C-41 and C-43 repeat other rows' numbers",
                     ("A69", "A70", "A74", "A75")),
    "black box 21": ("150-600 kPa is Table C-38's equation, exactly; no printed equation gives the "
                     "0-125 kPa row, and 0-600 combines the two", ("A73", "A77")),
    "black box T": ("0-125 kPa is Equations 4-53 to 4-57 with 4-55 corrected, exactly; 150-600 kPa "
                    "only to some percent, and 0-600 combines the two", ("A59", "A60", "A61")),
}  # fmt: skip


def audit() -> list[Row]:
    """All rows of the audit, in the order of the thesis; takes a few seconds."""
    return [
        *audit_lengths.audit(), *audit_temperature.audit(), *audit_rest.audit(),
        *audit_ranks.audit(), *_table_4_3(),
    ]  # fmt: skip


def worst(cell: Cell) -> float:
    """Largest difference between recomputed and published statistics."""
    pairs = ((getattr(cell.recomputed, s), getattr(cell.published, s)) for s in STATISTICS)
    return max(abs(float(a) - float(b)) for a, b in pairs)


def contradicts(cell: Cell) -> bool:
    """Whether the printed deviation contradicts the SEMEAN of the same row."""
    return abs(cell.by_semean / cell.published.stdev - 1.0) > 0.01


def _table_4_3() -> list[Row]:
    cells, (b, n) = table(), recover_braid()
    rows = []
    for model in MODELS:
        mine = [c for c in cells if c.model == model]
        bad = sum(contradicts(c) for c in mine)
        exact = [c for c in mine if worst(c) <= WITHIN_N]
        near = [c for c in mine if abs(c.recomputed.stdev / c.by_semean - 1.0) < 0.01]
        reason, anomalies = REASONS[model]
        everywhere = math.sqrt(
            sum((getattr(c.recomputed, s) - getattr(c.published, s)) ** 2
                for c in mine for s in STATISTICS) / (len(mine) * len(STATISTICS))
        )  # fmt: skip
        rows.append(
            Row(
                f"Table 4-3, C-39 to C-44: {model}",
                "sd " + ", ".join(f"{c.published.stdev:.3f}" for c in mine) + " N",
                "sd " + ", ".join(f"{c.recomputed.stdev:.3f}" for c in mine) + " N; by SEMEAN "
                + ", ".join(f"{c.by_semean:.3f}" for c in mine)
                + f"; all four statistics within {WITHIN_N} N in {len(exact)} of 6",
                verdict(len(exact) == 6, len(near) == 6 and not bad),
                reason.format(b=b, n=n, bad=bad) + f" ({everywhere:.3f} N rms over 24)", anomalies,
            )
        )  # fmt: skip
    return rows
