"""Acceptance limits of a test: the tables ``[acceptance]`` and ``[[acceptance.limits]]``.

The bench does not use them. They go into the record, and the report judges the results by them.
"""

from __future__ import annotations

from dataclasses import dataclass

from analysis.findings.findings import ResultColumns
from rigs.rigfile.toml_reader import Table

LARGEST = 1e12


@dataclass(frozen=True)
class Limit:
    """Limits on a quantity.

    Attributes:
        quantity: column of the table of points.
        at: (setting, value) pairs that the result must have; none: every result of the quantity.
        lower, upper: limits in the unit of the column; None: not limited on this side.
    """

    quantity: str
    at: tuple[tuple[str, float | str], ...]
    lower: float | None
    upper: float | None


@dataclass(frozen=True)
class Acceptance:
    """Acceptance limits of a test.

    Attributes:
        guard: guard band of the decision, in expanded uncertainties.
        limits: the limits, in the order of the file.
    """

    guard: float
    limits: tuple[Limit, ...]

    def as_dict(self) -> dict[str, object]:
        """Plain values for run.json."""
        rows = [{**vars(limit), "at": dict(limit.at)} for limit in self.limits]
        return {"guard": self.guard, "limits": rows}


def read_acceptance(root: Table, results: ResultColumns) -> Acceptance | None:
    """The acceptance limits of a protocol file, or None where it has none.

    Args:
        root: root of the file.
        results: what limits can be stated on.

    Raises:
        ConfigError: unknown key, quantity or setting, or no limit where one is needed.
    """
    t = root.table("acceptance", optional=True)
    if "acceptance" not in root:
        return None
    guard = t.number("guard", 0, 10, 1.0)
    given = t.raw("limits")
    if not isinstance(given, list) or not given:
        raise t.fail("limits", "expected tables [[acceptance.limits]]", "add at least one")
    limits = tuple(_read_limit(t.row("limits", i), results) for i in range(len(given)))
    t.finish()
    return Acceptance(guard, limits)


def _read_limit(t: Table, results: ResultColumns) -> Limit:
    quantity = t.text("quantity", choices=results.quantities)
    at = t.table("at", optional=True)
    settings: list[tuple[str, float | str]] = []
    for key, value in at.values().items():
        if key not in results.settings:
            raise at.fail(
                key, "is no setting of this test", f"known: {', '.join(results.settings)}"
            )
        if isinstance(value, bool) or not isinstance(value, (int, float, str)):
            raise at.fail(key, f"expected a number or text, got {value!r}")
        settings.append((key, value if isinstance(value, str) else float(value)))
    lower, upper = (
        t.number(key, -LARGEST, LARGEST) if key in t else None for key in ("lower", "upper")
    )
    if lower is None and upper is None:
        raise t.fail("quantity", "has neither lower nor upper", "add a limit")
    if lower is not None and upper is not None and not lower < upper:
        raise t.fail("upper", f"{upper:g} is not above lower = {lower:g}")
    t.finish()
    return Limit(quantity, tuple(settings), lower, upper)
