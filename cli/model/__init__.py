"""Commands that fit and compare muscle models, and derive equations of motion."""
