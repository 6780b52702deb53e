"""Contracts of the parts of a scene.

A part binds points and frames while it is built and asks the kinematics k for them at a state; it
never changes its inputs, and keeps no memory of earlier states. Positions are counted from
`Robot.origin`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts.outputs import Now, Output, Value
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.names import type_name
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


class Internal(NamedTuple):
    """A state of a part of its own: activation, motor current, length of a bristle.

    Attributes:
        name: Unique in the part; empty where the part has only one.
        unit: rad, A, ..; empty for pure numbers.
        lower: Smallest value it may have, -inf without.
        upper: Largest one, inf without.
        initial: Value at the start; None for the equilibrium, where the rates are 0: `at_rest`.
        is_constant: Whether its rate is always 0.
    """

    name: str
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    initial: float | None = None
    is_constant: bool = False


class Guard(NamedTuple):
    """A number whose zero is an event.

    Attributes:
        name: Unique in the part; empty where the part has only one.
        direction: 1 where it acts on the way up, -1 on the way down, 0 both ways.
        armed: Whether it acts in a mode, in all by default. It acts only after it has left zero.
        condition: Whether it acts at a state of all joints where it is zero; by default, it does.
        ends: Whether it ends a phase: nothing else happens in that phase then.
    """

    name: str
    direction: int = 0
    armed: Callable[[Mode], bool] | None = None
    condition: Callable[[State], bool] | None = None
    ends: bool = False


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
        internal: Its states besides q and v, which `rates` moves.
        guards: Numbers whose zeros are events, see `guard_values`.
        outputs: What it shows besides the multipliers of its rows.
        u: Its inputs in the u of the scene; all of u until it is bound.
        z: Its internal states in the z of a state; all of z until it is bound.
    """

    name: str = ""
    reads: Reads = Reads.NOTHING
    inputs: tuple[Channel, ...] = ()
    internal: tuple[Internal, ...] = ()
    guards: tuple[Guard, ...] = ()
    outputs: tuple[Output, ...] = ()
    u: slice = slice(None)
    z: slice = slice(None)

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.name = type_name(cls)

    def bind(self, slots: Slots) -> None:
        """Learn where its numbers stand; once, when all parts are known."""
        self.u, self.z = slots

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Rates of `internal`, in their order, shape (len(internal),).

        Args:
            k: Kinematics at the state, refreshed as far as `reads` says.
            x: State of all joints; internal states are inside their bounds.
            u: All inputs.
        """
        raise NotImplementedError

    def balance(self, k: Kinematics, x: State, u: Array, w: Array) -> Array:
        """What is zero where w are the rates, in their units, shape (len(internal),).

        A part whose rates solve an equation states that equation instead, for collocation.

        Args:
            k: Kinematics at the state, refreshed as far as `reads` says.
            x: State of all joints; internal states are inside their bounds.
            u: All inputs.
            w: Rates of `internal`.
        """
        return w - self.rates(k, x, u)

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array | None:
        """Values of `internal` at which their rates are 0, for a start at equilibrium.

        Args:
            k: Kinematics at the state, refreshed as far as `reads` says.
            x: State of all joints; internal states that are given keep their values, others are
                NaN.
            u: All inputs.

        Returns:
            All of them, in their order; None where the part does not know them: they are looked
            for then.
        """
        return None

    def guard_values(self, k: Kinematics, x: State, u: Array, now: Now) -> Array:
        """Values of `guards`, in their order, shape (len(guards),); arguments as for `show`."""
        raise NotImplementedError

    def reset(self, k: Kinematics, x: State, u: Array) -> State:
        """The state of all joints after a guard of the part was zero; the same one by default.

        Args:
            k: Kinematics at the state, refreshed as far as `reads` says.
            x: State of all joints.
            u: All inputs.
        """
        return x

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
        surfaces: Names of those at which it jumps, see `events.switching.DiscontinuousForce`.
        brings: Entries of the `<dynamics>` of its `joint` that it covers: friction, damping.
        gives_work: Whether its work counts as that of an actuator, as of every `Actuator`.
        has_inertia: Whether it adds `inertia`, which takes a solve with the whole mass matrix.
    """

    gives_work: bool = False
    has_inertia: bool = False
    brings: tuple[str, ...] = ()
    surfaces: tuple[str, ...] = ()

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

    def constant_slopes(self, nv: int, nz: int) -> Array | None:
        """Derivative of the force by steps of (q, v, z) of all joints, where it never changes.

        Whoever gives it has internal states whose rates never change either.

        Args:
            nv: Size of the velocity of the robot.
            nz: Number of internal states of the scene.

        Returns:
            Shape (nv, 2 nv + nz); None where it depends on the state, or nobody knows it.
        """
        return None

    def beside(self, k: Kinematics, x: State) -> "Load":
        """The force near a state, smooth across the surfaces at which it jumps."""
        return self

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy that it stores [J], by what is conservative in its force and by its states."""
        return 0.0

    def wrenches(self, k: Kinematics, x: State, u: Array) -> "tuple[Wrench, ...]":
        """Wrenches on bodies; empty for a force in joints, between parent and child."""
        return ()

    def inertia(self, k: Kinematics, x: State) -> Array:
        """Mass matrix that it adds beside its force, shape (nv, nv), where `has_inertia`."""
        raise NotImplementedError

    def doubt(self, x: State) -> str:
        """Why its force is not to be trusted at a state of all joints; empty where it is."""
        return ""

    def armature(self) -> Array:
        """Inertia that it adds to the joints [kg·m^2 or kg], shape (nv,) or (1,) of 0."""
        return np.zeros(1)


class Actuator(Load):
    """Commands -> torques of the joints that it drives; its inputs are the commands.

    Attributes:
        joints: Topic names of the driven joints.
        takes: Meaning and unit of a command; empty where it is the torque of the joint.
    """

    gives_work = True
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

    @property
    def numbers(self) -> Array:
        """Force, then torque, as an output shows them, shape (6,)."""
        return np.concatenate((self.force, self.torque))
