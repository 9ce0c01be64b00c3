"""Drivers of what sets the length: linear stages of several makers, one module a protocol."""
