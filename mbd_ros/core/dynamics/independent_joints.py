"""Independent joints as coordinates: q = F(y), v = G y'."""

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.chart import chart_of
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import Array, State


class IndependentJoints:
    """Coordinates of tiers that eliminate dependent joints, so that no coupling can open.

    Args:
        mechanism: The mechanism.
        couplings: Its dependent joints.

    Attributes:
        chart: Of the configuration of y.
        couplings: As given.
        q: F(y) at the last `at`, live.
        v: G y' there.
        a: dG/dt y' there; entries of independent joints stay zero.
        G: dF/dy there, shape (nv of the robot, nv).
        slopes: Those of the coupling functions there.
        is_linear: Whether G is constant and a is zero.
    """

    def __init__(self, mechanism: Mechanism, couplings: Couplings) -> None:
        self._mechanism, self.couplings, model = mechanism, couplings, mechanism.model
        self.chart = chart_of(model, couplings.v_index)
        self._qi, self._vi = couplings.q_index, couplings.v_index
        self.q, self.v, self.a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        self._still = np.zeros(self.chart.nv)
        self.slopes = [0.0] * len(couplings.pairs)
        linear = all(isinstance(pair.function, Linear) for pair in couplings.pairs)
        is_flat = self.chart.is_flat
        self.is_linear = linear and is_flat
        self._offset = couplings.positions(np.zeros(self.chart.nq)) if is_flat else self.q
        self._is_offset = bool(self._offset.any())
        self.G = couplings.jacobian(self.q)
        column = {int(v): i for i, v in enumerate(self._vi)}
        self._columns = []
        for pair in couplings.pairs:
            column[pair.child_v] = column[pair.parent_v]
            self._columns.append(column[pair.child_v])
        couplings.expand(self.q, self.v, self.a, self.slopes)

    def at(self, q: Array, v: Array) -> None:
        """Go to a state of y."""
        if self.is_linear:
            self.G.dot(q, self.q)
            if self._is_offset:
                self.q += self._offset
            self.G.dot(v, self.v)
            return
        self.q[self._qi], self.v[self._vi] = q, v
        self.couplings.expand(self.q, self.v, self.a, self.slopes)
        G = self.G
        for pair, slope, column in zip(
            self.couplings.pairs, self.slopes, self._columns, strict=True
        ):
            G[pair.child_v, column] = slope * G.item(pair.parent_v, column)

    def bias(self) -> Array:
        """The h + M dG/dt y' of all joints, shape (nv of the robot,)."""
        mechanism = self._mechanism
        if self.is_linear:
            return mechanism.bias(self.q, self.v)
        bias: Array = pin.rnea(mechanism.model, mechanism.data, self.q, self.v, self.a)
        if mechanism.loads.heavy:
            bias = bias + mechanism.added(self.q, self.a)
        return bias

    def joint_motion(self, a: Array) -> tuple[Array, Array, Array]:
        """q, v and a of all joints from y'' at the last `at`; q and v are live."""
        return self.q, self.v, self.G.dot(a) + self.a

    def needed(self, t: float, u: Array | None, a: Array) -> Array:
        """M a + h - tau of all joints at the last `at`, shape (nv of the robot,).

        Args:
            t: Time [s].
            u: Inputs.
            a: Accelerations of all joints.
        """
        mechanism, q, v = self._mechanism, self.q, self.v
        force = pin.rnea(mechanism.model, mechanism.data, q, v, a)
        if mechanism.loads.heavy:
            force = force + mechanism.added(q, a)
        return force - mechanism.tau(t, q, v, u)

    def expand(self, y: State) -> State:
        """State of all joints."""
        self.at(y.q, y.v)
        return State(y.t, self.q.copy(), self.v.copy(), y.z, y.mode)

    def reduce(self, x: State) -> State:
        """State of the independent joints."""
        return State(x.t, x.q[self._qi], x.v[self._vi], x.z, x.mode)

    def lift(self, y: State, a: Array) -> Array:
        """Accelerations of all joints from y'', fresh."""
        self.at(y.q, y.v)
        return self.G.dot(a) + self.a

    def integrated(self, a: Array) -> Array:
        """Those of independent joints."""
        return a[self._vi]

    def mass(self, q: Array) -> Array:
        """G' M G, shape (nv, nv), fresh."""
        self.at(q, self._still)
        return self.G.T.dot(self._mechanism.mass(self.q)).dot(self.G)

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """G' (tau - h - M dG/dt y'), shape (nv,)."""
        mechanism = self._mechanism
        mechanism.evaluations += 1
        self.at(q, v)
        return self.G.T.dot(mechanism.tau(t, self.q, self.v, u) - self.bias())
