"""`pamrig import data`: data of others by a mapping file."""

from __future__ import annotations

import importlib.resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import JsonOption
from cli.output import many, print_json
from cli.progress import progress_line

if TYPE_CHECKING:
    from gap.mapping.cost import Costs
    from gap.mapping.write import Imported

SHOWN = 20


def import_data(
    mapping: Annotated[Path, typer.Argument(help="Mapping file (.toml).")],
    out: Annotated[Path | None, typer.Option("--out", help="Data set folder to make.")] = None,
    folder: Annotated[
        Path | None,
        typer.Option("--from", help="Folder of the data files; default: that of the mapping."),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Write nothing; report what was understood, and costs."),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Picture of the first trial (.png, .svg).")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a data set for `pamrig gap` from files of another program, by a mapping file."""
    from gap.errors import GapError
    from gap.mapping.picture import check_picture, draw_first_trial
    from gap.mapping.write import import_data

    if out is None and not dry_run:
        raise GapError("--out", "is missing", "name the folder to make, or add --dry-run")
    if picture is not None:
        check_picture(picture)
    with progress_line(f"importing by {mapping.name}"):
        made = import_data(mapping, out or Path(mapping.stem), folder=folder, dry=dry_run)
    if picture is not None:
        draw_first_trial(made[0].data, picture)
    if as_json:
        print_json({"dry_run": dry_run, "sets": [one.to_dict() for one in made]})
        return
    for one in made:
        _show(one, dry_run)
    if dry_run:
        typer.echo("dry run: nothing was written")


def import_template(
    name: Annotated[str, typer.Argument(help="instron, mts or zwick.")],
    out: Annotated[Path, typer.Option("--out", help="Mapping file to make.")],
) -> None:
    """Write a mapping file to begin with, for the files of a testing machine."""
    from gap.errors import GapError

    shipped = importlib.resources.files("configs") / "mappings"
    names = sorted(e.name.removesuffix(".toml") for e in shipped.iterdir() if ".toml" in e.name)
    if name not in names:
        raise GapError("template", f"{name!r} is not one of {', '.join(names)}")
    text = (shipped / f"{name}.toml").read_text(encoding="utf-8")
    try:
        with out.open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)
    except FileExistsError:
        raise GapError(str(out), "is there already", "choose another name") from None
    except OSError as error:
        raise GapError(str(out), f"cannot be written: {error.strerror}") from None
    typer.echo(f"{out}: change names, units and offset to those of your files")


def _show(one: Imported, dry_run: bool) -> None:
    from daq.live.layout import UNITS

    name = one.muscle or "the data"
    trials = many(len(one.trials), "trial")
    what = f"{name}: {trials} in {many(len(one.replicates), 'slot')}"
    typer.echo(what if dry_run else f"{one.folder}: {trials}, {name}")
    for channel in one.channels:
        rate = f", {channel.rate_hz:.4g} Hz" if channel.rate_hz else ""
        noise = f", noise {channel.noise:.2g}" if channel.noise is not None else ""
        gaps = many(channel.gaps, "gap")
        gaps = f", {gaps} to {channel.longest_gap_s:.3g} s" if channel.gaps else ""
        unit = UNITS.get(channel.name.rpartition("_")[2], "")
        read = "" if channel.name.endswith("_cmd") else "in "
        typer.echo(
            f"  {channel.name} from {channel.column} ({read}{channel.unit}): now {channel.low:.5g} "
            f"to {channel.high:.5g}{unit and f' {unit}'}, {many(channel.samples, 'sample')}{rate}"
            f"{noise}{gaps}"
        )
    for trial in one.trials[:SHOWN]:
        time = "settled points" if trial.duration_s is None else f"{trial.duration_s:.4g} s"
        range_ = (
            ""
            if trial.pressure_low_kpa is None
            else f", {trial.pressure_low_kpa:.4g} to {trial.pressure_high_kpa:.4g} kPa"
        )
        typer.echo(
            f"  trial {trial.name}: {many(trial.rows, 'row')}, {time}{range_}, slot {trial.slot}, "
            f"replicate {trial.replicate}"
        )
    if len(one.trials) > SHOWN:
        typer.echo(f"  ... and {many(len(one.trials) - SHOWN, 'more trial')}")
    groups = [f"{count} of slot {slot}" for slot, count in one.replicates.items() if count > 1]
    typer.echo(f"  replicates: {', '.join(groups[:SHOWN]) or 'none'}")
    if one.costs is not None:
        _show_costs(one.costs)
    for note in one.notes:
        typer.echo(f"  note: {note}")


def _show_costs(costs: Costs) -> None:
    typer.echo(f"  effects that can show: {', '.join(costs.shown) or 'none'}")
    for cost in costs.missing:
        lost = ", ".join(cost.effects) or "nothing by itself"
        families = f" (families {', '.join(cost.families)})" if cost.families else ""
        typer.echo(f"  without {cost.column}, cannot be named: {lost}{families}")
    if costs.together:
        typer.echo(f"  needs several of the missing columns: {', '.join(costs.together)}")
