"""Proportional pulse-width modulation of inlet and outlet (5.7.3, Figure 5-12, version 9)."""

from valvefw.schemes.inletduty import InletDuty


class BothDuty(InletDuty):
    """As ``InletDuty``, but below the dead zone the outlet is pulsed by the same rule."""

    name = "duty"
    both = True
