"""What loads add to a mass matrix where a step solves for them."""

import numpy as np

from mbd_ros.core.dynamics.all_joints import AllJoints
from mbd_ros.core.dynamics.linearization import Linearization
from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.state import Array, State


class LoadSlopes:
    """-(s f_v + s^2 f_q) of the loads f on all joints, symmetric part.

    Forces that jump count with their side at the state: across the surface a difference quotient
    is no slope.

    Args:
        mechanism: Whose loads they are.

    Attributes:
        nv: Size of the velocity.
        model: The Pinocchio model.
        chart: Of the configuration.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism, self.model = mechanism, mechanism.model
        self.nv, self.chart = int(mechanism.model.nv), AllJoints(mechanism).chart
        self._loads: Loads = mechanism.loads
        self._of = Linearization(self, self._write)

    def added(self, x: State, u: Array | None, s: float) -> Array:
        """The matrix at a state of all joints, shape (nv, nv).

        Args:
            x: State of all joints.
            u: Inputs, as for `Loads.total`.
            s: Share of a step that a slope counts for [s].
        """
        loads, k = self._mechanism.loads, self._mechanism.k
        if loads.is_empty:
            return np.zeros((self.nv, self.nv))
        k.refresh(x.q, x.v, loads.reads)
        self._loads = loads.beside(k, x)
        self._of.update(x.t, x.q, x.v, u)
        slopes = s * self._of.damping + s * s * self._of.stiffness
        return -0.5 * (slopes + slopes.T)

    def _write(self, t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
        k = self._mechanism.k
        k.refresh(q, v, self._loads.reads)
        out[...] = self._loads.total(k, State(t, q, v), u)


def mass_with(M: Array, added: Array) -> Array:
    """M + added where that is positive definite, else without what makes it less than M.

    Such a load makes motion grow: it is left to explicit steps.
    """
    whole: Array = M + added
    try:
        np.linalg.cholesky(whole)
    except np.linalg.LinAlgError:
        L = np.linalg.cholesky(M)
        sizes, ways = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, added).T))
        ways = L.dot(ways)
        whole = M + (ways * np.maximum(sizes, 0.0)).dot(ways.T)
    return whole
