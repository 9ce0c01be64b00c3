"""Error of the link dynamics."""

from plant.errors import PlantError


class LinkError(PlantError):
    """An invalid arm, link, joint or state; names it, the expected and the given value."""
