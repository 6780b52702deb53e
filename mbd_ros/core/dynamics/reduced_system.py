"""Forward dynamics with dependent joints eliminated exactly: q = F(z), v = G z'.

G' M G z'' = G' (tau - h - M dG/dt z')
"""

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.chart import chart_of
from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.bounded_rows import BoundedRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import Array, State


class ReducedSystem(System):
    """Integrates the independent coordinates only, so that no coupling can open.

    Args:
        robot: The robot.
        loads: What acts on its joints.
        couplings: Its dependent joints.
        bounded: Rows with bounded multipliers.
    """

    tier = "reduced"

    def __init__(
        self,
        robot: Robot,
        loads: Loads,
        couplings: Couplings,
        bounded: BoundedRows | None = None,
    ) -> None:
        limits = () if bounded is None else bounded.constraints.parts
        layout = RowLayout((CouplingRows(robot, couplings), *limits))
        super().__init__(robot, loads, bounded=bounded, layout=layout)
        self.couplings = couplings
        self.chart = chart_of(robot.model, couplings.v_index)
        self.nq, self.nv = self.chart.nq, self.chart.nv
        self._zi, self._wi = couplings.q_index, couplings.v_index
        self._q, self._v = pin.neutral(robot.model), np.zeros(robot.model.nv)
        self._a, self._w0 = np.zeros(robot.model.nv), np.zeros(self.nv)
        self._slopes = [0.0] * len(couplings.pairs)
        linear = all(isinstance(pair.function, Linear) for pair in couplings.pairs)
        self._is_linear = linear and self.chart.is_flat
        self._offset = couplings.positions(np.zeros(self.nq)) if self.chart.is_flat else self._q
        self._is_offset = bool(self._offset.any())
        self._G = couplings.jacobian(self._q)
        self._GT, self._minus_GT = self._G.T, -self._G.T
        column = {int(v): i for i, v in enumerate(self._wi)}
        self._columns = []
        for pair in couplings.pairs:
            column[pair.child_v] = column[pair.parent_v]
            self._columns.append(column[pair.child_v])
        couplings.expand(self._q, self._v, self._a, self._slopes)
        self._half = np.zeros((self.nv, robot.model.nv))
        self._M, self._r = np.zeros((self.nv, self.nv)), np.zeros(self.nv)
        self._cholesky = eigenpy.LLT(self.nv)

    def acceleration(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Acceleration z'' [rad/s^2 or m/s^2], shape (nv,)."""
        self.evaluations += 1
        self._expand(q, v)
        if self.loads.is_empty:
            self._minus_GT.dot(self._bias(), self._r)
        else:
            self._GT.dot(self._tau(t, self._q, self._v, u) - self._bias(), self._r)
        M = pin.crba(self.model, self.data, self._q)
        self._GT.dot(M, self._half).dot(self._G, self._M)
        self._cholesky.compute(self._M)
        a = self._cholesky.solve(self._r).reshape(self.nv)  # eigenpy has its own for one
        return a if self.bounded is None else self.bounded.accelerate(self, t, q, v, a)

    def mass(self, q: Array) -> Array:
        """G' M G, shape (nv, nv), fresh."""
        self._expand(q, self._w0)
        return self._GT.dot(self._full_mass(self._q)).dot(self._G)

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """G' (tau - h - M dG/dt z'), shape (nv,)."""
        self.evaluations += 1
        self._expand(q, v)
        return self._GT.dot(self._tau(t, self._q, self._v, u) - self._bias())

    def expand(self, x: State) -> State:
        """State of all joints."""
        self._expand(x.q, x.v)
        return State(x.t, self._q.copy(), self._v.copy())

    def reduce(self, x: State) -> State:
        """State of the independent coordinates."""
        return State(x.t, x.q[self._zi], x.v[self._wi])

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """q, v and a of all joints at the state of the last evaluation."""
        return self._q, self._v, self._G.dot(a) + self._a

    def integrated(self, a: Array) -> Array:
        """Accelerations of the integrated coordinates among those of all joints."""
        return a[self._wi]

    def respond(self, q: Array, forces: Array) -> Array:
        """Accelerations of all joints that forces on them add; as `System.respond`."""
        reduced = self._GT.dot(forces)
        return self._G.dot(self._cholesky.solve(reduced).reshape(reduced.shape))

    def _solve(self, y: State, u: Array | None) -> tuple[Array, Array]:
        q, v, a = self.joint_motion(y.q, y.v, self.acceleration(y.t, y.q, y.v, u))
        needed = pin.rnea(self.model, self.data, q, v, a) - self._tau(y.t, q, v, u)
        if self.bounded is None:
            return a, self.couplings.reduce(needed, self._slopes)[1]
        lam = self.couplings.reduce(needed - self.bounded.force, self._slopes)[1]
        return a, np.concatenate((lam, self.bounded.multipliers))

    def _expand(self, z: Array, w: Array) -> None:
        """Values q = F(z), v = G w, a = dG/dt w, and G."""
        G, q, v = self._G, self._q, self._v
        if self._is_linear:
            G.dot(z, q)
            if self._is_offset:
                q += self._offset
            G.dot(w, v)
            return
        q[self._zi], v[self._wi] = z, w
        self.couplings.expand(q, v, self._a, self._slopes)
        for pair, slope, column in zip(
            self.couplings.pairs, self._slopes, self._columns, strict=True
        ):
            G[pair.child_v, column] = slope * G.item(pair.parent_v, column)
        np.negative(self._GT, self._minus_GT)

    def _bias(self) -> Array:
        """Bias h + M dG/dt z'; the independent rows of `_a` stay zero."""
        if self._is_linear:
            return pin.nonLinearEffects(self.model, self.data, self._q, self._v)
        return pin.rnea(self.model, self.data, self._q, self._v, self._a)
