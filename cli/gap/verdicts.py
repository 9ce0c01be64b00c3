"""`pamrig gap where|diagnose|shrink|next|report`: diagnose a data set and print the result."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from cli.output import print_json, writing
from cli.progress import progress_line
from daq.progress import stage
from daq.wholefile import write_whole
from gap.data.dataset import DataSet
from gap.decision.diagnosis import Diagnosis, diagnosis
from gap.design.config import DESIGN
from gap.output import check_out, write_text
from gap.reporting.empirical import empirical_lines
from gap.reporting.text import barely_enough
from gap.simulators.open import open_data_with
from gap.verdict import Experiment, Gap, Status, Verdict, plain


def _ids(text: str) -> list[str]:
    """Ids in a comma-separated list."""
    return [word.strip() for word in text.split(",") if word.strip()]


def _summary(verdict: Verdict) -> str:
    return f"{verdict.status.replace('_', ' ')}: {verdict.reason}"


@dataclass(frozen=True)
class Question:
    """What a command is about: data, effects to strike, a simulator; `keep` to use the cache."""

    data: Path
    without: str = ""
    simulator: Path | None = None
    keep: bool = True

    def answer(self) -> Diagnosis:
        """The diagnosis."""
        return self.read()[1]

    def read(self) -> tuple[DataSet, Diagnosis]:
        """The data set with its simulator, and the diagnosis."""
        with progress_line("diagnosing"):
            stage(f"reading {self.data.name}")
            data = open_data_with(self.data, self.simulator)
            return data, diagnosis(data, _ids(self.without), self.keep)


def diagnose_command(question: Question, as_json: bool) -> None:
    """`pamrig gap diagnose`."""
    verdict = question.answer().verdict
    if as_json:
        print_json(verdict.as_dict())
    else:
        typer.echo("\n".join(_verdict_text(verdict)))
    _refuse(verdict)


def _refuse(verdict: Verdict) -> None:
    """End with status 2 where the nominal plant is that of another muscle: there is no result."""
    if verdict.status is Status.NOMINAL_UNFIT:
        raise typer.Exit(2)


def where_command(question: Question, out: Path | None, as_json: bool) -> None:
    """`pamrig gap where`: stages, comparisons, and curves of the residual."""
    from gap.reporting.map_figures import check_picture, write_courses
    from gap.validation.maps import residual_maps
    from gap.validation.where import MEANING, stage_errors

    check_picture(out)
    answer = question.answer()
    verdict, problem, fit = answer.verdict, answer.problem, answer.fit
    found = stage_errors(problem, fit) if problem is not None and fit is not None else None
    courses = residual_maps(problem, fit) if problem is not None and fit is not None else []
    drawn = out is not None and bool(courses)
    if out is not None and drawn:
        write_courses(courses, bool(verdict.effects), out)
    table = verdict.as_dict()
    if as_json:
        print_json(
            {
                "where": table["where"], "gap": table["gap"], "status": table["status"],
                "reason": table["reason"], "meaning": MEANING, **plain(found or {}),
                "maps": [plain(course.as_dict()) for course in courses],
                "figure": str(out) if drawn else None,
            }
        )  # fmt: skip
        return
    lines = [_summary(verdict)]
    if verdict.stages:
        lines.append("share of the end-to-end gap by stage (Shapley; 95 % interval over slots)")
    if problem is not None:
        lines += _where_text(verdict) or ["no stage and no comparison stands out"]
    if found:
        lines.append("end to end, commands replayed    rms    floor")
        lines += [
            f"  {e['end']:9s}  {e['rms']:15.3g} {e['unit']:3s}  {e['floor']:.3g}"
            for e in found["end_to_end"]
        ]
        lines.append("stage by stage, measured inputs  rms    floor")
        lines += [
            f"  {r['block']:9s}  {r['recalibrated']:15.3g} {r['unit']:3s}  {r['floor']:.3g}"
            for r in found["stage_by_stage"]
        ]
    if drawn:
        lines.append(f"residual over pressure, length, temperature and time: {out}")
    elif out is not None:
        lines.append(f"{out} was not written: there is no residual to draw")
    typer.echo("\n".join(lines))
    _refuse(verdict)


def shrink_command(question: Question, out: Path | None, as_json: bool) -> None:
    """`pamrig gap shrink`: the gap before and after, by block and by what was held out."""
    from gap.validation.improved_simulator import improved_text
    from gap.validation.shrinkage import as_lines, shrinkage

    check_out(out)
    answer = question.answer()
    verdict, problem, fit = answer.verdict, answer.problem, answer.fit
    table = verdict.as_dict()
    # An effect that the verdict does not stand by is no improvement of the plant.
    named = (
        verdict.status.explained
        and problem is not None
        and fit is not None
        and bool(verdict.effects)
        and set(problem.fitted(verdict.effects[0].ids)) == set(fit.ids)
    )
    # A term that was fitted beside such effects does not hold without them.
    term = verdict.empirical if named or not verdict.status.explained else None
    found: dict[str, Any] = {}
    if problem is not None and fit is not None:
        kept = fit if named else problem.base
        found = plain(shrinkage(problem, kept, named))
        if out is not None:
            folder = out.absolute().parent
            write_text(out, improved_text(problem, kept, folder, term))
    written = out if found else None
    if as_json:
        print_json(
            {
                "gap": table["gap"], "status": table["status"], "effects": table["effects"],
                **(found or {"held_out": {}}), "empirical": table["empirical"],
                "plant": str(written) if written else None,
            }
        )  # fmt: skip
        return
    lines = [_summary(verdict), *_gap_text(verdict)]
    lines += as_lines(found) if found else []
    lines += empirical_lines(verdict)
    if written is not None:
        plant = "improved" if named or term else "recalibrated"
        lines.append(f"{plant} plant written to {written}")
    elif out is not None:
        lines.append(f"{out} was not written: these data do not improve the plant")
    typer.echo("\n".join(lines))
    _refuse(verdict)


def next_command(question: Question, out: Path | None, as_json: bool) -> None:
    """`pamrig gap next`."""
    from gap.design.advise import protocol_text

    check_out(out)
    answer = question.answer()
    verdict = answer.verdict
    experiment = verdict.next_experiment
    rig = _rig_of(question.data)
    written = None
    if experiment is not None and out is not None:
        text = protocol_text(experiment)
        if text is not None:
            write_text(out, text)
            written = str(out)
    if as_json:
        table = verdict.as_dict()
        print_json(
            {
                "status": table["status"], "next_experiment": table["next_experiment"],
                "protocol_file": written,
            }
        )  # fmt: skip
        return
    lines = _next_text(verdict, written, rig)
    if out is not None and written is None:
        lines.append(f"{out} was not written: the advice is not a test protocol")
    typer.echo("\n".join(lines))


def report_command(
    question: Question, out: Path, as_json: bool, pdf: Path | None = None,
    figures: Path | None = None,
) -> None:  # fmt: skip
    """`pamrig gap report`: the diagnosis as an HTML page, as PDF, and its figures as files."""
    from analysis.reporting.figure_files import write_figures
    from analysis.reporting.pdf import page_to_pdf
    from gap.reporting.examination import examine
    from gap.reporting.report import report_figures, write_report
    from gap.reporting.text import headline

    check_out(out)
    check_out(pdf)
    data, found = question.read()
    examined = examine(data, found=found)
    page = write_report(examined, out)
    if pdf is not None:
        with writing(pdf):
            write_whole(pdf, page_to_pdf(page))
    files: list[Path] = []
    if figures is not None:
        with writing(figures):
            files = write_figures(report_figures(examined), figures)
    if as_json:
        print_json({"report": str(out), "verdict": examined.verdict.as_dict()})
        return
    typer.echo(headline(examined.verdict))
    typer.echo(f"report   {out}")
    for path in (pdf, *files):
        if path is not None:
            typer.echo(f"         {path}")


def _rig_of(data: Path) -> str:
    """The rig that the data were recorded on, as --rig takes it; "" where it is not known."""
    from daq.errors import RecordError
    from daq.store.run import Run

    try:
        rig = Run(data).manifest.get("rig") or {}
    except RecordError:
        return ""
    source = str(rig.get("source") or "")
    shipped = source.startswith("configs/rigs/") and not Path(source).exists()
    return Path(source).stem if shipped else source


def _separated(verdict: Verdict, experiment: Experiment) -> bool:
    """Whether the data tell the best explanation from its nearest rival already."""
    named = verdict.status in (Status.NAMED, Status.NAMED_FORM_INADEQUATE)
    return named and not verdict.leads and experiment.separation_now >= DESIGN.enough_sd


def _next_text(verdict: Verdict, written: str | None, rig: str) -> list[str]:
    lines = [_summary(verdict)]
    experiment = verdict.next_experiment
    if experiment is None:
        return [*lines, "next        no experiment of the library would resolve what is open"]
    if _separated(verdict, experiment) and written is None:
        return [
            *lines,
            f"next        nothing needed: {' and '.join(experiment.between)} are "
            f"{experiment.separation_now:.1f} standard deviations apart already",
            f"            to be surer still: {experiment.why}",
        ]
    settings = ", ".join(f"{k} {v}" for k, v in experiment.settings.items())
    lines.append(f"next        {experiment.trials} x {experiment.protocol} ({settings})")
    if math.isfinite(experiment.separation_after):
        lines.append(
            f"separation  {experiment.separation_now:.1f} now, {experiment.separation_after:.1f} "
            f"after ({' against '.join(experiment.between)})"
        )
        barely = barely_enough(experiment)
        if barely:
            lines.append(f"            {barely}")
    lines.append(f"why         {experiment.why}")
    if written:
        lines.append(
            f"written     {written}; run it with pamrig {experiment.protocol} --rig {rig or 'RIG'}"
            f" --protocol {written}"
        )
    return lines


def _verdict_text(verdict: Verdict) -> list[str]:
    lines = [_summary(verdict)]
    if verdict.stage:
        lines.append(f"stage       {verdict.stage}")
    for effect in verdict.effects:
        values = ", ".join(_estimate(name, e) for name, e in effect.parameters.items())
        lines.append(f"  {100 * effect.probability:3.0f} %  {verdict.label(effect)}  {values}")
    lines.append(f"  {100 * verdict.probability_none:3.0f} %  no gap")
    lines.append(f"  {100 * verdict.probability_unknown:3.0f} %  something else")
    notes = [f"note        {note}" for note in verdict.notes]
    return [
        *lines, *_gap_text(verdict), *empirical_lines(verdict), *_where_text(verdict), *notes
    ]  # fmt: skip


def _estimate(name: str, estimate: Any) -> str:
    if isinstance(estimate.value, str):
        return f"{name} {estimate.value}"
    if estimate.low is None:
        return f"{name} {estimate.value:.4g}"
    return f"{name} {estimate.value:.4g} ({estimate.low:.4g} to {estimate.high:.4g})"


def _gap_text(verdict: Verdict) -> list[str]:
    gap = verdict.headline_gap
    if gap is None:
        return []
    lines = [_gap_line("gap", gap)]
    if gap.closed is not None and gap.closed < 0.0:
        lines.append("closed      nothing: held out, the effects predict no better than the plant")
    elif gap.closed is not None and gap.closed_low is not None and gap.closed_high is not None:
        ends = [f"{100 * end:.0f}" for end in (gap.closed_low, gap.closed_high)]
        between = f" ({ends[0]} to {ends[1]} %)" if ends[0] != ends[1] else ""
        lines.append(f"closed      {100 * gap.closed:.0f} % of the gap{between}")
    return lines + [_gap_line("", other) for other in verdict.channels[1:]]


def _gap_line(name: str, gap: Gap) -> str:
    return (
        f"{name:12}rms error as stated {gap.before:.3g}, recalibrated {gap.recalibrated:.3g}"
        + (f", with the effects {gap.after:.3g}" if gap.after is not None else "")
        + (f", noise floor {gap.floor:.3g}" if gap.floor is not None else "")
        + f" {gap.unit} "
        + (f"(held out by {gap.held_out})" if gap.held_out else "(one setting: nothing held out)")
    )


def _where_text(verdict: Verdict) -> list[str]:
    lines = [
        f"share       {s.stage} {100 * s.share:.0f} % ({100 * s.low:.0f} to {100 * s.high:.0f})"
        for s in verdict.stages
    ]
    return lines + [f"contrast    {c.name} z = {c.z:.1f}" for c in verdict.contrasts if c.alarm]
