"""The conclusion from a sequence of tests, as a sentence."""

from __future__ import annotations

from gap.decision.sequential import SequentialVerdict
from gap.reporting.text import headline, sentence
from gap.verdict import Status


def conclusion_text(found: SequentialVerdict) -> str:
    """Return the reason for `found.conclusion` as one sentence."""
    assert found.verdict is not None
    if found.verdict.status == Status.NO_GAP_ABOVE_FLOOR and found.relieving:
        return sentence(
            "simulation and measurement agree to within the floor only with a stated constant at "
            "the end of its tolerance; "
            f"{' or '.join(found.relieving)} in its place would fit as well"
        )
    if found.confirmed is None:
        return headline(found.verdict)
    protocol, prediction = found.confirmed
    ids = [" + ".join(effect.ids) for effect in found.of_family]
    return sentence(
        f"It is {' or '.join(ids)}, found on the tests before and confirmed by the {protocol} "
        f"test: it predicted {100 * prediction.share:.0f} % of the gap there, and no other "
        "explanation predicted as much"
    )
