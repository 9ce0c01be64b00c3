"""`pamrig fit` and `pamrig models list|compare|audit-thesis`."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.options import RUNS, FigureOption, JsonOption, RegionOption, RunsOption, WarmOption
from cli.output import writing
from daq.errors import PamrigError

if TYPE_CHECKING:
    from plant.fitting.data import Points
    from plant.models.model import Model

PRESETS = ("table-4-3",)
MAX_SUBSET_COLUMNS = 10


def add_models(app: typer.Typer) -> None:
    """Add the commands of `pamrig models`."""
    app.command("list")(list_models)
    app.command("compare")(compare)
    app.command("audit-thesis")(audit_thesis)


def fit(
    run: Annotated[str, typer.Argument(help="Run folder, run id, 'last', or a thesis table: c01.")],
    model: Annotated[str, typer.Option("--model", help="Model name, or a model file.")],
    free: Annotated[
        str, typer.Option(help="Parameters to fit, separated by commas; default: all not fixed.")
    ] = "",
    start: Annotated[str, typer.Option(help="Start values, or values to hold: a=1,b=2.")] = "",
    region: RegionOption = "",
    robust: Annotated[
        bool, typer.Option("--robust", help="Reduce the weight of outliers.")
    ] = False,
    warm: WarmOption = False,
    tables: Annotated[
        bool, typer.Option("--tables", help="Regression tables of a model that is a sum of terms.")
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Model file to write.")] = None,
    figure: FigureOption = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Fit a muscle model to a run: values, intervals, and what the data do not determine."""
    from analysis.models.points import load_points
    from analysis.models.text import emit, fit_json, fit_text
    from plant.errors import PlantError
    from plant.fitting.fit import fit
    from plant.models import catalogue

    points = _region(load_points(run, runs, warm), region)
    try:
        chosen = catalogue.load(model)
        if start:
            chosen = chosen.with_values(_numbers(start))
        names = tuple(n.strip() for n in free.split(",") if n.strip()) or None
        found = fit(chosen, points, free=names, robust=robust)
    except PlantError as error:
        raise PamrigError(
            f"fit of {model} to {run}", str(error), "see `pamrig models list`"
        ) from None
    if out is not None:
        note = f"Fitted by pamrig fit to {found.model.data}."
        with writing(out):
            out.write_text(catalogue.to_toml(found.model, note), encoding="utf-8")
    if figure is not None:
        from analysis.models.figures import fit_figure

        _save(fit_figure(found, points), figure)
    if as_json:
        emit(fit_json(found, points))
        return
    typer.echo(fit_text(found, points))
    if tables:
        typer.echo("\n" + _tables(found.model, points))
    for path, what in ((out, "model file"), (figure, "figure")):
        if path is not None:
            typer.echo(f"{what}: {path}")


def list_models(as_json: JsonOption = False) -> None:
    """All models, their parameters and their domain."""
    from analysis.models.text import emit, model_json
    from plant.models import catalogue

    models = [catalogue.get(name) for name in catalogue.names()]
    if as_json:
        emit([model_json(m) for m in models])
        return
    for m in models:
        free = [p.name for p in m.parameters if not p.fixed]
        fixed = [p.name for p in m.parameters if p.fixed]
        typer.echo(f"{m.name:20} {m.title}")
        text = f"{len(free)} to fit: {', '.join(free)}"
        typer.echo(f"{'':20} {text}" + (f"; to measure: {', '.join(fixed)}" if fixed else ""))
        equations = f"equations {', '.join(m.equations)}; " if m.equations else ""
        low, high = m.domain.pressure_kpa
        typer.echo(
            f"{'':20} {equations}{m.source}; fitted to {m.data}: {low:g} to {high:g} kPa, "
            f"{m.domain.length_mm[0]:g} to {m.domain.length_mm[1]:g} mm"
        )


