"""`pamrig links`."""

from __future__ import annotations

from typing import Annotated

import typer

from daq.errors import ConfigError


def links(
    arm: Annotated[str, typer.Argument(help="Arm file, or the name of a shipped one.")],
    form: Annotated[str, typer.Option("--print", help="text, latex or python.")] = "text",
) -> None:
    """Derive an arm's equations of motion and print them."""
    from plant.errors import LinkError
    from plant.links.reader import load_arm
    from plant.links.symbolic.generated import generated_source, require_sympy

    try:
        loaded = load_arm(arm)
        if form == "python":
            typer.echo(generated_source(loaded), nl=False)
            return
        require_sympy()
        from plant.links.symbolic.lagrange import derive
        from plant.links.symbolic.printing import FORMS, printed

        if form not in FORMS:
            raise LinkError(f"--print {form!r}: choose one of {', '.join(FORMS)}")
        typer.echo(printed(derive(loaded), form), nl=False)
    except LinkError as error:
        what, _, remedy = str(error).partition("; ")
        raise ConfigError("links", what, remedy) from None
