"""Forces as a matrix times the inertial numbers, for coupled joints and for loops.

    G' (rnea - loads) = G' W(q, v, a) p + known,    N' W p + known = N' B u

with W of Pinocchio, G the Jacobian of the couplings, N the motions that loops leave, one for each
of some of the actuated joints, and `known` what springs, rotors and measured wrenches exert.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.core.kinematics.free_bases import IndependentCoordinates
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.inertial_parameters import parameters_of
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array


class Regressor:
    """Rows of an open chain, coupled or not: one for each independent coordinate.

    Args:
        robot: The robot.
        solver: Inverse dynamics of the scene, whose forces and wrenches are the known ones.

    Attributes:
        labels: Of the rows: joints, and coordinates of free bases.
        coordinates: Their places among the independent velocities.
        size: Inertial numbers of all bodies.
        base: Rows that no joint drives, those of free bases.
    """

    def __init__(self, robot: Robot, solver: InverseDynamics) -> None:
        self._solver, self._couplings = solver, solver.couplings
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._carried = self._model
        self._given = parameters_of(robot.model).ravel()
        self.size = len(self._given)
        names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
        at = self._couplings.v_index
        self.labels = tuple(names[int(v)] for v in at)
        self.coordinates = np.arange(len(at))
        self.base = np.flatnonzero(np.isin(at, robot.base_v))

    def rows(self, y: Array, v: Array, a: Array) -> Array:
        """G' W at samples.

        Args:
            y: Independent coordinates, shape (n, ny).
            v: Their velocities, shape (n, nv_y).
            a: Their accelerations, same shape.

        Returns:
            Shape (n, nv_y, `size`).
        """
        q, rate, push, slopes = expanded(self._model, self._couplings, y, v, a)
        whole = np.empty((len(y), self._model.nv, self.size))
        model, data, columns = self._model, self._data, zip(q.T, rate.T, push.T, strict=True)
        for row, (here, velocity, acceleration) in zip(whole, columns, strict=True):
            row[...] = pin.computeJointTorqueRegressor(model, data, here, velocity, acceleration)
        for slope, pair in zip(reversed(slopes), reversed(self._couplings.pairs), strict=True):
            whole[:, pair.parent_v] += (np.ones(len(y)) * slope)[:, None] * whole[:, pair.child_v]
        return whole[:, self._couplings.v_index] if self._couplings.pairs else whole

    def known(self, rows: Array, y: Array, v: Array, a: Array, loads: Sequence[Array]) -> Array:
        """What acts besides the inertias, shape (n, nv_y); `rows` are those of these samples."""
        tau: Array = self._solver.batch(y, v, a, list(loads)).tau
        known: Array = tau - rows @ self._given
        return known

    def carry(self, model: Any) -> None:
        """From now on `weight` is that of a model with other inertias."""
        self._carried = model

    def weight(self, y: Array) -> Array:
        """Torques that hold joints still, of the robot or that of `carry`, shape (n, nv_y)."""
        zero = np.zeros((len(y), len(self.labels)))
        q = expanded(self._model, self._couplings, y, zero, zero)[0]
        model, data, at = self._carried, self._data, self._couplings.v_index
        return np.array([pin.computeGeneralizedGravity(model, data, here)[at] for here in q.T])


def expanded(
    model: Any, couplings: Couplings, y: Array, v: Array, a: Array
) -> tuple[Array, Array, Array, Any]:
    """All coordinates of samples of the independent ones, one sample a column, and slopes."""
    n = len(y)
    q, rate, push = (np.zeros((size, n)) for size in (model.nq, model.nv, model.nv))
    q[couplings.q_index], rate[couplings.v_index], push[couplings.v_index] = y.T, v.T, a.T
    slopes = couplings.expand(q, rate, push)
    return q, rate, push, slopes


def random_states(
    robot: Robot, couplings: Couplings, count: int, seed: int = 0
) -> tuple[Array, Array, Array]:
    """States for ranks: positions within limits, velocities and accelerations of about 1.

    Args:
        robot: The robot.
        couplings: Its dependent joints.
        count: How many.
        seed: Of the random numbers.

    Returns:
        Independent coordinates, velocities and accelerations, one state a row.
    """
    random, at = np.random.default_rng(seed), IndependentCoordinates(robot, couplings)
    ny, nw = len(couplings.q_index), len(couplings.v_index)
    y, v, a = np.zeros((count, ny)), *random.normal(0.0, 2.0, (2, count, nw))
    for name, i in zip(couplings.independent, at.joint_y, strict=True):
        low, high = limits_of(robot, name)
        y[:, i] = random.uniform(low, high, count)
    for of in at.body_y:
        pose = np.hstack([random.normal(size=(count, 3)), random.normal(size=(count, 4))])
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
        y[:, of] = pose
    return y, v, a


def limits_of(robot: Robot, name: str) -> tuple[float, float]:
    """Where a joint can be [rad or m]; half a turn or half a metre where nothing says it."""
    joint = robot.joint(name)
    usual = 0.5 if joint.kind == "prismatic" else np.pi
    low, high = max(joint.lower, -2.0 * usual), min(joint.upper, 2.0 * usual)
    return (low, high) if low < high else (-usual, usual)
