"""A control law of one's own, against gravity, on the embedded arm."""

import numpy as np

import mbd_ros as mbd
from mbd_ros.methods.control.contract import Control, Controller, EffortBox, Reference, per_joint


class Spring(Controller):
    """Pulls every joint to its reference, and carries its weight.

    Args:
        joints: What it controls.
        stiffness: Acceleration per error [1/s^2].
    """

    def __init__(self, joints, *, stiffness=100.0):
        self.joints = joints
        self._kp = per_joint(stiffness, len(joints), "stiffness")
        self._kd = 2.0 * np.sqrt(self._kp)

    def effort(self, x, ref, memory, box):
        r = self.joints.response(x)
        wanted = ref.a + self._kd * (ref.v - r.v) + self._kp * (ref.q - r.q)
        effort = np.linalg.solve(r.mobility, wanted - r.a_free)
        return Control(effort, wanted, effort, np.zeros(0), np.zeros(0, dtype=bool))


scene = mbd.load_scene("controlled_arm")
joints, simulation = scene.controlled_joints(), scene.simulation()
law, system, period = Spring(joints), simulation.system, 0.005
rest = np.zeros(len(joints))
goal = Reference(joints.positions(scene.initial) + 0.2, rest, rest)

y = simulation.start(scene.initial)
for k in range(400):
    u = law.effort(system.expand(y), goal, law.begin(), EffortBox(rest - 50.0, rest + 50.0)).effort
    y = simulation.advance(y, u, (k + 1) * period)
error = np.abs(joints.positions(system.expand(y)) - goal.q).max()
print(f"after {y.t:.3g} s: {error:.1e} rad from the goal")
