"""Corrections of inertias, friction and stiffness: what was learned that is linear in its numbers.

    tau = Y(q, v, a) p + sum_k c_k tanh(v / v_k) + d v + offset + k (q - q0)

with Y the regressor of inverse dynamics, so that p are ten numbers of each body that come on top
of its own. They need not be those of a body by themselves.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.inertial_parameters import COUNT, moving_bodies
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_NONE: Mapping[str, Sequence[float]] = MappingProxyType({})


class Corrections:
    """Torque and inertia of corrections, of all joints.

    Y(q, v, a) p is the difference of two robots: with p on top of some mass in each body, and with
    that mass alone, since numbers of a body without a mass cannot be written down.

    Args:
        robot: The robot.
        bodies: Body -> ten numbers that are added to its own.
        friction: Joint -> offset [N·m], viscous [N·m·s/rad], then a torque [N·m] and the velocity
            [rad/s] at which it has 76 % of its size, for each curve.
        stiffness: Joint -> k [N·m/rad] and q0 [rad].

    Raises:
        ModelError: A body or joint that the robot does not have, or numbers of another form.
    """

    def __init__(
        self,
        robot: Robot,
        bodies: Mapping[str, Sequence[float]],
        friction: Mapping[str, Sequence[float]],
        stiffness: Mapping[str, Sequence[float]] = _NONE,
    ) -> None:
        if any(len(values) != 2 for values in stiffness.values()):
            raise ModelError("the corrections of stiffness are not stiffness and rest")
        self._sprung = [robot.joint(name).v for name in stiffness]
        self._bent = [robot.joint(name).q for name in stiffness]
        self._k, self._rest_at = np.array([*stiffness.values()]).reshape(-1, 2).T
        self.has_inertia, self._nv = bool(bodies), int(robot.model.nv)
        self._pairs = _pairs(robot, bodies) if bodies else ()
        self._rest = np.zeros(self._nv)
        self._at = [robot.joint(name).v for name in friction]
        if len({len(values) for values in friction.values()}) > 1:
            raise ModelError("the corrections of friction have several lengths")
        table = np.array([*friction.values()], dtype=np.float64)
        if not self._at:
            return
        if table.shape[1] < 2 or table.shape[1] % 2 or not (table[:, 3::2] > 0.0).all():
            raise ModelError("the corrections of friction are not offset, viscous and curves")
        self._offset, self._viscous = table[:, 0], table[:, 1]
        self._size, self._bend = table[:, 2::2], table[:, 3::2]

    def torque(self, q: Array, v: Array) -> Array:
        """Torque without acceleration [N·m or N], shape (nv,)."""
        tau = np.zeros(self._nv)
        if self.has_inertia:
            heavy, light = (np.array(pin.rnea(*pair, q, v, self._rest)) for pair in self._pairs)
            tau += heavy - light
        if self._at:
            rate = v[self._at]
            dry = (self._size * np.tanh(rate[:, None] / self._bend)).sum(axis=1)
            tau[self._at] += dry + self._viscous * rate + self._offset
        if self._sprung:
            tau[self._sprung] += self._k * (q[self._bent] - self._rest_at)
        return tau

    def inertia(self, q: Array) -> Array:
        """What is added to the mass matrix, shape (nv, nv)."""
        heavy, light = (np.array(pin.crba(*pair, q)) for pair in self._pairs)
        upper = np.triu(heavy - light)
        return np.asarray(upper + np.triu(upper, 1).T)

    def potential(self, q: Array) -> float:
        """Energy of the corrections in gravity and of springs [J]."""
        found = 0.5 * float(self._k @ np.square(q[self._bent] - self._rest_at))
        if not self.has_inertia:
            return found
        heavy, light = (float(pin.computePotentialEnergy(*pair, q)) for pair in self._pairs)
        return found + heavy - light


def _pairs(robot: Robot, bodies: Mapping[str, Sequence[float]]) -> tuple[tuple[Any, Any], ...]:
    """Models with some mass in each body, with the corrections and without, and their data."""
    places = {body.name: body.joint for body in moving_bodies(robot)}
    for name, numbers in bodies.items():
        if name not in places:
            raise ModelError(f"the robot has no body '{name}', it has {', '.join(places)}")
        if len(numbers) != COUNT:
            raise ModelError(f"the correction of '{name}' has {len(numbers)} numbers, not {COUNT}")
    largest = max(abs(numbers[0]) for numbers in bodies.values())
    some = (1.0 + 2.0 * largest) * np.eye(COUNT)[0]
    with_them, without = robot.model.copy(), robot.model.copy()
    for joint in range(1, robot.model.njoints):
        without.inertias[joint] = pin.Inertia.FromDynamicParameters(some)
        with_them.inertias[joint] = without.inertias[joint]
    for name, numbers in bodies.items():
        whole = pin.Inertia.FromDynamicParameters(some + np.array(numbers))
        with_them.inertias[places[name]] = whole
    return tuple((model, pin.Data(model)) for model in (with_them, without))
