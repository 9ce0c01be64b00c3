"""Drivers of what sets the length: linear stages of several manufacturers, a module a protocol."""
