"""Valve controller firmware: runs under MicroPython and CPython alike."""

VERSION = "0.1.0"
