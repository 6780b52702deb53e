"""Loads on bodies that come from outside: measured, or given by a source."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts.parts import Channel, Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State

_CHANNELS = tuple(
    Channel(f"{letter}{axis}", unit)
    for letter, unit in (("F", "N"), ("M", "N·m"))
    for axis in "xyz"
)


class ExternalWrench(Load):
    """A load that acts on one body, given in one frame about one point: six inputs.

    Args:
        robot: Robot of the scene.
        frame: Link that carries the load.
        expressed_in: Frame whose axes and, without `point`, whose origin the load refers to;
            `frame` by default.
        point: Point that the torque is taken about, in `expressed_in`, shape (3,).
        threshold: Force norm below which the load counts as zero. A force plate whose centre of
            pressure is undefined at little load needs one.

    Attributes:
        carrier: The joint that carries the link.
        about: The point that the torque is taken about, with the axes of `expressed_in`.

    Raises:
        ModelError: Unknown frame.
    """

    reads = Reads.JACOBIAN
    inputs = _CHANNELS

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        expressed_in: str | None = None,
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        threshold: Annotated[NotNegative, Unit("N")] = 0.0,
    ) -> None:
        self.frame, self.expressed_in = frame, expressed_in or frame
        self.point, self.threshold = tuple(point), threshold
        self.carrier = robot.carrier(frame)
        self.about = robot.point(self.expressed_in, point)
        self._nv = int(robot.model.nv)

    def is_loaded(self, wrench: Array) -> bool:
        """Whether the force exceeds the threshold; without a threshold every load counts."""
        return self.threshold == 0.0 or float(np.linalg.norm(wrench[:3])) > self.threshold

    def in_body(self, k: Kinematics, wrench: Array) -> Array:
        """The load about the origin and in the axes of `carrier`, shape (6,).

        Args:
            k: Kinematics at positions.
            wrench: Force [N] then torque [N·m] in `expressed_in`, shape (6,).
        """
        return k.carried(wrench, self.about, self.carrier)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        return self.force_of(k, u[self.u])

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Forces of unit inputs, shape (nv, 6); None with a threshold, where the force jumps."""
        if self.threshold > 0.0:
            return None
        return np.column_stack([self.force_of(k, unit) for unit in np.eye(6)])

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The load on the link."""
        return self.wrenches_of(k, u[self.u])

    def force_of(self, k: Kinematics, wrench: Array) -> Array:
        """Generalized force of a load [N, N·m], shape (nv,)."""
        if not self.carrier.moves:
            return k.zeros(self._nv)
        return k.either(
            self._acts(k, wrench),
            lambda: k.dot(self.in_body(k, wrench), k.own_jacobian(self.carrier)),
            lambda: k.zeros(self._nv),
        )

    def _acts(self, k: Kinematics, wrench: Array) -> bool:
        if self.threshold > 0.0:
            return k.hypot(wrench[:3]) > self.threshold
        return k.any(wrench)

    def wrenches_of(self, k: Kinematics, wrench: Array) -> tuple[Wrench, ...]:
        """A load [N, N·m] on the link, about the origin of the joint that carries it."""
        acts = self.threshold == 0.0 or k.hypot(wrench[:3]) > self.threshold
        share = k.where(acts, 1.0, 0.0)
        if not k.any(np.array([share])):
            return ()
        carrier, load = self.carrier, self.in_body(k, wrench) * share
        axes, place = k.rotation(carrier), k.position(carrier)
        return (Wrench(self.frame, place, axes.dot(load[:3]), axes.dot(load[3:])),)
