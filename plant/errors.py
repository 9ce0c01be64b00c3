"""What the physics says when it is asked for something outside its domain."""


class PlantError(ValueError):
    """A constant, effect or argument that the plant cannot take: names it, and what is allowed."""
