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
    """A wrench read from a table, tau = J' w(t): straight lines between samples.

    The load is zero before the first and after the last sample, so it jumps there unless the table
    begins and ends with zeros. Frame, axes, point and threshold are those of an external wrench:
    with `expressed_in` at rest, the force stays at one place while the link moves.

    Args:
        frame: Link that carries the load.
        times: Times of the samples, strictly increasing, shape (n,), n >= 2.
        wrenches: Force, then torque, one row a sample, shape (n, 6).
        expressed_in: Frame whose axes and, without `point`, whose origin the load refers to;
            `frame` by default, `universe` for the world of a robot that names none.
        point: Point that the torque is taken about, in `expressed_in`, shape (3,).
        threshold: Force norm below which the load counts as zero.
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
        """Refuse a table that is none."""
        if len(times) < 2 or not (np.diff(times) > 0).all():
            raise ModelError("times must be at least two increasing numbers")
        if len(wrenches) != len(times):
            raise ModelError(f"wrenches: {len(wrenches)} rows for {len(times)} times")

    def wrench(self, t: float) -> Array:
        """Force [N] and torque [N·m] of the table at a time [s], shape (6,)."""
        return self._table.at(t)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        return self._load.force_of(k, self.wrench(x.t))

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The load on the link, about the origin of the joint that carries it."""
        return self._load.wrenches_of(k, self.wrench(x.t))
