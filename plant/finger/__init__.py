"""The finger: links driven by antagonistic pairs of muscles, each with its own valve block.

`reader.load_finger` reads a finger, `sim.FingerSim` simulates it in compiled code (`kernel`).
"""

from plant.finger.body import Finger, Pair
from plant.finger.reader import load_finger
from plant.finger.sim import FingerSim

__all__ = ["Finger", "FingerSim", "Pair", "load_finger"]
