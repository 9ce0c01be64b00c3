"""`pamrig gap effects`: the catalogue as a table, or one entry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.options import JsonOption
from cli.output import print_json

if TYPE_CHECKING:
    from plant.effects.effect import Effect, Parameter


def effects(
    name: Annotated[str, typer.Argument(help="One effect; default: all.")] = "",
    as_json: JsonOption = False,
) -> None:
    """The catalogue of effects: what each adds, its parameters, how to tell it from others."""
    from plant.effects.catalogue import CATALOGUE
    from plant.effects.effects import Effects
    from plant.errors import PlantError

    try:
        if name and name not in CATALOGUE:
            Effects.from_config({name: {}})
    except PlantError as error:
        from gap.errors import GapError

        raise GapError("gap effects", str(error).removeprefix("effects: ")) from None
    entries = [CATALOGUE[name]] if name else list(CATALOGUE.values())
    if as_json:
        values = [_plain(entry) for entry in entries]
        print_json(values[0] if name else values)
    elif name:
        typer.echo(_page(entries[0]))
    else:
        typer.echo(f"{'effect':24}{'stage':9}{'family':17}amount (unit)")
        for entry in entries:
            headline = f"{entry.headline} ({entry.unit or '1'})" if entry.headline else "-"
            typer.echo(f"{entry.id:24}{entry.stage:9}{entry.family:17}{headline}")


_PAGE = (
    "id", "family", "stage", "summary", "parameters", "untouched", "mistaken_for", "told_apart_by",
    "equation", "source", "standard", "constants",
)  # fmt: skip


def _plain(entry: Effect) -> dict[str, Any]:
    values: dict[str, Any] = {name: getattr(entry, name) for name in _PAGE}
    for name in ("mistaken_for", "constants"):
        values[name] = list(values[name])
    values["parameters"] = [{**vars(p), "choices": list(p.choices)} for p in entry.parameters]
    return values


def _page(entry: Effect) -> str:
    lines = [
        f"{entry.id} ({entry.family}, {entry.stage})",
        f"  {entry.summary}",
        f"  adds        {entry.equation}",
        f"  source      {entry.source}",
    ]
    lines += [f"  {_parameter(p)}" for p in entry.parameters]
    lines += [
        f"  unaffected  {entry.untouched}",
        f"  similar     {', '.join(entry.mistaken_for) or 'none'}",
        f"  distinguish {entry.told_apart_by}",
        f"  constants   {', '.join(entry.constants) or 'none'}",
        f"  standard    {entry.standard}",
    ]
    return "\n".join(lines)


def _parameter(p: Parameter) -> str:
    allowed = ", ".join(p.choices) if p.choices else f"{p.low:g} to {p.high:g}"
    unit = f" {p.unit}" if p.unit else ""
    default = "" if p.default is None else f", default {p.default:g}"
    return f"parameter   {p.name}: {p.meaning}; {allowed}{unit}{default}"
