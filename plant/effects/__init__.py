"""The catalogue of effects and the effects in force."""
