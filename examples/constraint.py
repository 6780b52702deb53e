"""A constraint of one's own: a belt that turns one joint against another."""

import numpy as np

import mbd_ros as mbd
from mbd_ros.core.rows.constraint import Constraint, Row


class Belt(Constraint):
    """Crossed belt over two pulleys: q_a + ratio q_b = 0.

    Args:
        robot: Robot of the scene.
        a: Joint of one pulley.
        b: Joint of the other.
        ratio: Radius of b over radius of a.
    """

    def __init__(self, robot, *, a: str, b: str, ratio: float = 1.0):
        first, second = robot.joint(a), robot.joint(b)
        self._q, self._ratio = (first.q, second.q), ratio
        self._jacobian, self._drift = np.zeros((1, robot.model.nv)), np.zeros(1)
        self._jacobian[0, [first.v, second.v]] = 1.0, ratio
        self.rows = (Row("torque", "N·m"),)

    def residual(self, k, x):
        return np.array([x.q[self._q[0]] + self._ratio * x.q[self._q[1]]])

    def jacobian(self, k, x):
        return self._jacobian

    def drift(self, k, x):
        return self._drift


arm = mbd.scene_from(
    {
        "constraints": [{"type": Belt, "a": "joint2", "b": "joint4", "ratio": 0.5}],
        "initial": {"position": {"joint2": 0.6}},
    },
    urdf="arm7",
    allow_code=True,
)
table = arm.simulate(1.0, dt=0.01)["samples"]
print(f"largest force in the belt: {abs(table['belt.torque']).max():.3g} N m")
print(f"largest slip: {table['drift.position'].max():.1e} rad")
