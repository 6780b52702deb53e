"""Reactions of joints at an evaluation of a system, as sensors of forces feel them."""

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.inverse_dynamics.reactions import JointReactions
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State


class FeltReactions:
    """Reactions of the joints of a system, with all that acts on its bodies.

    Args:
        system: The system.
    """

    def __init__(self, system: System) -> None:
        rows = ConstraintRows(system.layout.blocks, int(system.robot.model.nv))
        self._slots, self._loads = rows.slots, system.loads
        self._solver = JointReactions(system.robot, rows, (), system.loads.forces)

    def at(self, x: State, u: Array | None, a: Array, lam: Array) -> Array:
        """Reactions, as `Now.reactions`.

        Args:
            x: State of all joints.
            u: Inputs, as for `System.evaluate`.
            a: Accelerations of all joints, shape (nv,).
            lam: Multipliers of all rows of the system.
        """
        given = np.asarray(self._loads.inputs(x, u))
        return self._solver.solve(x, a, lam[self._slots], u=given).local
