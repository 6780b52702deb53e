"""A part of a user: a spring at a joint with outputs."""

import numpy as np

from mbd_ros.core.contracts import Kind, Load, Output


class Strap(Load):
    """A spring at a joint that shows its stretch and a direction."""

    outputs = (Output("stretch", "rad"), Output("way", "m", Kind.VECTOR, "world"))

    def __init__(self, robot, *, joint: str):
        self.joint, self.nv = robot.joint(joint), robot.model.nv

    def force(self, k, x, u):
        tau = np.zeros(self.nv)
        tau[self.joint.v] = -2.0 * x.q[self.joint.q]
        return tau

    def show(self, k, x, u, now):
        return x.q[self.joint.q], np.array([1.0, 2.0, now.a[self.joint.v]])
