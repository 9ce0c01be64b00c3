"""Commands for recorded runs and pictures."""
