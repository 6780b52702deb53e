"""A consistent state of all joints from measured independent ones.

q = F(y),  v = G y'    for couplings,    then the nearest state on the loops, if there are any
"""

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.state import Array, State
from mbd_ros.methods.projection.assembly import project


class ObservedState:
    """Adds the dependent joints, and moves joints of loops onto the loops.

    Args:
        system: The system with the bilateral rows to keep.

    Attributes:
        moved: How far a joint of the last state was moved onto the loops [rad or m].
        dependent: Positions of the dependent joints of the last state [rad or m].
    """

    def __init__(self, system: System, couplings: Couplings) -> None:
        self._system = system
        self._couplings = couplings
        self._neutral = system.robot.neutral()
        self._nv = int(system.robot.model.nv)
        self._slopes: Slopes = [0.0] * len(couplings.pairs)
        self._dependent_q = [pair.child_q for pair in couplings.pairs]
        self.moved = 0.0
        self.dependent = np.zeros(len(couplings.pairs))

    def state(self, t: float, position: Array, velocity: Array) -> State:
        """The state at a time.

        Args:
            t: [s].
            position: Independent joints [rad or m], shape (ny,).
            velocity: [rad/s or m/s], shape (nv_y,).
        """
        q, v = self._neutral.copy(), np.zeros(self._nv)
        q[self._couplings.q_index], v[self._couplings.v_index] = position, velocity
        if self._couplings.pairs:
            self._couplings.expand(q, v, np.zeros(self._nv), self._slopes)
            self.dependent = q[self._dependent_q]
        x = State(t, q, v)
        if self._system.held.rows:
            x = project(self._system, x)
            self.moved = float(np.abs(x.q - q).max())
        return x
