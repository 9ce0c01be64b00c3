"""What the link dynamics say when they are given an arm that cannot be."""

from plant.errors import PlantError


class LinkError(PlantError):
    """An arm, link, joint or state that cannot be: names it, what was expected and what came."""
