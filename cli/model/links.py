"""What `pamrig links` does."""

from __future__ import annotations

import typer

from daq.errors import ConfigError
from plant.links.errors import LinkError


def links_command(arm: str, form: str) -> None:
    """Print an arm's equations as text, LaTeX or Python source.

    Raises:
        ConfigError: the arm cannot be read, the form is unknown, or SymPy is missing.
    """
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
