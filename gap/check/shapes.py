"""How like the diagnosis's own forms the blind bench's forms are: a form that is the same tests
nothing.

    python -m gap.check.shapes --designs 2 --out out/shapes.json

For random designs that can show an effect, the blind bench records it without noise and with the
stated constants. What its reading differs by from the diagnosis's plain plant is compared with the
column of each form by which the diagnosis knows the effect: the cosine of the two, rows in units of
the usual scatter. From `SAME` on a blind form is the diagnosis's own and not another one.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from blind.design import Design, draw_design
from blind.exchange import write
from blind.noise import draw_noise
from blind.physics.entries import CATALOGUE, ENTRIES, Hidden, draw
from blind.physics.forms import FORMS, Form
from blind.recording import record
from blind.sets import BESIDE, BlindSet, sized_droop
from gap.check.scoring.closed import silent
from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.effects.candidates import CANDIDATES
from gap.model.features import BLOCKS
from gap.model.grid import make_grid
from gap.model.residuals import Model
from gap.model.sensitivities import candidate_columns
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE as EFFECTS

SAME = 0.999
"""Cosine from which on two forms are one: what differs is 4.5 % of the response, rms."""
SCATTER = {"pressure": 0.5, "force": 0.25, "load": 0.25, "camera": 0.03}
"""Usual scatter of a row of each block: kPa, N, N, mm (docs/reference/plant.md)."""
_FRACTION = 0.5
"""Share of the usual strength: small enough for a straight comparison with a column."""


@dataclass(frozen=True)
class Likeness:
    """A blind form, and the largest cosine of its response with the diagnosis's own forms.

    One value of `cosines` a design; `shape` is the diagnosis's form in the last of them.
    """

    effect: str
    form: int
    held_out: bool
    equation: str
    source: str
    cosines: tuple[float, ...]
    shape: dict[str, float]

    @property
    def same(self) -> bool:
        """Whether it is the diagnosis's own form on every design."""
        return bool(self.cosines) and min(self.cosines) > SAME


def design_for(effect: str, number: int) -> Design:
    """A small design that shows the effect, its true constants the stated ones."""
    entry = ENTRIES[effect]
    rng = np.random.default_rng([number, entry.row, 17])
    needs = ["cycle"] if entry.needs == "" else [entry.needs]
    design = draw_design(rng, needs, False, False, True)
    return replace(design, true=design.stated, temperature_channel=True)


def hidden_in(form: Form, design: Design, number: int) -> Hidden:
    """The effect in this form, of moderate strength, alike in draws for all forms."""
    rng = np.random.default_rng([number, form.number, 3])
    entry = ENTRIES[form.effect]
    one = draw(entry, rng, design.stated, form.number, held_out=form.held_out)
    variant = entry.variants[number % len(entry.variants)] if entry.variants else None
    one = replace(one, strength=abs(one.strength) * _FRACTION, variant=variant)
    return sized_droop(one, design) if EFFECTS[one.id].diagnosis.largest_fall else one


def modelled(one: BlindSet) -> tuple[DataSet, Model, Array]:
    """The data of a set, the diagnosis's model of it, and what its plain plant leaves (rows,)."""
    with tempfile.TemporaryDirectory(prefix="shapes-") as temporary:
        folder = Path(temporary) / "data"
        write(record(one), folder)
        data = read_dataset(folder)
    model = Model(make_grid(data))
    left = model.stacked(model.residual(data.constants, []))
    return data, model, np.nan_to_num(left, posinf=0.0, neginf=0.0)


def response(one: BlindSet, effect: str) -> tuple[Array, list[Array], list[dict[str, float]]]:
    """What the effect adds to the rows, and the columns of the diagnosis's forms of it."""
    data, model, left = modelled(one)
    plain = modelled(replace(one, hidden=()))[2]
    if len(plain) == len(left):  # the two benches differ a little without any effect
        left = left - plain
    scale = np.zeros(len(left))
    for number, block in enumerate(BLOCKS):
        scale[model.grid.rows.block == number] = SCATTER[block]
    variant = one.hidden[0].variant or ""
    own = [c for c in CANDIDATES if c.id == effect and c.option == variant and not c.defect]
    columns = np.nan_to_num(candidate_columns(model, data.constants, [], own))
    return left / scale, list((columns / scale[:, None]).T), [dict(c.shape) for c in own]


