"""Drivers of instruments and actuators, and the event loop that serves their links."""
