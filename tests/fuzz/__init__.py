"""Fuzzing: inputs that nobody would write, for everything that reads bytes of others."""
