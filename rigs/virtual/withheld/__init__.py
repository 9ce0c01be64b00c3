"""A virtual bench whose effects are kept secret, for blind checks of investigations."""
