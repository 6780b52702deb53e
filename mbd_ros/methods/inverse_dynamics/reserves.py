"""Reserve actuators: forces on coordinates and bodies that supplement muscles.

The unknown of a reserve is its effort, the force divided by its optimal force. A larger optimal
force therefore makes a reserve cheaper.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Length, Positive, Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

UNBOUNDED = (-math.inf, math.inf)
_AXES = tuple(f"{kind}_{axis}" for kind in ("linear", "angular") for axis in "xyz")


class CoordinateReserve(NamedTuple):
    """Reserve force on one coordinate, between parent and child of its joint.

    Attributes:
        name: Name, unique among muscles and reserves.
        optimal: Force at effort 1 [N·m or N].
        unit: N·m or N.
        at: Index of the coordinate in v.
        limits: Smallest and largest effort.
    """

    name: str
    optimal: float
    unit: str
    at: int
    limits: tuple[float, float] = UNBOUNDED


class BodyReserve:
    """External reserve force and torque on a body, both in fixed directions.

    Args:
        name: Name of the reserve, without a dot.
        frame: Link on which it acts.
        force: Direction of the force, scaled by its share of the optimal force.
        torque: Direction of the torque, scaled by its share of the optimal force [m or 1].
        point: Point of application in axes of the link.
        expressed_in: Axes of the directions: `world`, or the name of the link.
        optimal_force: Force, or torque where there is no force, at effort 1.
        bounds: Smallest and largest effort; unbounded by default.

    Raises:
        ModelError: Unknown frame, or neither a force nor a torque.
    """

    reads = Reads.JACOBIAN

    def __init__(
        self,
        robot: Robot,
        *,
        name: str,
        frame: str,
        force: Annotated[Vector, Unit("-")] = (0.0, 0.0, 0.0),
        torque: Annotated[Vector, Unit("-")] = (0.0, 0.0, 0.0),
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        expressed_in: str = "world",
        optimal_force: Annotated[Positive, Unit("N or N·m")] = 1.0,
        bounds: Annotated[Sequence[float], Length(2), Unit("-")] = UNBOUNDED,
    ) -> None:
        if "." in name or not name:
            raise ModelError(
                f"residual '{name}': the name must not be empty and must not contain a dot"
            )
        if expressed_in not in ("world", frame):
            raise ModelError(
                f"residual {name}: expressed_in is '{expressed_in}', accepted: world, {frame}"
            )
        self.name, self.frame, self.optimal = name, frame, optimal_force
        self._load = np.array([*force, *torque], dtype=np.float64)
        if not self._load.any():
            raise ModelError(
                f"residual {name}: force and torque are both zero; one needs a direction"
            )
        self.limits = float(bounds[0]), float(bounds[1])
        self.unit = "N" if self._load[:3].any() else "N·m"
        self._is_local = expressed_in != "world"
        self._point = robot.point(frame, point)

    def column(self, k: Kinematics, x: State) -> Array:
        """Return the generalized force per unit of force, shape (nv,)."""
        force, torque = self._now(k)
        J = k.spatial_jacobian(self._point)
        column: Array = force.dot(J[:3]) + torque.dot(J[3:])
        return column

    def wrenches(self, k: Kinematics, x: State, value: float) -> tuple[Wrench, ...]:
        """Return the wrenches on bodies.

        Args:
            k: Kinematics, refreshed at positions.
            value: Force of the reserve [N or N·m].
        """
        force, torque = self._now(k)
        return (Wrench(self.frame, k.position(self._point), value * force, value * torque),)

    def _now(self, k: Kinematics) -> tuple[Array, Array]:
        if not self._is_local:
            return self._load[:3], self._load[3:]
        R = k.rotation(self._point)
        return R.dot(self._load[:3]), R.dot(self._load[3:])


class InputReserve:
    """Reserve that is an input of a part, such as a motor, whose force is affine in the input.

    The optimal force is the limit of the input, or 1 if it has no limit.

    Args:
        name: Name of the reserve, without a dot.
        part: The part, bound to its slots in u.
        place: Index of the input among those of the part.
    """

    def __init__(self, name: str, part: Load, place: int) -> None:
        channel = part.inputs[place]
        self.name, self.unit, self.reads = name, channel.unit, part.reads
        size = max(abs(channel.lower), abs(channel.upper))
        self.optimal = size if size < math.inf else 1.0
        self.limits = channel.lower / self.optimal, channel.upper / self.optimal
        self._part, self._place = part, place

    def column(self, k: Kinematics, x: State) -> Array:
        """Return the generalized force per unit of the input, shape (nv,)."""
        columns: Any = self._part.columns(k, x)
        return np.asarray(columns[:, self._place])

    def wrenches(self, k: Kinematics, x: State, value: float) -> tuple[Wrench, ...]:
        """Return the wrenches on bodies, see `BodyReserve.wrenches`."""
        u = np.zeros(self._part.u.stop)
        u[self._part.u.start + self._place] = value
        return self._part.wrenches(k, x, u)


Reserve = CoordinateReserve | BodyReserve | InputReserve


def coordinate_reserves(
    robot: Robot, couplings: Couplings, optimal: float, without: Sequence[str] = ()
) -> list[CoordinateReserve]:
    """Return a reserve for every independent coordinate, including the six of each free base.

    Args:
        couplings: Dependent joints, which get no reserve.
        optimal: Force of each reserve at effort 1 [N·m or N].
        without: Independent joints that get no reserve.
    """
    reserves = [
        joint_reserve(robot, couplings, joint, optimal)
        for joint in couplings.independent
        if joint not in without
    ]
    for base in robot.bases:
        for i, axis in enumerate(_AXES):
            unit = "N" if i < 3 else "N·m"
            name = f"{base.name}_{axis}_reserve"
            reserves.append(CoordinateReserve(name, optimal, unit, base.v.start + i))
    return reserves


def joint_reserve(
    robot: Robot,
    couplings: Couplings,
    joint: str,
    optimal: float,
    name: str = "",
    bounds: tuple[float, float] = UNBOUNDED,
) -> CoordinateReserve:
    """Return a reserve on one joint.

    Args:
        couplings: Dependent joints, which cannot have a reserve.
        joint: Name of an independent joint.
        optimal: Force at effort 1 [N·m or N].
        name: Name of the reserve; `<joint>_reserve` by default.
        bounds: Smallest and largest effort.

    Raises:
        ModelError: The joint is unknown, or depends on another one.
    """
    target = robot.joint(joint)
    if joint not in couplings.independent:
        raise ModelError(
            f"reserve {joint}: the joint depends on {couplings.parents[joint]}; choose that "
            f"joint; accepted: {', '.join(couplings.independent)}"
        )
    unit = "N" if target.kind == "prismatic" else "N·m"
    return CoordinateReserve(name or f"{joint}_reserve", optimal, unit, int(target.v), bounds)
