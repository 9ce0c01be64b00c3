"""Dynamics of serial arms with revolute joints.

`reader.load_arm` reads an arm, `dynamics` computes torques and accelerations, `motion` simulates
it, `symbolic` derives its equations (needs the extra `symbolic`), `kernel` is the compiled code.
"""

from plant.errors import LinkError
from plant.links.arm import Arm, Link
from plant.links.reader import load_arm

__all__ = ["Arm", "Link", "LinkError", "load_arm"]