def likeness(form: Form, designs: int) -> Likeness:
    """Compare one form on so many random designs."""
    cosines, shape = [], {}
    for number in range(designs):
        design = design_for(form.effect, number)
        noise = replace(silent(draw_noise(np.random.default_rng(number), False)), mounting_mm=0.0)
        hidden = hidden_in(form, design, number)
        one = BlindSet(BESIDE, number, "single", design, noise, (hidden,), None, None, (), {})
        reading, columns, shapes = response(one, form.effect)
        size = float(np.linalg.norm(reading))
        along = [
            abs(float(reading @ c)) / (size * float(np.linalg.norm(c))) if c.any() and size else 0.0
            for c in columns
        ]
        if along:
            cosines.append(round(max(along), 5))
            shape = shapes[int(np.argmax(along))]
    return Likeness(
        form.effect, form.number, form.held_out, form.equation, form.source, tuple(cosines), shape
    )


def table(found: Sequence[Likeness]) -> list[str]:
    """Lines of a table: effect, form, equation, source, cosine."""
    lines = [
        "| effect | form | held out | equation | source | cosine with the diagnosis's own |",
        "|---|---|---|---|---|---|",
    ]
    for one in found:
        cosine = f"{min(one.cosines):.4f}" if one.cosines else "-"
        lines.append(
            f"| {one.effect} | {one.form} | {'yes' if one.held_out else ''} | "
            f"`{one.equation.replace('|', chr(92) + '|')}` | {one.source} | "
            f"{cosine}{' (same)' if one.same else ''} |"
        )
    return lines


def write_page(path: Path, found: Sequence[Likeness], designs: int) -> None:
    """Write the page of all forms with their sources."""
    kept = sum(one.held_out for one in found)
    same = [one for one in found if one.same]
    lines = [
        "# Forms of the blind bench",
        "",
        f"{len(found)} forms of {len({one.effect for one in found})} effects, {kept} of them held "
        "out: practice, learning and the tests of the diagnosis never meet those. The campaign "
        "`pamrig gap check --held-out` alone makes them, in a stream of their own. Form 0 is the "
        "plainest; forms 1 and 2 are those of practice and reserved sets. Where two numbers run "
        "the same equation, the effect has one more that is held out.",
        "",
        "The last column compares each form with the diagnosis's own forms of the effect: the "
        "cosine of what it adds to the rows of a data set without noise, against the nearest of "
        f"the diagnosis's columns; the smaller one of {designs} random designs, at half the usual "
        f"strength. Above {SAME:g} on all designs it is the diagnosis's own form (same): "
        f"{len(same)} forms, of which {sum(one.held_out for one in same)} are held out. "
        "A small cosine does not show how well an effect can be told: an effect that shifts an "
        "edge in time is no multiple of a column.",
        "",
        "```",
        f"python -m gap.check.shapes --designs {designs} --page docs/evidence/blind-forms.md",
        "```",
        "",
        *table(found),
        "",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare all forms, print the table and write it."""
    parser = argparse.ArgumentParser(prog="python -m gap.check.shapes", description=__doc__)
    parser.add_argument("--designs", type=int, default=2, help="random designs a form (2)")
    parser.add_argument("--effects", default="", help="ids, separated by commas (all)")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--page", type=Path, help="page to write, of all effects")
    given = parser.parse_args(arguments)
    wanted = given.effects.split(",") if given.effects else [e.id for e in CATALOGUE]
    unknown = sorted(set(wanted) - {e.id for e in CATALOGUE})
    if unknown:
        parser.error(f"--effects: no such effect: {', '.join(unknown)}")
    found = [likeness(form, given.designs) for form in FORMS if form.effect in wanted]
    print("\n".join(table(found)))
    if given.out is not None:
        given.out.parent.mkdir(parents=True, exist_ok=True)
        rows = [{**asdict(one), "same": one.same} for one in found]
        given.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if given.page is not None:
        write_page(given.page, found, given.designs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
