"""Commands that simulate benches, fingers and controllers."""
