"""`pamrig gap effects`: the catalogue, as a table or entry by entry."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from plant.effects.effect import Effect, Parameter


def gap_effects(
    name: Annotated[str, typer.Argument(help="One effect; all of them without it.")] = "",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON value, nothing else.")
    ] = False,
) -> None:
    """The catalogue of effects: what each adds, its parameters, what tells it from others."""
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
        typer.echo(json.dumps(values[0] if name else values, indent=2, allow_nan=False))
    elif name:
        typer.echo(_page(entries[0]))
    else:
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
        f"  after       {entry.source}",
    ]
    lines += [f"  {_parameter(p)}" for p in entry.parameters]
    lines += [
        f"  untouched   {entry.untouched}",
        f"  mistaken    {', '.join(entry.mistaken_for) or 'for none'}",
        f"  constants   {', '.join(entry.constants) or 'none'}",
        f"  told apart  {entry.told_apart_by}",
        f"  standard    {entry.standard}",
    ]
    return "\n".join(lines)


def _parameter(p: Parameter) -> str:
    allowed = ", ".join(p.choices) if p.choices else f"{p.low:g} to {p.high:g}"
    unit = f" {p.unit}" if p.unit else ""
    default = "" if p.default is None else f", else {p.default:g}"
    return f"parameter   {p.name}: {p.meaning}; {allowed}{unit}{default}"
