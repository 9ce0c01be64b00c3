"""From a run to its table and to what that table says, whatever its protocol."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rigs.protocols.registry import PROTOCOLS, procedure
from rigs.reduction import Reduction, reduce_isometric, without_excluded

if TYPE_CHECKING:
    from daq.run import Run
    from rigs.protocols.procedure import Findings

ISOMETRIC = "isometric"


def reduce_run(run: Run) -> Reduction:
    """The table of points of a run, without those that were excluded afterwards.

    A record of a protocol unknown here is reduced as an isometric one.
    """
    protocol = str(run.manifest.get("protocol", ""))
    if protocol == ISOMETRIC or protocol not in PROTOCOLS:
        return reduce_isometric(run)
    return without_excluded(run, procedure(protocol).reduce(run))


def findings_of(run: Run, reduction: Reduction) -> Findings | None:
    """What the table says; None for an isometric test, whose report is its own."""
    protocol = str(run.manifest.get("protocol", ""))
    if protocol == ISOMETRIC or protocol not in PROTOCOLS:
        return None
    make = procedure(protocol).findings
    return make(run, reduction) if make is not None else None
