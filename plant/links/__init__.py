"""Dynamics of serial arms with revolute joints.

`reader.load_arm` reads an arm, `dynamics` computes with it, `motion` moves it, `lagrange` derives
its equations in symbols (needs the extra `symbolic`), `kernel` holds what is compiled.
"""

from plant.links.arm import Arm, Link
from plant.links.errors import LinkError
from plant.links.reader import load_arm

__all__ = ["Arm", "Link", "LinkError", "load_arm"]
