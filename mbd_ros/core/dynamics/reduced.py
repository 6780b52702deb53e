"""Forward dynamics with dependent joints eliminated: q = F(y), v = G y'.

    G' M G y'' = G' (tau - h - M dG/dt y'),   G = dF/dy

`Reduced` forms it from M and h of all joints, `Mimic` has Pinocchio form it at once, where all
couplings are linear. `IndependentJoints` are the coordinates y of both; `core.model.couplings`
evaluates F, G and the drift dG/dt y'. Source: A. A. Shabana, Dynamics of Multibody Systems, 2013,
sec. 3.5, on embedding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.chart import chart_of
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Accelerator, writing
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, Mode, State

_new_state = tuple.__new__  # half the time of the constructor
_SAME = 1.0e-12  # of the largest entry: mass matrices that are the same


class Reduced:
    """Accelerations of independent joints, from M and h of all joints.

    Attributes:
        coordinates: The independent joints.
    """

    tier = "reduced"

    def __init__(self, mechanism: Mechanism, couplings: Couplings) -> None:
        self.mechanism = mechanism
        self.coordinates = joints = IndependentJoints(mechanism, couplings)
        n = joints.chart.nv
        self._at = joints.at
        self._bias = joints.bias
        self._G = joints.G
        self._GT = joints.G.T
        self._q = joints.q
        self._v = joints.v
        self._shape = (n,)
        self._is_linear = joints.is_linear
        self._minus_GT = -joints.G.T
        self._half = np.zeros((n, mechanism.model.nv))
        self._M = np.zeros((n, n))
        self._r = np.zeros(n)
        self._cholesky = eigenpy.LLT(n)

    def accelerate(self, y: State, u: Array | None) -> Array:
        """Return y'' [rad/s^2 or m/s^2], shape (nv,), fresh."""
        mechanism, GT = self.mechanism, self._GT
        mechanism.evaluations += 1
        self._at(y.q, y.v)
        if mechanism.loads.is_empty:
            if not self._is_linear:
                np.negative(GT, self._minus_GT)
            self._minus_GT.dot(self._bias(), self._r)
        else:
            GT.dot(mechanism.tau(self.coordinates.placed(y), u) - self._bias(), self._r)
        GT.dot(mechanism.mass(self._q), self._half).dot(self._G, self._M)
        self._cholesky.compute(self._M)
        return self._cholesky.solve(self._r).reshape(self._shape)  # eigenpy has its own for one

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function that writes the result of `accelerate` in a mode."""
        return writing(self.accelerate, mode)

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return q, v and a of all joints at the state of the last `accelerate`."""
        return self.coordinates.joint_motion(a)

    def respond(self, q: Array, forces: Array) -> Array:
        """Return G (G' M G)^-1 G' forces, shape as `forces`."""
        reduced = self._GT.dot(forces)
        return self._G.dot(self._cholesky.solve(reduced).reshape(reduced.shape))

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Return accelerations of all joints, and multipliers of the couplings."""
        return coupled_solution(self.coordinates, y, u, a, force)


def coupled_solution(
    joints: IndependentJoints, y: State, u: Array | None, a: Array, force: Array | None
) -> tuple[Array, Array]:
    """Accelerations of all joints, and what their couplings exert; as `FreeMotion.solution`."""
    joints.at(y.q, y.v)
    full_a = joints.joint_motion(a)[2]
    needed = joints.needed(y, u, full_a)
    if force is not None:
        needed = needed - force
    return full_a, joints.couplings.reduce(needed, joints.slopes)[1]


class Mimic:
    """Accelerations of independent joints, from M and h that Pinocchio makes for them at once.

    Args:
        model: What `mimic_model` makes of them.

    Attributes:
        coordinates: The independent joints.
    """

    tier = "reduced"

    def __init__(self, mechanism: Mechanism, couplings: Couplings, model: Any) -> None:
        self.mechanism = mechanism
        self.coordinates = IndependentJoints(mechanism, couplings)
        self._cholesky = eigenpy.LLT(self.coordinates.chart.nv)
        self._bias = partial(pin.nonLinearEffects, model, pin.Data(model))
        self._mass = mass_matrix(model)

    def accelerate(self, y: State, u: Array | None) -> Array:
        """Return y'' [rad/s^2 or m/s^2], shape (nv,), fresh."""
        mechanism, joints = self.mechanism, self.coordinates
        mechanism.evaluations += 1
        bias = self._bias(y.q, y.v)
        self._cholesky.compute(self._mass(y.q))
        if mechanism.loads.is_empty:
            return np.negative(self._cholesky.solve(bias))
        joints.at(y.q, y.v)
        tau = mechanism.tau(joints.placed(y), u)
        return self._cholesky.solve(joints.G.T.dot(tau) - bias)

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function that writes the result of `accelerate` in a mode."""
        mechanism, bias, mass = self.mechanism, self._bias, self._mass
        factorise, solve = self._cholesky.compute, self._cholesky.solve
        if not mechanism.loads.is_empty:
            return writing(self.accelerate, mode)

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            mechanism.evaluations += 1
            h = bias(q, v)
            factorise(mass(q))
            np.negative(solve(h), out)

        return accelerate

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return q, v and a of all joints at the state of the last `accelerate`."""
        self.coordinates.at(q, v)
        return self.coordinates.joint_motion(a)

    def respond(self, q: Array, forces: Array) -> Array:
        """Return G (G' M G)^-1 G' forces, shape as `forces`."""
        G = self.coordinates.G
        reduced = G.T.dot(forces)
        return G.dot(self._cholesky.solve(reduced).reshape(reduced.shape))

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Return accelerations of all joints, and multipliers of the couplings."""
        return coupled_solution(self.coordinates, y, u, a, force)


def mimic_model(robot: Robot, couplings: Couplings) -> Any:
    """A model with mimic joints for dependent ones, or None where Pinocchio does not have them.

    Pinocchio has them for linear couplings on a fixed base, to joints that come earlier in the
    model. Where the links beyond a mimic joint branch, `crba` of Pinocchio 4.1 is wrong: hence a
    check. One remaining coordinate gains nothing, and eigenpy gives it other shapes.
    """
    if robot.floating or len(couplings.v_index) == 1:
        return None
    joint_at = {joint.idx_v: joint.id for joint in robot.model.joints if joint.nv == 1}
    follows: dict[int, tuple[int, Linear]] = {}
    model, armature = robot.model, robot.model.armature.copy()
    for pair in couplings.pairs:
        first, function = pair.parent_v, pair.function
        if not isinstance(function, Linear):
            return None
        ancestor, up = follows.get(first, (first, Linear(1.0)))
        factor = function.factor
        function = Linear(factor * up.factor, factor * up.offset + function.offset)
        follows[pair.child_v] = ancestor, function
        parent, child = joint_at[ancestor], joint_at[pair.child_v]
        if parent > child:
            return None
        model = pin.transformJointIntoMimic(model, parent, child, function.factor, function.offset)
        armature[ancestor] += function.factor**2 * armature[pair.child_v]
    model.armature = armature[couplings.v_index]  # Pinocchio leaves that of mimic joints out
    return model if _is_right(model, robot.model, couplings) else None


def _is_right(mimic: Any, full: Any, couplings: Couplings) -> bool:
    """Whether both models have the same reduced mass matrix at some configuration."""
    y = np.linspace(0.3, 1.1, len(couplings.q_index))
    q = couplings.positions(y)
    G, M = couplings.jacobian(q), pin.crba(full, pin.Data(full), q)
    expected, mass = G.T.dot(M).dot(G), mass_matrix(mimic)
    mass(-y)  # the second call of Pinocchio is the one that may go wrong
    return bool(np.abs(mass(y) - expected).max() <= _SAME * np.abs(expected).max())


def mass_matrix(mimic: Any) -> Callable[[Array], Array]:
    """The function from y to the mass matrix of a model with mimic joints, local convention.

    `crba` of Pinocchio 4.1 adds to the forces that its last call left on parents of mimic
    joints: they are set to zero before each call.
    """
    data = pin.Data(mimic)
    parents = {int(mimic.parents[i]) for i in mimic.mimicking_joints}
    left = [data.Fcrb[parent] for parent in sorted(parents)]
    crba = partial(pin.crba, mimic, data)

    def mass(y: Array) -> Array:
        for forces in left:
            forces.fill(0.0)
        return crba(y)

    return mass


class IndependentJoints:
    """Coordinates of tiers that eliminate dependent joints, so that no coupling can open.

    Attributes:
        chart: Of the configuration of y.
        q: F(y) at the last `at`, live.
        v: G y' there.
        a: dG/dt y' there; entries of independent joints stay zero.
        G: dF/dy there, shape (nv of the robot, nv).
        slopes: Those of the coupling functions there.
        is_linear: Whether G is constant and a is zero.
    """

    def __init__(self, mechanism: Mechanism, couplings: Couplings) -> None:
        self._mechanism = mechanism
        self.couplings = couplings
        model = mechanism.model
        self.chart = chart_of(model, couplings.v_index)
        self._qi = couplings.q_index
        self._vi = couplings.v_index
        self.q = pin.neutral(model)
        self.v = np.zeros(model.nv)
        self.a = np.zeros(model.nv)
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
        """Return h + M dG/dt y' of all joints, shape (nv of the robot,)."""
        mechanism = self._mechanism
        if self.is_linear:
            return mechanism.bias(self.q, self.v)
        bias: Array = pin.rnea(mechanism.model, mechanism.data, self.q, self.v, self.a)
        if mechanism.loads.heavy:
            bias = bias + mechanism.added(self.q, self.a)
        return bias

    def joint_motion(self, a: Array) -> tuple[Array, Array, Array]:
        """Return q, v and a of all joints from y'' at the last `at`; q and v are live."""
        return self.q, self.v, self.G.dot(a) + self.a

    def placed(self, y: State) -> State:
        """Return the state of all joints at the last `at`, whose q and v are live.

        Args:
            y: The state of that `at`, for its time, internal states and mode.
        """
        return _new_state(State, (y.t, self.q, self.v, y.z, y.mode))

    def needed(self, y: State, u: Array | None, a: Array) -> Array:
        """Return M a + h - tau of all joints at the last `at`, shape (nv of the robot,).

        Args:
            y: The state of that `at`.
            a: Accelerations of all joints.
        """
        mechanism, q, v = self._mechanism, self.q, self.v
        force = pin.rnea(mechanism.model, mechanism.data, q, v, a)
        if mechanism.loads.heavy:
            force = force + mechanism.added(q, a)
        return force - mechanism.tau(self.placed(y), u)

    def expand(self, y: State) -> State:
        """Return the state of all joints."""
        self.at(y.q, y.v)
        return State(y.t, self.q.copy(), self.v.copy(), y.z, y.mode)

    def reduce(self, x: State) -> State:
        """Return the state of the independent joints."""
        return State(x.t, x.q[self._qi], x.v[self._vi], x.z, x.mode)

    def lift(self, y: State, a: Array) -> Array:
        """Return accelerations of all joints from y'', fresh."""
        self.at(y.q, y.v)
        return self.G.dot(a) + self.a

    def integrated(self, a: Array) -> Array:
        """Return those of independent joints."""
        return a[self._vi]

    def mass(self, q: Array) -> Array:
        """Return G' M G, shape (nv, nv), fresh."""
        self.at(q, self._still)
        return self.G.T.dot(self._mechanism.mass(self.q)).dot(self.G)

    def applied(self, y: State, u: Array | None) -> Array:
        """Return G' (tau - h - M dG/dt y'), shape (nv,)."""
        mechanism = self._mechanism
        mechanism.evaluations += 1
        self.at(y.q, y.v)
        return self.G.T.dot(mechanism.tau(self.placed(y), u) - self.bias())
