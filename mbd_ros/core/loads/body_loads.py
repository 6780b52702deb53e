"""Forces on the bodies of a robot, as `pin.rnea` takes them."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts.parts import Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.external_wrench import ExternalWrench
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_UNLOADED = pin.Force.Zero()


class BodyLoads:
    """Sum of wrenches on every body, in the frame of the joint that carries it.

    Args:
        robot: The robot.
        wrenches: External loads, in the order in which `set` takes their values.

    Attributes:
        forces: `pin.Force` of every joint, a live view.
    """

    def __init__(self, robot: Robot, wrenches: Sequence[ExternalWrench] = ()) -> None:
        self._robot, self._wrenches = robot, tuple(wrenches)
        self._origin = robot.carrier("universe")
        self._loaded: list[int] = []
        self.forces = pin.StdVec_Force()
        for _ in range(robot.model.njoints):
            self.forces.append(pin.Force.Zero())

    def set(self, k: Kinematics, values: Sequence[Array]) -> None:
        """Replace all loads by the external ones.

        Args:
            k: Kinematics at positions.
            values: One (6,) array [N, N·m] for every external load; none means unloaded.

        Raises:
            ModelError: Another number of values.
        """
        if len(values) not in (0, len(self._wrenches)):
            raise ModelError(f"{len(values)} wrenches given, the scene has {len(self._wrenches)}")
        for body in self._loaded:
            self.forces[body] = _UNLOADED
        self._loaded.clear()
        for load, value in zip(self._wrenches, values, strict=False):
            if load.is_loaded(value):
                self._add(load.carrier, load.in_body(k, value))

    def add(self, k: Kinematics, wrench: Wrench) -> None:
        """Add what a part exerts on a body; on the world it has no effect."""
        carrier = self._robot.carrier(wrench.frame)
        about_origin = wrench.torque + np.cross(wrench.point, wrench.force)
        whole = np.concatenate((wrench.force, about_origin))
        self._add(carrier, k.carried(whole, self._origin, carrier))

    def _add(self, carrier: Point, load: Array) -> None:
        body = self._robot.places.points[carrier.number].joint
        self.forces[body] = self.forces[body] + pin.Force(load)
        self._loaded.append(body)
