"""Dependent joints as rows: q_d - f(q_p) = 0, with the multiplier of the tendon."""

from typing import Any

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.state import Array, State

_Numbers = Kinematics | type[Kinematics]  # nothing moves, so its kind of numbers is all


class CouplingRows(Constraint):
    """Every coupling of a scene as a row; its multiplier pushes the dependent joint.

    Args:
        couplings: Its dependent joints, in the order of the rows.

    Attributes:
        pairs: The couplings in indices, parents before children.
    """

    def __init__(self, robot: Robot, couplings: Couplings) -> None:
        self.pairs = couplings.pairs
        self.name = ""  # its multipliers go by the dependent joints
        tied = [robot.joint(name) for name in couplings.dependent]
        self.rows = tuple(Row(f"{one.name}.multiplier", one.effort_unit) for one in tied)
        self._nv = int(robot.model.nv)
        self._constant: tuple[Array, Array] | None = None
        if all(isinstance(pair.function, Linear) for pair in couplings.pairs):
            rest = State(0.0, robot.neutral(), np.zeros(self._nv))
            self._constant = self._jacobian(Kinematics, rest), self._drift(Kinematics, rest)

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, which do not change where all functions are linear."""
        return self._constant or (self._jacobian(k, x), self._drift(k, x))

    def residual(self, k: Kinematics, x: State) -> Array:
        """q_d - f(q_p), shape (m,)."""
        q = x.q.tolist()
        return k.array([q[i.child_q] - i.function(q[i.parent_q])[0] for i in self.pairs])

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """1 at the dependent joint, -f' at its parent, shape (m, nv)."""
        return self._jacobian(k, x)

    def drift(self, k: Kinematics, x: State) -> Array:
        """-f'' v_p^2, shape (m,)."""
        return self._drift(k, x)

    def _jacobian(self, k: _Numbers, x: State) -> Array:
        shape: Any = len(self.pairs), self._nv
        J = k.zeros(shape)
        for row, i in enumerate(self.pairs):
            J[row, i.child_v] = 1.0
            J[row, i.parent_v] = -i.function(k.item(x.q, i.parent_q))[1]
        return J

    def _drift(self, k: _Numbers, x: State) -> Array:
        q, v = x.q.tolist(), x.v.tolist()  # floats: their squares by ** would not overflow to inf
        return k.array(
            [-i.function(q[i.parent_q])[2] * v[i.parent_v] * v[i.parent_v] for i in self.pairs]
        )
