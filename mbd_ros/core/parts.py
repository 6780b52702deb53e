"""Contracts of the parts of a scene.

A part binds points and frames while it is built and asks the kinematics k for them at a state; it
never changes its inputs, and keeps no memory of earlier states. Positions are counted from
`Robot.origin`.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Joint
from mbd_ros.core.names import type_name
from mbd_ros.core.outputs import Now, Output, Value
from mbd_ros.core.row_laws import Law, Level, bilateral
from mbd_ros.core.state import Array, Mode, State


class Channel(NamedTuple):
    """One number that a part takes from outside while it runs.

    Attributes:
        name: Unique in the part; empty where the part has only one.
        unit: N·m, rad, ..
        lower: Smallest value that has an effect, -inf without.
        upper: Largest one, inf without.
        safe: Value where nobody gives one that can be trusted.
    """

    name: str
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    safe: float = 0.0


class Slots(NamedTuple):
    """Where the numbers of a part stand.

    Attributes:
        inputs: In u.
        internal: In the z of a state.
    """

    inputs: slice
    internal: slice


class Part:
    """What a scene is made of.

    Attributes:
        name: Unique in the scene, without a dot; the type of a part that no scene has built.
        reads: What its methods read of k at most.
        inputs: What it takes from outside while it runs.
        outputs: What it shows besides the multipliers of its rows.
        u: Its inputs in the u of the scene; all of u until it is bound.
        z: Its internal states in the z of a state; all of z until it is bound.
    """

    name: str = ""
    reads: Reads = Reads.NOTHING
    inputs: tuple[Channel, ...] = ()
    outputs: tuple[Output, ...] = ()
    u: slice = slice(None)
    z: slice = slice(None)

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.name = type_name(cls)

    def bind(self, slots: Slots) -> None:
        """Learn where its numbers stand; once, when all parts are known."""
        self.u, self.z = slots

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Values of `outputs`, in their order; asked for at samples only.

        Args:
            k: Kinematics at the state, refreshed as far as `reads` says.
            x: State of all joints.
            u: All inputs.
            now: Accelerations, and the multipliers of the own rows.
        """
        return ()


class Load(Part):
    """A generalized force that depends on a state and on inputs, never on accelerations.

    Attributes:
        brings: Entries of the `<dynamics>` of its `joint` that it covers: friction, damping.
    """

    brings: tuple[str, ...] = ()

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force on the joints [N·m or N], shape (nv,)."""
        raise NotImplementedError

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Slopes of an affine force: force(u) = force(0) + columns u, shape (nv, len(inputs)).

        That holds while every input is within the bounds of its channel.

        Returns:
            None where the force is not affine in the inputs.
        """
        return None

    def beside(self, k: Kinematics, x: State) -> "Load":
        """The force near a state, smooth across the surfaces at which it jumps."""
        return self

    def potential(self, k: Kinematics, x: State) -> float:
        """Potential energy of what is conservative in the force [J]."""
        return 0.0

    def wrenches(self, k: Kinematics, x: State, u: Array) -> "tuple[Wrench, ...]":
        """Wrenches on bodies; empty for a force in joints, between parent and child."""
        return ()

    def armature(self) -> Array:
        """Inertia that it adds to the joints [kg·m^2 or kg], shape (nv,) or (1,) of 0."""
        return np.zeros(1)


class Actuator(Load):
    """Commands -> torques of the joints that it drives; its inputs are the commands.

    Attributes:
        joints: Topic names of the driven joints.
        takes: Meaning and unit of a command; empty where it is the torque of the joint.
    """

    joints: tuple[str, ...]
    takes: str = ""

    def command(self, torque: Array, x: State) -> Array:
        """Commands that ask for a torque, shape (len(inputs),); here the torque itself.

        Args:
            torque: Of `joints` [N·m or N], shape (len(joints),). Losses and limits of the actuator
                are not compensated.
            x: State.
        """
        return torque

    def demanded(self, torque: Array, x: State) -> Array:
        """Commands that give a torque, losses compensated, shape (len(inputs),).

        The force of them is that torque again, unless it is beyond a limit. For recordings: live,
        noise of the velocity would come back as force.

        Args:
            torque: Of `joints` [N·m or N], shape (len(joints),).
            x: State.
        """
        return self.command(torque, x)

    def limits(self) -> Array:
        """Largest torque of each of `joints` [N·m or N], shape (len(joints),), inf without."""
        return np.full(len(self.joints), math.inf)


class Row(NamedTuple):
    """One scalar equation of a constraint, for readers of its multiplier.

    Attributes:
        name: Of the multiplier in the part, such as `force_x`; columns put that of the part first.
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


class Constraint(Part):
    """Geometry of rows g(t, q) = 0 with the equation of motion M a + h = tau + J' lam.

        g' = J v + rate(t),   g'' = J a + drift

    Attributes:
        rows: One entry a row.
        level: Whether g exists; rows of velocities state g' = J v + rate alone.
        law: What the multipliers may be; a row that gives way holds g'' + kd g' + kp g = 0.
        gains: kp [1/s^2] and kd [1/s] of rows that give way, each one number or one a row.
        driven: Joints that a law `drive` moves, one a row: inverse dynamics asks for these
            multipliers as for efforts, and they demand nothing of the motion.
        stops: Joints that it keeps within ends; a motion that passes one is reported.
        slips: Whether its multipliers push along `pushes` in some mode, rather than along J'.
    """

    rows: tuple[Row, ...]
    level: Level = Level.POSITION
    law: Law = bilateral()
    gains: tuple[float | Array, float | Array] = (0.0, 0.0)
    driven: tuple[str, ...] = ()
    stops: tuple[Stop, ...] = ()
    slips: bool = False

    def acts(self, mode: Mode) -> bool:
        """Whether the rows are on in a mode; those of most constraints always are."""
        return True

    def residual(self, k: Kinematics, x: State) -> Array:
        """g(t, q), shape (m,)."""
        raise NotImplementedError

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """J = dg/dq, shape (m, nv)."""
        raise NotImplementedError

    def pushes(self, k: Kinematics, x: State) -> Array:
        """D, with the force D' lam on the joints, shape (m, nv); J while nothing slips."""
        return self.jacobian(k, x)

    def drift(self, k: Kinematics, x: State) -> Array:
        """The part of g'' without the acceleration, J' v included, shape (m,)."""
        raise NotImplementedError

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`; for parts where one costs less with the other."""
        return self.jacobian(k, x), self.drift(k, x)

    def rate(self, k: Kinematics, x: State) -> Array:
        """The part of g' without the velocity, shape (m,)."""
        return np.zeros(len(self.rows))

    def quick_margin(self, q: Array, v: Array, a: Array) -> float:
        """A cheap lower bound of w = g'' + kd g' + kp g; for the law `unilateral` only.

        No row acts where it is >= 0; then nothing else of the constraint is evaluated.

        Args:
            q: Configuration, shape (nq,).
            v: Velocity, shape (nv,).
            a: Acceleration without the bounded rows, shape (nv,).
        """
        return -math.inf

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Wrenches of the multipliers, shape (m,), on bodies; empty where no frame exists."""
        return ()
