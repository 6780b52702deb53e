"""Derivatives of the accelerations of an open chain, exact but for those of its loads.

    da = ABA_q dq + ABA_v dv + M^-1 dtau

The loads are differentiated by differences: they are cheap, and most of them linear. Source:
J. Carpentier, N. Mansard, Analytical derivatives of rigid body dynamics algorithms, RSS 2018.
"""

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.internals import Internals
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Derivatives
from mbd_ros.core.state import Array, State

_STEP = 1.5e-8  # square root of the rounding unit


class FreeDerivatives:
    """Derivatives of q'' and of the rates z' of a mechanism without rows.

    Args:
        mechanism: What moves.
        chart: Steps of the configurations of all joints.
        internals: The internal states of its loads.
    """

    def __init__(self, mechanism: Mechanism, chart: Chart, internals: Internals) -> None:
        self._mechanism, self._chart, self._internals = mechanism, chart, internals
        self._nv, self._nz = int(mechanism.model.nv), internals.nz

    def at(self, y: State, u: Array | None, *, inputs: bool) -> Derivatives:
        """As `System.derivatives`."""
        mechanism, nv, nz = self._mechanism, self._nv, self._nz
        u = mechanism.loads.inputs(y, u)
        force = self._loads(y, u)
        slopes = self._slopes(y, u, force, len(u) if inputs else 0)
        model, data = mechanism.model, mechanism.data
        mechanism.evaluations += 1
        pin.computeABADerivatives(model, data, y.q, y.v, force[:nv])
        by_q, by_v = np.array(data.ddq_dq), np.array(data.ddq_dv)
        if slopes is None:
            none = np.zeros((nv, 0))
            return Derivatives(by_q, by_v, none, none)
        pushed = np.array(data.Minv).dot(slopes[:nv])
        by_q += pushed[:, :nv]
        by_v += pushed[:, nv : 2 * nv]
        at = 2 * nv + nz
        rates = None
        if nz:
            rows = slopes[nv:]
            rates = Derivatives(
                rows[:, :nv], rows[:, nv : 2 * nv], rows[:, 2 * nv : at], rows[:, at:]
            )
        return Derivatives(by_q, by_v, pushed[:, 2 * nv : at], pushed[:, at:], rates)

    def _loads(self, y: State, u: Array) -> Array:
        """Forces of the loads on the joints, then rates of their states, shape (nv + nz,)."""
        mechanism, internals = self._mechanism, self._internals
        x = y._replace(z=internals.inside(y.z)) if self._nz else y
        mechanism.k.refresh(x.q, x.v, max(mechanism.loads.reads, internals.reads))
        force = mechanism.loads.total(mechanism.k, x, u)
        if not self._nz:
            return force
        return np.concatenate((force, internals.rates(mechanism.k, x, u)))

    def _slopes(self, y: State, u: Array, force: Array, nu: int) -> Array | None:
        """Of `_loads` by q, v, z and u, shape (nv + nz, 2 nv + nz + nu); None for zero."""
        if self._mechanism.loads.is_empty:
            return None
        nv, nz = self._nv, self._nz
        found = np.empty((nv + nz, 2 * nv + nz + nu))
        inside, step = self._internals.upper, np.zeros(2 * nv + nz)
        for i in range(2 * nv + nz):
            step[i] = _STEP
            if i >= 2 * nv and y.z[i - 2 * nv] + _STEP > inside[i - 2 * nv]:
                step[i] = -_STEP
            found[:, i] = (self._loads(self._chart.plus(y, step), u) - force) / step[i]
            step[i] = 0.0
        for i in range(nu):
            moved = u.copy()
            moved[i] += _STEP * max(1.0, abs(float(u[i])))
            found[:, 2 * nv + nz + i] = (self._loads(y, moved) - force) / (moved[i] - u[i])
        return found
