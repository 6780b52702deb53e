"""Contracts of the parts of a scene.

A part reads `data`, never runs a Pinocchio algorithm that writes it, never changes its inputs, and
keeps no memory of earlier states. Positions in `data` are counted from `Robot.origin`; those of
frames at rest, the world among them, stand in `model.frames`.
"""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mbd_ros.core.model.robot import Joint
from mbd_ros.core.state import Array, State


class ForceTerm:
    """A generalized force that depends on time, configuration and velocity.

    Attributes:
        reads_frames: Whether `force` reads placements, velocities or joint Jacobians from `data`;
            they are current then, and not refreshed for parts that do not ask.
        brings: Entries of the `<dynamics>` of its `joint` that it covers: friction, damping.
    """

    reads_frames: ClassVar[bool] = False
    brings: tuple[str, ...] = ()

    def force(self, data: Any, x: State) -> Array:
        """Generalized force on the joints [N·m or N], shape (nv,)."""
        raise NotImplementedError

    def beside(self, data: Any, x: State) -> "ForceTerm":
        """The force near a state, smooth across the surfaces at which it jumps."""
        return self

    def potential(self, data: Any, x: State) -> float:
        """Potential energy of what is conservative in the force [J]."""
        return 0.0

    def wrenches(self, data: Any, x: State) -> "tuple[Wrench, ...]":
        """Wrenches on bodies; empty for a force in joints, between parent and child."""
        return ()


class Actuator:
    """Commands -> torques of the joints that it drives.

    Attributes:
        joints: Topic names of the driven joints, one command each.
        takes: Meaning and unit of a command; empty where it is the torque of the joint.
    """

    joints: tuple[str, ...]
    takes: str = ""

    def torque(self, u: Array, x: State) -> Array:
        """Generalized force [N·m or N], shape (nv,).

        Args:
            u: Commands of `joints`, shape (len(joints),).
            x: State.
        """
        raise NotImplementedError

    def command(self, torque: Array, x: State) -> Array:
        """Commands that ask for a torque, shape (len(joints),); here the torque itself.

        Args:
            torque: Of `joints` [N·m or N], shape (len(joints),). Losses and limits of the actuator
                are not compensated.
            x: State.
        """
        return torque

    def demanded(self, torque: Array, x: State) -> Array:
        """Commands that give a torque, losses compensated, shape (len(joints),).

        `torque` of them is that torque again, unless it is beyond a limit. For recordings: live,
        noise of the velocity would come back as force.

        Args:
            torque: Of `joints` [N·m or N], shape (len(joints),).
            x: State.
        """
        return self.command(torque, x)

    def limits(self) -> Array:
        """Largest torque of each of `joints` [N·m or N], shape (len(joints),), inf without."""
        return np.full(len(self.joints), math.inf)

    def armature(self) -> Array:
        """Inertia that the drive adds to the joints [kg·m^2 or kg], shape (nv,) or scalar 0."""
        return np.zeros(1)


class Row(NamedTuple):
    """One scalar equation of a constraint, for readers of its multiplier.

    Attributes:
        name: Name of the equation, such as `knee_loop.x`.
        unit: Unit of the multiplier: N, N·m, ..
        frame: Frame in whose axes the multiplier stands; empty in joint space.
    """

    name: str
    unit: str
    frame: str = ""


class Wrench(NamedTuple):
    """Wrench of a constraint on one body.

    Attributes:
        frame: The link.
        point: Where the force acts, in the world less `Robot.origin` [m], shape (3,).
        force: In world axes [N], shape (3,).
        torque: About `point`, in world axes [N·m], shape (3,).
    """

    frame: str
    point: Array
    force: Array
    torque: Array


class Stop(NamedTuple):
    """Ends that a constraint keeps a joint within.

    Attributes:
        joint: The joint.
        lower: Lower end [rad or m], -inf without one.
        upper: Upper end [rad or m], inf without one.
    """

    joint: Joint
    lower: float
    upper: float


class Constraint:
    """Geometry of rows g(t, q) = 0 with the equation of motion M a + h = tau + J' lam.

        g' = J v + rate(t),   g'' = J a + drift

    Attributes:
        rows: One entry a row.
        reads_frames: Whether it reads placements, velocities, accelerations at zero joint
            acceleration (for the drift) and joint Jacobians from `data`; they are current then.
        bounds: Smallest and largest multiplier of every row, each (m,), or None where all are
            free. With lam inside, g'' + kd g' + kp g = 0; at the lower bound it may be
            positive, at the upper one negative.
        gains: kp [1/s^2] and kd [1/s] of that condition; read for bounded rows only.
        driven: Joints whose drives exert the multipliers, one a row, or none: inverse dynamics
            then asks for the multipliers and demands nothing of the motion.
        stops: Joints that it keeps within ends; a motion that passes one is reported.
    """

    rows: tuple[Row, ...]
    reads_frames: ClassVar[bool] = False
    bounds: tuple[Array, Array] | None = None
    gains: tuple[float, float] = (0.0, 0.0)
    driven: tuple[str, ...] = ()
    stops: tuple[Stop, ...] = ()

    def residual(self, data: Any, x: State) -> Array:
        """g(t, q), shape (m,)."""
        raise NotImplementedError

    def jacobian(self, data: Any, x: State) -> Array:
        """J = dg/dq, shape (m, nv)."""
        raise NotImplementedError

    def drift(self, data: Any, x: State) -> Array:
        """The part of g'' without the acceleration, J' v included, shape (m,)."""
        raise NotImplementedError

    def accelerations(self, data: Any, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`; for parts where one costs less with the other."""
        return self.jacobian(data, x), self.drift(data, x)

    def rate(self, x: State) -> Array:
        """The part of g' without the velocity, shape (m,)."""
        return np.zeros(len(self.rows))

    def quick_margin(self, q: Array, v: Array, a: Array) -> float:
        """A cheap lower bound of w = g'' + kd g' + kp g; for rows with lower bound 0 only.

        No row acts where it is >= 0; then nothing else of the constraint is evaluated.

        Args:
            q: Configuration, shape (nq,).
            v: Velocity, shape (nv,).
            a: Acceleration without the bounded rows, shape (nv,).
        """
        return -math.inf

    def wrenches(self, data: Any, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Wrenches of the multipliers, shape (m,), on bodies; empty where no frame exists."""
        return ()
