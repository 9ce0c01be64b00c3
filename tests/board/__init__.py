"""The firmware on an emulated RP2040: its time, its memory and its safety, measured from outside.

The real MicroPython image runs on an emulated chip with the firmware's real files. The host's
side of the wire, the converter and the pins are the test's own.
"""
