"""Commands on recorded runs and pictures."""
