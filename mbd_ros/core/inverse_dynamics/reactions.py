"""Reactions of joints, six components each: backward pass of the Newton-Euler recursion."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts.parts import Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.body_loads import BodyLoads
from mbd_ros.core.loads.external_wrench import ExternalWrench
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import NONE, Array, State


class Reactions(NamedTuple):
    """Wrenches between bodies.

    Attributes:
        local: Wrench of the parent of every joint on its child: force [N], then torque [N·m]
            about the origin of the joint, in the axes of the joint on the child, shape (n, 6).
            Along the axis of the joint it is the sum of actuator (without the torque on its own
            rotor, the armature), springs, friction and tendons.
        world: The same in world axes, about the same point, shape (n, 6).
        closures: Wrenches of constraints on bodies.
    """

    local: Array
    world: Array
    closures: tuple[Wrench, ...]


class JointReactions:
    """Reaction wrenches of the joints of a tree, with loops closed by constraints.

    Springs, actuators, couplings and friction of a joint act between its parent and its child.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        robot: The robot; reactions come in the order of its joints.
        constraints: The rows that multipliers are given for.
        wrenches: External loads, in the order in which `solve` takes their values.
        forces: Force terms; those that act on bodies count as loads.
    """

    def __init__(
        self,
        robot: Robot,
        constraints: ConstraintRows,
        wrenches: Sequence[ExternalWrench] = (),
        forces: Sequence[Load] = (),
    ) -> None:
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._constraints = constraints
        self._k, self._forces = Kinematics(robot, self._data), tuple(forces)
        self._loads = BodyLoads(robot, wrenches)
        at = {int(joint.idx_v): i for i, joint in enumerate(robot.model.joints) if i}
        self._joints = [at[joint.v] for joint in robot.joints]

    def solve(
        self,
        x: State,
        a: Array,
        multipliers: Array,
        wrenches: Sequence[Array] = (),
        u: Array = NONE,
    ) -> Reactions:
        """Reactions of a motion that satisfies the equation of motion.

        Args:
            x: State of all joints.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            multipliers: One a row of the constraints, shape (m,).
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.
            u: All inputs; none where no force reads any.
        """
        model, data = self._model, self._data
        self._k.refresh(x.q, x.v)
        closures = self._constraints.wrenches(self._k, x, multipliers)
        self._loads.set(self._k, wrenches)
        exerted = (w for force in self._forces for w in force.wrenches(self._k, x, u))
        for wrench in (*closures, *exerted):
            self._loads.add(self._k, wrench)
        pin.rnea(model, data, x.q, x.v, a, self._loads.forces)
        local = np.array([data.f[i].vector for i in self._joints]).reshape(-1, 6)
        turns = np.array([data.oMi[i].rotation for i in self._joints]).reshape(-1, 3, 3)
        world = np.einsum("nij,nkj->nki", turns, local.reshape(-1, 2, 3)).reshape(-1, 6)
        return Reactions(local, world, closures)
