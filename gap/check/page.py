"""The page of a campaign: what was run, what came out, where it fails. Made by the command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gap.check import figures

NOTE = """Every set was made by the package `blind`, which shares no code with the diagnosis or with
`plant`: it has its own integrator, functional forms of the effects, noise and protocols
([kinds of sets](blind.md)). The true answers were sealed (salted SHA-256) before the diagnosis ran,
and opened by the scorer after the verdict was stored. The *size* of a gap is the rms of the change
that the hidden effect causes, after the nominal constants are fitted again within their tolerances.
Its unit is one *floor*: the rms scatter between replicates, in the channel that shows the effect
best. A *confounder* is one other entry of the catalogue, or two together, that reproduce more than
90 % of this change with the same design. *Changed conditions*: protocols, rates, muscle sizes and
noise that no practice set has. The *credible set* lists the most probable explanations, up to 90 %
together. The *closed fraction* is the part of the gap that the named effect removes. Intervals are
Wilson intervals at 95 %. Each score is defined in the package `gap.check`.
"""


def cell(line: dict[str, Any]) -> str:
    """A figure with its interval and count."""
    if line["value"] is None:
        return f"- (of {line['of']})"
    if line["hits"] is None:
        return f"{line['value']:.3g} (of {line['of']})"
    return (
        f"{100 * line['value']:.1f} % [{100 * line['low']:.1f}, {100 * line['high']:.1f}]"
        f" ({line['hits']}/{line['of']})"
    )


def headline_table(found: dict[str, Any]) -> list[str]:
    """Figure, target, all sets, familiar conditions, changed conditions."""
    lines = [
        "| score | target | all sets | familiar conditions | changed conditions | met |",
        "|---|---|---|---|---|---|",
    ]
    parts = zip(
        found["headline"], found["headline_familiar"], found["headline_changed"], strict=True
    )
    for a, familiar, changed in parts:
        met = {True: "yes", False: "**no**", None: ""}[a["met"]]
        lines.append(
            f"| {a['figure']} | {a['target'] or ''} | {cell(a)} | {cell(familiar)} "
            f"| {cell(changed)} | {met} |"
        )
    return lines


def baseline_table(found: dict[str, Any]) -> list[str]:
    """The naive methods in the same figures."""
    names = list(found["baselines"])
    if not names:
        return []
    wanted = (
        "false alarm at nominal", "right family, gap >= 2 floors", "wrong name given, any size",
        "both effects of a pair named, each >= 2 floors", "wrong additional names per pair",
        "unknown effect detected, no confounder", "90 % credible set contains the truth",
        "calibration error, bias-corrected",
    )  # fmt: skip
    own = {line["figure"]: line for line in found["headline"]}
    tables = {n: {line["figure"]: line for line in found["baselines"][n]} for n in names}
    lines = ["", "## Comparison with simple methods", ""]
    if found["baseline_sets"] < found["sets"]:
        lines += [f"The simple methods ran on {found['baseline_sets']} of the sets.", ""]
    lines.append("| score | this diagnosis | " + " | ".join(names) + " |")
    lines.append("|---" * (len(names) + 2) + "|")
    for figure in wanted:
        others = " | ".join(cell(tables[n][figure]) for n in names)
        lines.append(f"| {figure} | {cell(own[figure])} | {others} |")
    return lines


def effect_table(found: dict[str, Any]) -> list[str]:
    """Per effect: sets, mimicked ones, right family by size, wrong names, limit."""
    if not found["effects"]:
        return []
    bands = list(found["effects"][0]["bands"])
    head = " | ".join(f"{b} floors" for b in bands)
    lines = [
        "",
        "## Results per effect",
        "",
        "Sets with the right family / all sets, by size of "
        "the gap. *Limit*: smallest size above which at least 90 % of the sets without a "
        "confounder got the right family.",
        "",
    ]
    lines.append(f"| effect | sets | with confounder | {head} | wrong names | limit (floors) |")
    lines.append("|---" * (len(bands) + 5) + "|")
    for e in found["effects"]:
        cells = " | ".join(
            f"{e['bands'][b]['family']}/{e['bands'][b]['sets']}" if e["bands"][b]["sets"] else ""
            for b in bands
        )
        limit = "not reached" if e["limit_floors"] is None else f"{e['limit_floors']:.2g}"
        lines.append(
            f"| {e['effect']} | {e['sets']} | {e['mimicked']} | {cells} | {e['wrong']} | {limit} |"
        )
    return lines


def write_page(path: Path, found: dict[str, Any]) -> None:
    """Write the page and its figures (gap-check-*.png in docs/images, or images beside it)."""
    folder = "../images" if (path.parent.parent / "images").is_dir() else "images"
    images = path.parent / folder
    images.mkdir(parents=True, exist_ok=True)
    figures.reliability(found, images / "gap-check-reliability.png")
    figures.sizes(found, images / "gap-check-sizes.png")
    figures.confusion(found, images / "gap-check-confusion.png")
    figures.limits(found, images / "gap-check-limits.png")
    kinds = ", ".join(f"{count} {kind}" for kind, count in found["kinds"].items())
    lines = [
        "# Blind check of the diagnosis",
        "",
        f"{found['sets']} data sets of the stream `{found['stream']}`, numbers {found['first']} to "
        f"{found['last']}: {kinds}; {found['changed']} of them under changed conditions (below). "
        "This command made the results and this page:",
        "",
        "```",
        f"pamrig gap check --stream {found['stream']} --sets {found['first']}-{found['last']} "
        "--page docs/evidence/gap-check.md",
        "```",
        "",
        "You can stop it at any time; the next start continues it. To try it on a few sets:",
        "",
        "    pamrig gap check --sets 1,5 --no-baselines --jobs 1 --out few",
        "",
        NOTE,
        "## Scores and targets",
        "",
        *headline_table(found),
        "",
        f"Processor time per set: median {found['seconds_median']} s, "
        f"maximum {found['seconds_most']} s. "
        f"Calibration error before bias correction: {found['calibration_error']}.",
        "",
        f"![Rates over the size of the gap]({folder}/gap-check-sizes.png)",
        "",
        f"![Reliability of stated probabilities]({folder}/gap-check-reliability.png)",
        *baseline_table(found),
        *effect_table(found),
        "",
        f"![Limit of diagnosis]({folder}/gap-check-limits.png)",
        "",
        f"![Confusion of families]({folder}/gap-check-confusion.png)",
        "",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")


FORMS_NOTE = """The sets come in pairs: the same bench, protocols, sizes in floors and noise, once
with a form of the hidden effect that practice sets have (`beside`) and once with a form that
neither the diagnosis nor its tests nor its learnt reliability has met (`held_out`). Equations and
sources of all forms: [forms of the blind bench](blind-forms.md). Sets without an effect of the
catalogue (nominal, outside, unfit) have no form: they are diagnosed once and count on both sides.
Intervals are Wilson intervals at 95 %. Scores are those of the [blind check](gap-check.md).
"""


def write_forms_page(path: Path, found: dict[str, Any]) -> None:
    """Write the page of seen and held-out forms side by side."""
    forms = found["forms"]
    lines = [
        "# Forms held out",
        "",
        f"{forms['seen_sets']} sets with seen forms and {forms['held_out_sets']} with held-out "
        f"ones, numbers {found['first']} to {found['last']} of their streams. Made by:",
        "",
        "```",
        f"pamrig gap check --held-out --sets {found['first']}-{found['last']} "
        "--out out/held-out --page docs/evidence/gap-check-forms.md",
        "```",
        "",
        FORMS_NOTE,
        "| score | seen forms | held-out forms |",
        "|---|---|---|",
        *(
            f"| {line['figure']} | {cell(line['seen'])} | {cell(line['held_out'])} |"
            for line in forms["figures"]
        ),
        "",
        "## By form",
        "",
        "Singles of at least 1.5 floors without a confounder. Forms from 3 on are held out.",
        "",
        "| effect | form | sets | right family | right name | wrong name |",
        "|---|---|---|---|---|---|",
        *(
            f"| {e['effect']} | {e['form']} | {e['sets']} | {e['family']} | {e['named']} "
            f"| {e['wrong']} |"
            for e in forms["by_form"]
        ),
        "",
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines), encoding="utf-8")
