"""What helps muscles where they cannot carry a load: reserves in coordinates and on bodies.

Their unknown is the effort in optimal forces: the larger the optimal force, the less a reserve
costs.
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
    """Force of one coordinate, between parent and child of its joint.

    Attributes:
        name: Unique among muscles and reserves.
        optimal: Force at effort 1 [N·m or N].
        unit: N·m or N.
        at: Its place among velocities.
        limits: Smallest and largest effort.
    """

    name: str
    optimal: float
    unit: str
    at: int
    limits: tuple[float, float] = UNBOUNDED


class BodyReserve:
    """A force and a torque on a body, from outside, both in fixed directions.

    Args:
        name: Of the reserve, without a dot.
        frame: Link that it acts on.
        force: Direction of the force and its share of the optimal force.
        torque: The same of the torque [m or 1].
        point: Where the force acts, in axes of the link.
        expressed_in: `world`, or the name of the link: whose axes the directions are in.
        optimal_force: Force, or torque where there is no force, at effort 1.
        bounds: Smallest and largest effort; none by default.

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
            raise ModelError(f"residual '{name}': a name has letters and no dot")
        if expressed_in not in ("world", frame):
            raise ModelError(
                f"residual {name}: expressed_in is '{expressed_in}', accepted: world, {frame}"
            )
        self.name, self.frame, self.optimal = name, frame, optimal_force
        self._load = np.array([*force, *torque], dtype=np.float64)
        if not self._load.any():
            raise ModelError(f"residual {name}: gives neither a force nor a torque")
        self.limits = float(bounds[0]), float(bounds[1])
        self.unit = "N" if self._load[:3].any() else "N·m"
        self._turns = expressed_in != "world"
        self._point = robot.point(frame, point)

    def column(self, k: Kinematics, x: State) -> Array:
        """Generalized force per unit of force, shape (nv,)."""
        force, torque = self._now(k)
        J = k.spatial_jacobian(self._point)
        column: Array = force.dot(J[:3]) + torque.dot(J[3:])
        return column

    def wrenches(self, k: Kinematics, x: State, value: float) -> tuple[Wrench, ...]:
        """What it exerts on bodies.

        Args:
            k: Kinematics at positions.
            value: Force [N or N·m].
        """
        force, torque = self._now(k)
        return (Wrench(self.frame, k.position(self._point), value * force, value * torque),)

    def _now(self, k: Kinematics) -> tuple[Array, Array]:
        if not self._turns:
            return self._load[:3], self._load[3:]
        R = k.rotation(self._point)
        return R.dot(self._load[:3]), R.dot(self._load[3:])


class InputReserve:
    """An input of a part whose force is affine in it: a motor, a force that somebody commands.

    Its optimal force is the limit of the input, 1 without one.

    Args:
        name: Of the reserve, without a dot.
        part: Bound to its slots.
        place: Of the input among those of the part.
    """

    def __init__(self, name: str, part: Load, place: int) -> None:
        channel = part.inputs[place]
        self.name, self.unit, self.reads = name, channel.unit, part.reads
        size = max(abs(channel.lower), abs(channel.upper))
        self.optimal = size if size < math.inf else 1.0
        self.limits = channel.lower / self.optimal, channel.upper / self.optimal
        self._part, self._place = part, place

    def column(self, k: Kinematics, x: State) -> Array:
        """Generalized force per unit of the input, shape (nv,)."""
        columns: Any = self._part.columns(k, x)
        return np.asarray(columns[:, self._place])

    def wrenches(self, k: Kinematics, x: State, value: float) -> tuple[Wrench, ...]:
        """What it exerts on bodies; arguments as of `BodyReserve`."""
        u = np.zeros(self._part.u.stop)
        u[self._part.u.start + self._place] = value
        return self._part.wrenches(k, x, u)


Reserve = CoordinateReserve | BodyReserve | InputReserve


def coordinate_reserves(
    robot: Robot, couplings: Couplings, optimal: float, without: Sequence[str] = ()
) -> list[CoordinateReserve]:
    """One on every independent coordinate, the six of a free base too.

    Args:
        couplings: Its dependent joints.
        optimal: Force of each at effort 1 [N·m or N].
        without: Joints that need none.
    """
    reserves = [
        reserve_on(robot, couplings, joint, optimal)
        for joint in couplings.independent
        if joint not in without
    ]
    for base in robot.bases:
        for i, axis in enumerate(_AXES):
            unit = "N" if i < 3 else "N·m"
            name = f"{base.name}_{axis}_reserve"
            reserves.append(CoordinateReserve(name, optimal, unit, base.v.start + i))
    return reserves


def reserve_on(
    robot: Robot,
    couplings: Couplings,
    joint: str,
    optimal: float,
    name: str = "",
    bounds: tuple[float, float] = UNBOUNDED,
) -> CoordinateReserve:
    """One on a joint.

    Args:
        couplings: Its dependent joints.
        joint: An independent one.
        optimal: Force at effort 1 [N·m or N].
        name: Of the reserve; default `<joint>_reserve`.
        bounds: Smallest and largest effort.

    Raises:
        ModelError: The joint is unknown, or depends on another one.
    """
    found = robot.joint(joint)
    if joint not in couplings.independent:
        raise ModelError(
            f"reserve {joint}: the joint depends on {couplings.parents[joint]}, give that one; "
            f"accepted: {', '.join(couplings.independent)}"
        )
    unit = "N" if found.kind == "prismatic" else "N·m"
    return CoordinateReserve(name or f"{joint}_reserve", optimal, unit, int(found.v), bounds)
