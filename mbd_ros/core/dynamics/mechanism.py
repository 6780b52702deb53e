"""A robot with its `Data` and what acts on its joints, which the tiers are composed of."""

import numpy as np
import pinocchio as pin

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NONE, Array, Mode, State


class Mechanism:
    """All joints under loads; owns one Pinocchio `Data`: not for two threads.

    Pinocchio's algorithms use their local convention, the default; in that of the world rounding
    grows with the distance from its origin.

    Args:
        robot: The robot.
        loads: What acts on its joints.

    Attributes:
        robot: As given.
        loads: As given.
        model: The Pinocchio model.
        data: Its `Data`.
        k: Kinematics over `data`.
        zero: No velocity and no force, shape (nv,), not to be written to.
        evaluations: How often the equations of motion were asked.
        mode: Of the state that is evaluated, for the loads; () in accelerators.
        z: Internal states of the state that is evaluated, for loads and rows.
    """

    def __init__(self, robot: Robot, loads: Loads) -> None:
        self.robot, self.loads = robot, loads
        self.model, self.data = robot.model, pin.Data(robot.model)
        self.k = Kinematics(robot, self.data)
        self.zero: Array = np.zeros(self.model.nv)
        self.evaluations = 0
        self.mode: Mode = ()
        self.z: Array = NONE

    def tau(self, t: float, q: Array, v: Array, u: Array | None) -> Array:
        """Loads at a state of all joints, shape (nv,), not to be written to."""
        if self.loads.is_empty:
            return self.zero
        self.k.refresh(q, v, self.loads.reads)
        return self.loads.total(self.k, State(t, q, v, self.z, self.mode), u)

    def mass(self, q: Array) -> Array:
        """Mass matrix of all joints, symmetric, shape (nv, nv), overwritten by the next call."""
        M: Array = pin.crba(self.model, self.data, q)
        if not self.loads.heavy:
            return M
        x = self.placed(0.0, q, self.loads.reads)
        return M + sum(load.inertia(self.k, x) for load in self.loads.heavy)

    def added(self, q: Array, a: Array) -> Array:
        """What accelerations ask of inertia that loads add, shape (nv,)."""
        x = self.placed(0.0, q, self.loads.reads)
        return sum((load.inertia(self.k, x).dot(a) for load in self.loads.heavy), self.zero)

    def bias(self, q: Array, v: Array) -> Array:
        """The h of M a + h = tau, shape (nv,), overwritten by the next call."""
        return pin.nonLinearEffects(self.model, self.data, q, v)

    def placed(self, t: float, q: Array, reads: Reads) -> State:
        """State at rest of all joints, with k as far as it is read."""
        self.k.refresh(q, self.zero, reads)
        return State(t, q, self.zero)

    def energy(self, x: State) -> float:
        """Kinetic and potential energy [J] at a state of all joints."""
        stored = float(pin.computeMechanicalEnergy(self.model, self.data, x.q, x.v))
        self.k.refresh(x.q, x.v, min(self.loads.reads, Reads.POSITION))
        for load in self.loads.heavy:
            stored += 0.5 * float(x.v.dot(load.inertia(self.k, x)).dot(x.v))
        return stored + self.loads.potential(self.k, x)
