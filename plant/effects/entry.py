"""What an entry of the catalogue of effects says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect: a number within bounds, or a word out of `choices`.

    `default` None means that it must be given.
    """

    name: str
    unit: str
    meaning: str
    low: float = 0.0
    high: float = 0.0
    default: float | str | None = None
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Entry:
    """One effect: where it acts, its parameters (the headline first) and how to recognise it.

    `equation` is what it adds to the nominal plant, in the symbols of its parameters; `source`
    where that form comes from.
    """

    id: str
    family: str
    stage: str
    summary: str
    parameters: tuple[Parameter, ...]
    untouched: str
    mistaken_for: tuple[str, ...]
    told_apart_by: str
    equation: str
    source: str

    @property
    def headline(self) -> str | None:
        """Name of the headline parameter; None for an effect that is there or not."""
        return self.parameters[0].name if self.parameters else None

    @property
    def unit(self) -> str:
        """Unit of the headline parameter."""
        return self.parameters[0].unit if self.parameters else ""
