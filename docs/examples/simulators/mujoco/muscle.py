"""A pneumatic cylinder of MuJoCo as the force stage: `pip install mujoco`.

MuJoCo's cylinder actuator holds the pressure as an activation that follows its control with a time
constant; the force is area times pressure. The area of a muscle changes with its length: it is set
before each step.
"""

import mujoco
import numpy as np

BRAID_M, TURNS = 0.085, 1.75
MODEL = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="end" type="slide" axis="1 0 0"/>
      <geom size="0.01" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <cylinder name="muscle" joint="end" area="1" timeconst="0.01"/>
  </actuator>
</mujoco>
"""


def force(inputs, parameters):
    """Force in N at every inputs["time_s"]."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    model.actuator_dynprm[0, 0] = parameters["lag_s"]
    t, pressure = inputs["time_s"], inputs["pressure_kpa"] * 1e3
    length = inputs["length_mm"] * 1e-3
    area = (3 * length**2 - BRAID_M**2) / (4 * np.pi * TURNS**2)
    data.act[0] = pressure[0]
    made = np.empty(len(t))
    made[0] = area[0] * pressure[0]
    for k in range(1, len(t)):
        model.opt.timestep = t[k] - t[k - 1]
        data.ctrl[0] = pressure[k]
        data.qpos[:], data.qvel[:] = 0.0, 0.0  # the end of the muscle is held
        mujoco.mj_step(model, data)
        made[k] = area[k] * data.act[0]
    return made
