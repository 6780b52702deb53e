"""Coupled joints: q = F(y), with the coupling Jacobian G = dF/dy and the drift dG/dt y'.

Every dependent joint follows one other joint, its parent, by a coupling function f. The recursion

    q_d = f(q_p),    v_d = f' v_p,    a_d = f' a_p + f'' v_p^2

from the independent joints outwards yields F(y), G y' and G y'' + dG/dt y'. The reverse recursion
tau_p += f' tau_d yields G' tau; after it, tau_d is the coupling multiplier lam_d. G itself is not
needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.coupling_functions import CouplingFunction, Linear
from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

Slopes = list[Any]  # f' of every coupling: floats, or arrays for a batch


class Couplings:
    """All dependent joints of a robot.

    Args:
        robot: The robot; its `<mimic>` joints are couplings too.
        couplings: Dependent joint -> its coupling, which replaces a `<mimic>` of the same joint.

    Attributes:
        independent: Names of the independent joints, in the order of y.
        dependent: Names of the dependent joints, in the order of the multipliers.
        parents: Dependent joint -> its direct parent.
        q_index: Indices of y in q, including poses of free bases, shape (ny,).
        v_index: Indices of y' in v, shape (nv_y,).
        pairs: The couplings by index, parents before children.

    Raises:
        ModelError: A joint is unknown, fixed or locked, or couplings form a cycle.
    """

    def __init__(self, robot: Robot, couplings: Mapping[str, Coupling] | None = None) -> None:
        functions = {m.joint: Coupling(m.parent, Linear(m.factor, m.offset)) for m in robot.mimics}
        functions.update(couplings or {})
        for name, coupling in functions.items():
            _check_ends(robot, name, coupling.parent)
        order = _outwards(functions)
        child = {name: robot.joint(name) for name in order}
        self.independent = tuple(j.name for j in robot.joints if j.name not in functions)
        self.dependent = tuple(order)
        self.parents = {name: functions[name].parent for name in order}
        self.pairs = [_pair(robot, child[name], functions[name]) for name in order]
        dependent_q = [joint.q for joint in child.values()]
        self._dependent_v = np.array([joint.v for joint in child.values()], dtype=np.intp)
        self.q_index = np.setdiff1d(np.arange(robot.model.nq), dependent_q)
        self.v_index = np.setdiff1d(np.arange(robot.model.nv), self._dependent_v)
        self._nv = int(robot.model.nv)

    def expand(self, q: Array, v: Array, a: Array, slopes: Slopes | None = None) -> Slopes:
        """Compute the dependent entries of q, v and a from the independent ones, in place.

        Args:
            q: Configuration, shape (nq,), or a batch (nq, n).
            v: Velocity, shape (nv,) or (nv, n).
            a: Acceleration, shape (nv,) or (nv, n).
            slopes: Result of an earlier call, which is overwritten; by default a new list.

        Returns:
            f' of every dependent joint at this configuration.
        """
        slopes = [0.0] * len(self.pairs) if slopes is None else slopes
        q_of, v_of, a_of = (x.item if x.ndim == 1 else x.__getitem__ for x in (q, v, a))
        for i, (child_q, child_v, parent_q, parent_v, function) in enumerate(self.pairs):
            q[child_q], slope, curvature = function(q_of(parent_q))
            rate = v_of(parent_v)
            v[child_v] = slope * rate
            a[child_v] = slope * a_of(parent_v) + curvature * rate * rate
            slopes[i] = slope
        return slopes

    def reduce(self, tau: Array, slopes: Slopes) -> tuple[Array, Array]:
        """Return G' tau and the coupling multipliers.

        Args:
            tau: Generalized forces of all joints, shape (nv,) or (nv, n); overwritten.
            slopes: Result of `expand`.

        Returns:
            Forces of the independent coordinates, shape (nv_y,) or (nv_y, n), and the multiplier
            of every dependent joint, shape (len(dependent),) or (len(dependent), n).
        """
        for slope, pair in zip(reversed(slopes), reversed(self.pairs), strict=True):
            tau[pair.parent_v] += slope * tau[pair.child_v]
        return tau[self.v_index], tau[self._dependent_v]

    def positions(self, y: Array) -> Array:
        """Return F(y), the positions of all joints of a fixed-base robot, shape (nq,).

        Args:
            y: Independent positions [rad or m], shape (ny,).
        """
        q, v, a = np.empty(self._nv), np.zeros(self._nv), np.zeros(self._nv)
        q[self.q_index] = y
        self.expand(q, v, a)
        return q

    def jacobian(self, q: Array) -> Array:
        """Return G = dF/dy at a configuration, shape (nv, nv_y)."""
        G = np.zeros((self._nv, len(self.v_index)))
        G[self.v_index, np.arange(len(self.v_index))] = 1.0
        for pair in self.pairs:
            _, slope, _ = pair.function(q.item(pair.parent_q))
            G[pair.child_v] = slope * G[pair.parent_v]
        return G


def _check_ends(robot: Robot, name: str, parent: str) -> None:
    for role, joint in (("coupled joint", name), ("parent", parent)):
        try:
            robot.joint(joint)
        except ModelError as error:
            raise ModelError(f"coupling {name} <- {parent}: {role}: {error}") from error


def _outwards(functions: Mapping[str, Coupling]) -> list[str]:
    """Return the dependent joints, parents before children."""
    order: list[str] = []
    for name in functions:
        path = [name]
        while (parent := functions[path[-1]].parent) in functions and parent not in order:
            if parent in path:
                raise ModelError(f"couplings form a cycle: {' <- '.join([*path, parent])}")
            path.append(parent)
        order.extend(joint for joint in reversed(path) if joint not in order)
    return order


def _pair(robot: Robot, child: Joint, coupling: Coupling) -> CoupledPair:
    parent = robot.joint(coupling.parent)
    return CoupledPair(child.q, child.v, parent.q, parent.v, coupling.function)


class Coupling(NamedTuple):
    """Parent and function of a dependent joint, in topic names."""

    parent: str
    function: CouplingFunction


class CoupledPair(NamedTuple):
    """A coupling by indices in q and v."""

    child_q: int
    child_v: int
    parent_q: int
    parent_v: int
    function: CouplingFunction


class IndependentCoordinates:
    """Indices of joints and free bodies among the independent coordinates y and their rates.

    Attributes:
        joint_y: Indices of the independent joints in y.
        joint_w: Indices of the independent joints in y'.
        body_y: Indices of each free body in y, 7 each.
        body_w: Indices of each free body in y', 6 each.
    """

    def __init__(self, robot: Robot, couplings: Couplings) -> None:
        joints, bases = [robot.joint(name) for name in couplings.independent], robot.bases
        q, v = couplings.q_index, couplings.v_index
        self.joint_y = np.searchsorted(q, np.array([joint.q for joint in joints], dtype=np.intp))
        self.joint_w = np.searchsorted(v, np.array([joint.v for joint in joints], dtype=np.intp))
        self.body_y = [np.searchsorted(q, np.arange(b.q.start, b.q.stop)) for b in bases]
        self.body_w = [np.searchsorted(v, np.arange(b.v.start, b.v.stop)) for b in bases]
        self._y = np.concatenate([self.joint_y, *self.body_y])
        self._w = np.concatenate([self.joint_w, *self.body_w])

    def positions(self, joints_and_bodies: Array) -> Array:
        """Arrange coordinates of joints, then bodies, in the order of y, shape (.., ny)."""
        return self._arranged(joints_and_bodies, self._y)

    def rates(self, joints_and_bodies: Array) -> Array:
        """Arrange rates of joints, then bodies, in the order of y', shape (.., nv_y)."""
        return self._arranged(joints_and_bodies, self._w)

    def _arranged(self, values: Array, at: NDArray[np.intp]) -> Array:
        if not self.body_y:
            return values
        arranged = np.empty_like(values)
        arranged[..., at] = values
        return arranged
