"""Limits of joints and bounds of internal states, as an estimator keeps them."""

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.estimation.process import Bounded
from mbd_ros.core.estimation.state_tangent import StateTangent
from mbd_ros.core.state import Array, State


class StateLimits:
    """Positions and velocities of joints within their limits, internal states within bounds.

    Args:
        system: The system.
        tangent: Of its states.
        positions: Whether joints keep their position limits.
        velocities: Whether they keep their velocity limits.

    Attributes:
        names: Of what has bounds, in the order of `at`: `<joint>.position`, `<joint>.velocity`,
            then internal states.
    """

    def __init__(
        self, system: System, tangent: StateTangent, *, positions: bool, velocities: bool
    ) -> None:
        self._system, self._tangent = system, tangent
        self._by: Array | None = None
        joints, internals = system.robot.joints, system.internals
        held = [j for j in joints if positions and np.isfinite((j.lower, j.upper)).any()]
        quick = [j for j in joints if velocities and np.isfinite(j.max_velocity)]
        bounded = np.isfinite(internals.lower) | np.isfinite(internals.upper)
        self._q, self._qv = [j.q for j in held], [j.v for j in held]
        self._v, self._z = [j.v for j in quick], np.flatnonzero(bounded)
        fastest = [j.max_velocity for j in quick]
        lower = [j.lower for j in held] + [-v for v in fastest]
        upper = [j.upper for j in held] + fastest
        self._lower = np.array([*lower, *internals.lower[self._z]], dtype=np.float64)
        self._upper = np.array([*upper, *internals.upper[self._z]], dtype=np.float64)
        self.names = (
            *(f"{joint.name}.position" for joint in held),
            *(f"{joint.name}.velocity" for joint in quick),
            *(internals.names[i] for i in self._z),
        )
        self._may_be_wrong = np.arange(len(self._lower)) < len(held) + len(quick)

    def at(self, y: State) -> Bounded:
        """Values at a state, and their derivatives by a step of the tangent."""
        n, nv = self._tangent.n, self._system.robot.model.nv
        if not len(self._lower):
            return Bounded(self._lower, np.zeros((0, n)), self._lower, self._upper)
        x = self._system.expand(y)
        by = self._by
        if by is None:
            lift = self._tangent.of_all_joints(y)
            rows = np.zeros((len(self._z), n))
            rows[np.arange(len(self._z)), n - len(y.z) + self._z] = 1.0
            by = np.vstack((lift[self._qv], lift[nv:][self._v], rows))
            if self._tangent.is_whole and self._system.nv == nv:
                self._by = by  # the same everywhere
        values = np.concatenate((x.q[self._q], x.v[self._v], x.z[self._z]))
        return Bounded(values, by, self._lower, self._upper, self._may_be_wrong)
