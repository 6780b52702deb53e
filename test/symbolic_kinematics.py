"""A kinematics k of CasADi symbols: forward kinematics from the model, derivatives by CasADi."""

import casadi as ca
import numpy as np
import pinocchio as pin

from mbd_ros.core.state import State


class SymbolicKinematics:
    """What parts ask k for, as expressions of the state `x`; for robots with a fixed base.

    Vectors are columns.
    """

    sqrt, tanh, hypot = map(staticmethod, (ca.sqrt, ca.tanh, ca.norm_2))
    maximum, where, zeros = map(staticmethod, (ca.fmax, ca.if_else, ca.SX.zeros))

    def __init__(self, robot, nz=0):
        nv = robot.model.nv
        self.x = State(0.0, ca.SX.sym("q", nv), ca.SX.sym("v", nv), ca.SX.sym("z", nz))
        self._places, self._joints = robot.places, _placements(robot.model, self.x.q)

    def position(self, point):
        joint, at = self._places.points[point.number]
        R, p = self._joints[joint]
        return p + R @ at.translation

    def jacobian(self, point):
        return ca.jacobian(self.position(point), self.x.q)

    def velocity(self, point):
        return self.jacobian(point) @ self.x.v

    def acceleration(self, point):
        return ca.jacobian(self.velocity(point), self.x.q) @ self.x.v

    @staticmethod
    def item(vector, index):
        return vector[index]

    @staticmethod
    def dot(a, b):
        """As for numpy: vector and vector, vector and matrix, or matrix and vector."""
        return (a.T @ b).T if a.shape[1] == 1 else a @ b

    @staticmethod
    def array(values):
        return ca.vertcat(*values)

    @staticmethod
    def either(condition, first, second):
        """Both, since nobody knows which; of tuples entry by entry."""
        pair = first(), second()
        if not isinstance(pair[0], tuple):
            return ca.if_else(condition, *pair)
        return tuple(ca.if_else(condition, *both) for both in zip(*pair, strict=True))

    @staticmethod
    def row(vector):
        return vector.T

    def number(self, expression, x):
        """What an expression is at a state in numbers."""
        f = ca.Function("f", self.x[1:4], [ca.densify(ca.SX(expression))])
        return np.array(f(*x[1:4]))


def _placements(model, q):
    """Rotation and place of every joint in the world."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    placed = [(ca.SX.eye(3), ca.SX.zeros(3))]
    for i, joint in list(enumerate(model.joints))[1:]:
        axis = pin.getJointJacobian(model, data, i, pin.LOCAL).reshape(6, -1)[:, joint.idx_v]
        before, at, value = placed[model.parents[i]], model.jointPlacements[i], q[joint.idx_q]
        R, p = before[0] @ at.rotation, before[1] + before[0] @ at.translation
        cross = pin.skew(axis[3:])
        turn = np.eye(3) + ca.sin(value) * cross + (1 - ca.cos(value)) * (cross @ cross)
        placed.append((R @ turn, p + R @ (axis[:3] * value)))
    return placed
