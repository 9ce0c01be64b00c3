"""What the physics says when it is asked for something outside its domain."""

from __future__ import annotations


class PlantError(ValueError):
    """A constant, effect or argument that the plant cannot take: names it, and what is allowed."""


class LinkError(PlantError):
    """An invalid arm, link, joint or state; names it, the expected and the given value."""
