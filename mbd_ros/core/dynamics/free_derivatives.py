"""Derivatives of the accelerations of an open chain, exact but for those of its loads.

    da = ABA_q dq + ABA_v dv + M^-1 dtau

Loads that do not know their derivatives are differentiated by differences: they are cheap, and
most of them linear. Source:
J. Carpentier, N. Mansard, Analytical derivatives of rigid body dynamics algorithms, RSS 2018.
"""

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Derivatives
from mbd_ros.core.loads.internal_states import Internals
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
        self._nv, self._nz = nv, nz = int(mechanism.model.nv), internals.nz
        self._constant, self._varying = np.zeros((nv + nz, 2 * nv + nz)), list[Load]()
        for part in (*mechanism.loads.actuators, *mechanism.loads.forces):
            slopes = part.constant_slopes(nv, nz)
            if slopes is None:
                self._varying.append(part)
            else:
                self._constant[:nv] += slopes
        self._moving = [part for part in self._varying if part.internal]

    def at(self, y: State, u: Array | None, *, inputs: bool) -> Derivatives:
        """As `System.derivatives`."""
        mechanism, nv, nz = self._mechanism, self._nv, self._nz
        u = mechanism.loads.inputs(y, u)
        force = self._loads(y, u)
        slopes = self._slopes(y, u, force, len(u) if inputs else 0)
        model, data = mechanism.model, mechanism.data
        mechanism.evaluations += 1
        pin.computeABADerivatives(model, data, y.q, y.v, force[:nv])
        by_q, by_v, respond = np.array(data.ddq_dq), np.array(data.ddq_dv), np.array(data.Minv)
        if slopes is None:
            none = np.zeros((nv, 0))
            return Derivatives(by_q, by_v, none, none, force=respond)
        pushed = respond.dot(slopes[:nv])
        by_q += pushed[:, :nv]
        by_v += pushed[:, nv : 2 * nv]
        at = 2 * nv + nz
        rates = None
        if nz:
            rows = slopes[nv:]
            rates = Derivatives(
                rows[:, :nv], rows[:, nv : 2 * nv], rows[:, 2 * nv : at], rows[:, at:]
            )
        by_z, by_u = pushed[:, 2 * nv : at], pushed[:, at:]
        return Derivatives(by_q, by_v, by_z, by_u, rates, force=respond)

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
        found[:, : 2 * nv + nz] = self._constant
        if self._varying:
            self._differ(y, u, found)
        for i in range(nu):
            moved = u.copy()
            moved[i] += _STEP * max(1.0, abs(float(u[i])))
            found[:, 2 * nv + nz + i] = (self._loads(y, moved) - force) / (moved[i] - u[i])
        return found

    def _differ(self, y: State, u: Array, found: Array) -> None:
        """Add the slopes of the loads that do not know them, by q, v and z."""
        nv, here = self._nv, self._of_varying(y, u)
        inside, step = self._internals.upper, np.zeros(2 * nv + self._nz)
        for i in range(len(step)):
            step[i] = _STEP
            if i >= 2 * nv and y.z[i - 2 * nv] + _STEP > inside[i - 2 * nv]:
                step[i] = -_STEP
            found[:, i] += (self._of_varying(self._chart.plus(y, step), u) - here) / step[i]
            step[i] = 0.0

    def _of_varying(self, y: State, u: Array) -> Array:
        """As `_loads`, of the loads that do not know their slopes."""
        mechanism, internals, nv = self._mechanism, self._internals, self._nv
        x = y._replace(z=internals.inside(y.z)) if self._nz else y
        k, total = mechanism.k, np.zeros(nv + self._nz)
        k.refresh(x.q, x.v, max(mechanism.loads.reads, internals.reads))
        for part in self._varying:
            total[:nv] += part.force(k, x, u)
        for part in self._moving:
            total[nv:][part.z] = part.rates(k, x, u)
        return total
