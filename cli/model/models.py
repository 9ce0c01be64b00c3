"""`pamrig fit` and `pamrig models list|compare|audit-thesis|rotary`."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.completion import model_names, run_names
from cli.model.rotary import rotary
from cli.options import RUNS, FigureOption, JsonOption, RegionOption, RunsOption, WarmOption
from cli.output import writing
from cli.progress import progress_line
from daq.errors import PamrigError
from daq.wholefile import write_whole

if TYPE_CHECKING:
    from plant.fitting.data import Points
    from plant.fitting.scale import Scaling
    from plant.models.model import Geometry, Model

PRESETS = ("table-4-3",)
RestOption = Annotated[
    float | None,
    typer.Option(
        "--rest-length-mm",
        "--rest-length",
        min=1.0,
        max=1e5,
        help="Length in mm, slack and without pressure.",
    ),
]
DiameterOption = Annotated[
    float | None,
    typer.Option(
        "--diameter-mm", "--diameter", min=0.1, max=1e4, help="Inner diameter in mm at that length."
    ),
]
LeastOption = Annotated[
    float | None,
    typer.Option(
        "--least-force-n",
        "--least-force",
        help="Points with less force in N are slack and left out.",
    ),
]
MAX_SUBSET_COLUMNS = 10


def add_models(app: typer.Typer) -> None:
    """Add the commands of `pamrig models`."""
    app.command("list")(list_models)
    app.command("compare")(compare)
    app.command("audit-thesis")(audit_thesis)
    app.command("rotary")(rotary)


def fit(
    run: Annotated[
        str,
        typer.Argument(
            help="Run folder, run id, 'last', or a thesis table: c01.", autocompletion=run_names
        ),
    ],
    model: Annotated[
        str,
        typer.Option("--model", help="Model name, or a model file.", autocompletion=model_names),
    ],
    free: Annotated[
        str, typer.Option(help="Parameters to fit, separated by commas; default: all not fixed.")
    ] = "",
    start: Annotated[str, typer.Option(help="Start values, or values to hold: a=1,b=2.")] = "",
    rest_length: RestOption = None,
    diameter: DiameterOption = None,
    least_force: LeastOption = None,
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
    from analysis.models.text import emit, fit_json, fit_text, misfit_text, start_lines
    from plant.errors import PlantError
    from plant.fitting.fit import fit
    from plant.fitting.misfit import with_misfit
    from plant.models import catalogue

    geometry = _geometry(rest_length, diameter)
    try:
        points = _pulling(_region(load_points(run, runs, warm), region), least_force)
        chosen, scaling = _sized(catalogue.load(model), model, points, geometry)
        if start:
            chosen = _within_bounds(chosen.with_values(_numbers(start)))
        names = tuple(n.strip() for n in free.split(",") if n.strip()) or None
        if least_force is not None:
            chosen = dataclasses.replace(chosen, pulls_only=True)
        with progress_line(f"fitting {model} to {run}"):
            found, sizes = with_misfit(fit(chosen, points, free=names, robust=robust), points)
    except PlantError as error:
        raise PamrigError(
            f"fit of {model} to {run}", str(error), "see `pamrig models list`"
        ) from None
    if out is not None:
        note = f"Fitted by pamrig fit to {found.model.data}."
        with writing(out):
            write_whole(out, catalogue.to_toml(found.model, note))
    if figure is not None:
        from analysis.models.figures import fit_figure

        _save(fit_figure(found, points), figure)
    if as_json:
        emit(fit_json(found, points))
        return
    typer.echo(fit_text(found, points))
    typer.echo(misfit_text(sizes, found.model))
    for line in start_lines([scaling]):
        typer.echo(line)
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
        str, typer.Option(help="Groups: length, pressure, temperature, mounting or load.")
    ] = "length",
    start: Annotated[
        str, typer.Option(help="Model files whose values are the start values of their laws.")
    ] = "",
    least_force: LeastOption = None,
    rest_length: RestOption = None,
    diameter: DiameterOption = None,
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
    from analysis.models.text import (
        comparison_json,
        comparison_text,
        pressures_text,
        start_lines,
    )
    from plant.errors import PlantError
    from plant.fitting.compare import compare, compare_pressures
    from plant.fitting.data import joined
    from plant.models import catalogue

    if not data:
        raise PamrigError("pamrig models compare", "no data", "name runs or thesis tables: c01")
    geometry = _geometry(rest_length, diameter)
    try:
        points = _region(joined([load_points(name, runs, warm) for name in data]), region)
        points = _pulling(points, least_force)
        training = _region(load_points(train, runs, warm), region) if train else None
        training = _pulling(training, least_force) if training else None
        named = [n.strip() for n in models.split(",") if n.strip()]
        chosen = [(n, catalogue.load(n)) for n in named]
        chosen = chosen or [(m.name, m) for m in _suitable(training or points)]
        sized = [_sized(m, name, training or points, geometry) for name, m in chosen]
        starting = _started([m for m, _ in sized], start)
        doing = f"comparing {len(starting)} models on {len(points.force_n)} points"
        if holdout == "pressure":
            _refuse_for_pressure(nested=nested, train=bool(train), figure=figure is not None)
            with progress_line(doing):
                held = compare_pressures(starting, points)
        else:
            with progress_line(doing):
                found = compare(starting, points, holdout, nested, training)
    except PlantError as error:
        raise PamrigError(" ".join(data), str(error), "see docs/use/models.md") from None
    notes = start_lines([scaling for _, scaling in sized])
    if holdout == "pressure":
        _print(comparison_json(held), pressures_text(held), notes, as_json)
        return
    if figure is not None:
        from analysis.models.figures import comparison_figure

        _save(comparison_figure(found), figure)
    drawn = [f"figure: {figure}"] if figure is not None else []
    _print(comparison_json(found), comparison_text(found), [*notes, *drawn], as_json)


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
    typer.echo(f"{'model':16}{'kPa':>9}{'°C':>7}{'Table 4-3':>11}{'C-39..44':>10}"
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


def _print(value: Any, text: str, notes: list[str], as_json: bool) -> None:
    if as_json:
        from analysis.models.text import emit

        emit(value)
        return
    typer.echo("\n".join([text, *notes]))


def _geometry(rest_length: float | None, diameter: float | None) -> Geometry | None:
    from plant.models.model import Geometry

    if rest_length is None and diameter is None:
        return None
    if rest_length is None or diameter is None:
        given, other = ("--diameter-mm", "--rest-length-mm")[:: 1 if rest_length is None else -1]
        raise PamrigError(given, f"{other} is missing", "state both: they give the gas volume")
    return Geometry(rest_length, diameter)


def _pulling(points: Points, least_force: float | None) -> Points:
    return points if least_force is None else points.pulling(least_force)


def _sized(
    model: Model, given: str, points: Points, geometry: Geometry | None
) -> tuple[Model, Scaling]:
    """A shipped model scaled to the muscle of the points; a model file keeps its own values."""
    from plant.fitting.scale import Scaling, scaled

    if not given.endswith(".toml"):
        return scaled(model, points, geometry)
    model = dataclasses.replace(model, geometry=geometry or model.geometry)
    return model, Scaling(1.0, 1.0, None, False)


def _within_bounds(model: Model) -> Model:
    for p in model.parameters:
        if not p.low <= p.value <= p.high:
            raise PamrigError(
                f"--start {p.name}={p.value:g}",
                f"outside its bounds {p.low:g} to {p.high:g} {p.unit}",
                "choose a value inside, or edit the bounds in a model file",
            )
    return model


def _started(models: list[Model], start: str) -> list[Model]:
    """The models with the values and bounds of these model files, each for its own law."""
    from plant.models import catalogue

    for path in (n.strip() for n in start.split(",") if n.strip()):
        given = catalogue.load(path)
        if not any(m.law is given.law for m in models):
            raise PamrigError(
                f"--start {path}",
                f"its law is not among {', '.join(m.name for m in models)}",
                "name its model in --models",
            )
        models = [
            dataclasses.replace(m, parameters=given.parameters) if m.law is given.law else m
            for m in models
        ]
    return models


def _refuse_for_pressure(**given: bool) -> None:
    for name, present in given.items():
        if present:
            raise PamrigError(
                "--holdout pressure", f"cannot be combined with --{name}", f"leave out --{name}"
            )


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
        write_whole(path, as_svg(figure) if path.suffix == ".svg" else as_png(figure))
