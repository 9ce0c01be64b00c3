"""Firmware of the valve controller, for MicroPython and CPython."""

VERSION = "0.2.1"