def compare(
    data: Annotated[list[str] | None, typer.Argument(help="Runs or thesis tables.")] = None,
    models: Annotated[
        str, typer.Option(help="Models, separated by commas; default: all suitable ones.")
    ] = "",
    holdout: Annotated[
        str, typer.Option(help="Groups: length, temperature, mounting or load.")
    ] = "length",
    train: Annotated[str, typer.Option(help="Fit to this run or table, score on DATA.")] = "",
    region: RegionOption = "",
    nested: Annotated[
        bool, typer.Option("--nested", help="Also the cost of choosing a model by its score.")
    ] = False,
    warm: WarmOption = False,
    preset: Annotated[str, typer.Option(help="A published comparison: table-4-3.")] = "",
    figure: FigureOption = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Rank models on data not used for their fit; whole groups are held out in turn."""
    if preset:
        _print_preset(preset, as_json)
        return
    from analysis.models.points import load_points
    from analysis.models.text import comparison_json, comparison_text, emit
    from plant.errors import PlantError
    from plant.fitting.compare import compare
    from plant.fitting.data import joined
    from plant.models import catalogue

    if not data:
        raise PamrigError("pamrig models compare", "no data", "name runs or thesis tables: c01")
    try:
        points = _region(joined([load_points(name, runs, warm) for name in data]), region)
        chosen = [catalogue.load(n.strip()) for n in models.split(",") if n.strip()]
        training = _region(load_points(train, runs, warm), region) if train else None
        found = compare(chosen or _suitable(training or points), points, holdout, nested, training)
    except PlantError as error:
        raise PamrigError(" ".join(data), str(error), "see docs/use/models.md") from None
    if figure is not None:
        from analysis.models.figures import comparison_figure

        _save(comparison_figure(found), figure)
    if as_json:
        emit(comparison_json(found))
        return
    typer.echo(comparison_text(found))
    if figure is not None:
        typer.echo(f"figure: {figure}")


def audit_thesis(as_json: JsonOption = False) -> None:
    """Every published figure of the thesis beside the value from its own tables, and why."""
    from analysis.models.text import emit
    from plant.audit.audit import audit

    rows = audit()
    if as_json:
        emit([dataclasses.asdict(row) for row in rows])
        return
    for row in rows:
        typer.echo(f"{row.item}: {row.verdict.upper()}")
        typer.echo(f"    published   {row.published}")
        typer.echo(f"    recomputed  {row.recomputed}")
        cited = f" [{', '.join(row.anomalies)}]" if row.anomalies else ""
        typer.echo(f"    because     {row.reason}{cited}")
    counts = {v: sum(r.verdict == v for r in rows) for v in dict.fromkeys(r.verdict for r in rows)}
    typer.echo("; ".join(f"{n} {v}" for v, n in counts.items()))
    typer.echo("numbers in brackets are entries of plant/data/ANOMALIES.md")


def _print_preset(preset: str, as_json: bool) -> None:
    if preset not in PRESETS:
        raise PamrigError(f"--preset {preset}", "unknown", f"known: {', '.join(PRESETS)}")
    from analysis.models.text import emit
    from plant.fitting.table43 import models, table

    cells = table()
    if as_json:
        emit([dataclasses.asdict(cell) for cell in cells])
        return
    typer.echo("standard deviation of real less model in N; recomputed on C-1 at 51.45 mm")
    typer.echo(f"{'model':16}{'kPa':>9}{'degC':>7}{'Table 4-3':>11}{'C-39..44':>10}"
               f"{'by SEMEAN':>11}{'recomputed':>12}{'on C-2':>8}{'mean':>8}")  # fmt: skip
    for c in cells:
        typer.echo(
            f"{c.model:16}{c.region:>9}{c.temperatures:>7}{c.in_table:>11.3f}"
            f"{c.published.stdev:>10.3f}{c.by_semean:>11.3f}{c.recomputed.stdev:>12.3f}"
            f"{c.on_c2.stdev:>8.3f}{c.recomputed.mean:>8.3f}"
        )
    geometry = models()
    b = geometry["deterministic"].values
    typer.echo(
        f"geometry recovered from the published statistics: b {b['braid_length']:g} mm, n "
        f"{b['turns']:g}; Caldwell's Eff {geometry['Caldwell'].values['efficiency']:g}"
    )
    typer.echo(
        "where C-39..44 and SEMEAN disagree, the data agree with SEMEAN: pamrig models audit-thesis"
    )


def _tables(model: Model, points: Points) -> str:
    from plant.errors import PlantError
    from plant.fitting.tables import best_subsets, regression_of, subsets_text

    try:
        regression, columns = regression_of(model, points)
        text = regression.text()
        if 1 < len(columns) <= MAX_SUBSET_COLUMNS:
            subsets = best_subsets(points.force_n, columns)
            text += "\n\nBest subsets\n\n" + subsets_text(subsets, list(columns))
    except PlantError as error:
        raise PamrigError("--tables", str(error), "leave --tables out") from None
    return text


def _suitable(points: Points) -> list[Model]:
    """The models for the points' pressure range; with temperature only if it varies."""
    import numpy as np

    from plant.models import catalogue

    p = points.pressure_pa
    warm = np.unique(points.temperature_c).size > 2
    region = "-low" if p.max() <= 125.5e3 else "-high" if p.min() >= 149.5e3 else ""
    chosen = []
    for name in catalogue.names():
        model = catalogue.get(name)
        part = "-low" if "-low" in name else "-high" if "-high" in name else ""
        whole = not part and not (region and name.startswith(("black-box", "quasi-static")))
        if model.law.memory or (model.law.uses_temperature and not warm):
            continue
        if part == region or whole:
            chosen.append(model)
    return chosen


def _region(points: Points, region: str) -> Points:
    if not region:
        return points
    try:
        low, high = (float(x) * 1e3 for x in region.split("-"))
    except ValueError:
        raise PamrigError(
            f"--region {region}", "expected LOW-HIGH in kPa", "for example 150-600"
        ) from None
    use = (points.pressure_pa >= low - 1e3) & (points.pressure_pa <= high + 1e3)
    if not use.any():
        raise PamrigError(f"--region {region}", f"{points.source} has no points there", "widen it")
    return points.take(use)


def _numbers(text: str) -> dict[str, float]:
    """Parse NAME=NUMBER,NAME=NUMBER."""
    values = {}
    for word in text.split(","):
        name, _, number = word.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if math.isnan(value):
            raise PamrigError(f"--start {word}", "expected NAME=NUMBER", "for example turns=1.9")
        values[name.strip()] = value
    return values


def _save(figure: Any, path: Path) -> None:
    from analysis.figures.drawing import as_png, as_svg

    with writing(path):
        path.write_bytes(as_svg(figure) if path.suffix == ".svg" else as_png(figure))
