"""Wrench on a link that follows a table over time."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.inputs import LinearTable
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Length, NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class PrescribedWrench(Load):
    """Wrench on a link from a table over time: tau = J' w(t), linear between samples.

    The wrench is zero before the first and after the last sample, so it jumps there unless the
    table begins and ends with zeros. If the frame `expressed_in` does not move, the force stays at
    its place in the world while the link moves.

    Args:
        frame: Link that the wrench acts on.
        times: Times of the samples, strictly increasing, shape (n,), n >= 2.
        wrenches: Force, then torque, one row per sample, shape (n, 6).
        expressed_in: Frame in whose axes the wrench is given, about its origin if there is no
            `point`; `frame` by default. `universe` is the world, for robots that do not name it.
        point: Point in `expressed_in` that the torque is about, shape (3,).
        threshold: Norm of the force below which the wrench counts as zero.
    """

    reads = Reads.JACOBIAN
    example = {
        "frame": "foot",
        "times": [0.0, 0.5, 1.0],
        "wrenches": [[10.0, 0, 50, 0, 0, 0], [0, 0, 80, 0, 5, 0], [0, 0, 0, 0, 0, 0]],
    }

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        times: Annotated[Sequence[float], Unit("s")],
        wrenches: Annotated[Sequence[Annotated[Sequence[float], Length(6)]], Unit("N, then N·m")],
        expressed_in: str | None = None,
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        threshold: Annotated[NotNegative, Unit("N")] = 0.0,
    ) -> None:
        self._load = ExternalWrench(
            robot, frame=frame, expressed_in=expressed_in, point=point, threshold=threshold
        )
        self._table = LinearTable(np.array(times), np.array(wrenches))

    @staticmethod
    def check(times: Sequence[float], wrenches: Sequence[Sequence[float]]) -> None:
        """Refuse times that do not increase, and another number of wrenches."""
        if len(times) < 2 or not (np.diff(times) > 0).all():
            raise ModelError("times must be at least two increasing numbers")
        if len(wrenches) != len(times):
            raise ModelError(
                f"wrenches has {len(wrenches)} rows, but times has {len(times)}; give one row per "
                "time"
            )

    def wrench(self, t: float) -> Array:
        """Return force [N] and torque [N·m] of the table at a time [s], shape (6,)."""
        return self._table.at(t)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        return self._load.force_of(k, self.wrench(x.t))

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the wrench on the link, about the origin of the joint that carries the link."""
        return self._load.wrenches_of(k, self.wrench(x.t))
