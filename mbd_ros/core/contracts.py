"""The contracts of the parts of a scene: loads, actuators, sensors, and their outputs.

A part binds points and frames while it is built, and reads them from the kinematics k at a state.
It never changes its inputs and keeps no memory of earlier states. Positions are counted from
`Robot.origin`.

Methods of parts take the kinematics `k` at the state, refreshed as far as `reads` of the part
says, the state `x` of all joints, with internal states inside their bounds, and all inputs `u`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from enum import Enum, IntEnum
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.points import Point
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import ModelError

Value = float | Array


class Part:
    """A part of a scene: a force, a constraint, a sensor, ...

    Attributes:
        name: Unique in the scene, without a dot; the type of a part that no scene has built.
        reads: Level of the kinematics that its methods read at most.
        inputs: Channels that it takes from outside while it runs.
        internal: Its states besides q and v, whose rates `rates` returns.
        guards: Numbers whose zeros are events; `guard_values` returns them.
        outputs: Quantities that it shows besides the multipliers of its rows.
        u: Its inputs in the u of the scene; all of u until it is bound.
        z: Its internal states in the z of a state; all of z until it is bound.
        is_constraint: Whether it has rows, as every `Constraint`.
        is_actuator: Whether it takes commands, as every `Actuator`.
        path: Path along which it acts or which it measures; None without one.
        pair: Pair of bodies that it keeps apart, as a contact does; None without one.
    """

    is_constraint: ClassVar[bool] = False
    is_actuator: ClassVar[bool] = False
    path: Any = None
    pair: Any = None
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
        """Store the places of its inputs and internal states; called once, when all are known."""
        self.u, self.z = slots

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the rates of `internal`, in their order, shape (len(internal),)."""
        raise NotImplementedError

    def balance(self, k: Kinematics, x: State, u: Array, w: Array) -> Array:
        """Return the residual of the rates w, in their units, shape (len(internal),).

        A part whose rates solve an implicit equation returns the residual of that equation, for
        collocation.
        """
        return w - self.rates(k, x, u)

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array | None:
        """Return the values of `internal` at which their rates are 0, for a start at equilibrium.

        In x, internal states with a prescribed value have it, others are NaN.

        Returns:
            All of them, in their order; None where the part does not know them and a search has
            to find them.
        """
        return None

    def guard_values(self, k: Kinematics, x: State, u: Array, now: Now) -> Array:
        """Return the values of `guards`, in their order, shape (len(guards),)."""
        raise NotImplementedError

    def reset(self, k: Kinematics, x: State, u: Array) -> State:
        """Return the state of all joints after a guard of the part was zero; by default x."""
        return x

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return the values of `outputs`, in their order; called at samples only."""
        return ()


def type_name(kind: type) -> str:
    """Return the type as scenes write it: `joint_spring` for JointSpring."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()


class Channel(NamedTuple):
    """One number that a part takes from outside while it runs.

    Attributes:
        name: Unique in the part; empty where the part has only one.
        unit: Unit, such as N·m or rad.
        lower: Smallest value that has an effect, -inf without a bound.
        upper: Largest value that has an effect, inf without a bound.
        safe: Value that applies while no trustworthy command exists.
    """

    name: str
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    safe: float = 0.0


class Internal(NamedTuple):
    """An internal state of a part: activation, motor current, deflection of a bristle.

    Attributes:
        name: Unique in the part; empty where the part has only one.
        unit: Unit, such as rad or A; empty for pure numbers.
        lower: Smallest accepted value, -inf without a bound.
        upper: Largest accepted value, inf without a bound.
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
        direction: 1 where it acts while it rises, -1 while it falls, 0 in both directions.
        armed: Returns whether it acts in a mode; it acts in all modes by default. It acts only
            after it has left zero.
        condition: Returns whether it acts at a state of all joints where it is zero; by default
            it does.
        ends: Whether it ends a phase, without any other effect in that phase.
    """

    name: str
    direction: int = 0
    armed: Callable[[Mode], bool] | None = None
    condition: Callable[[State], bool] | None = None
    ends: bool = False


class Slots(NamedTuple):
    """Places of the numbers of a part.

    Attributes:
        inputs: Place of its inputs in the u of the scene.
        internal: Place of its internal states in the z of a state.
    """

    inputs: slice
    internal: slice


class Load(Part):
    """A generalized force that depends on a state and on inputs, never on accelerations.

    Attributes:
        surfaces: Names of the surfaces at which it jumps; `DiscontinuousForce` has the contract.
        brings: Entries of `<dynamics>` of its `joint` that it models: friction, damping.
        gives_work: Whether its work counts as work of an actuator, as that of every `Actuator`.
        has_inertia: Whether it adds `inertia`, which takes a solve with the whole mass matrix.
        is_compliant_contact: Whether it is a contact with `slopes` of its force.
        has_metabolic_rate: Whether it is a muscle with a `metabolic_rate`.
        description: Description of the learned model that gives the force; None for others.
    """

    is_compliant_contact: ClassVar[bool] = False
    has_metabolic_rate: ClassVar[bool] = False
    description: Any = None
    gives_work: bool = False
    has_inertia: bool = False
    brings: tuple[str, ...] = ()
    surfaces: tuple[str, ...] = ()

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force on the joints [N·m or N], shape (nv,)."""
        raise NotImplementedError

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Return the slopes of an affine force, shape (nv, len(inputs)).

            force(u) = force(0) + columns u

        The force is affine while every input is within the bounds of its channel.

        Returns:
            None where the force is not affine in the inputs.
        """
        return None

    def constant_slopes(self, nv: int, nz: int) -> Array | None:
        """Return the derivative of the force by steps of (q, v, z), where it never changes.

        The rates of its internal states then have constant derivatives, too.

        Args:
            nv: Size of the velocity of the robot.
            nz: Number of internal states of the scene.

        Returns:
            Shape (nv, 2 nv + nz); None where it depends on the state or is unknown.
        """
        return None

    def beside(self, k: Kinematics, x: State) -> Load:
        """Return the force near a state, smooth across the surfaces at which it jumps."""
        return self

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy [J] stored by its conservative force and its internal states."""
        return 0.0

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return its wrenches on bodies; empty for forces in joints, between parent and child."""
        return ()

    def inertia(self, k: Kinematics, x: State) -> Array:
        """Return the mass matrix that it adds beside its force, shape (nv, nv)."""
        raise NotImplementedError

    def doubt(self, x: State) -> str:
        """Return why its force cannot be trusted at a state of all joints; empty if it can."""
        return ""

    def armature(self) -> Array:
        """Return the inertia added to the joints [kg·m^2 or kg], shape (nv,), or (1,) for none."""
        return np.zeros(1)


class Actuator(Load):
    """A load that turns commands into torques of joints; its inputs are the commands.

    Attributes:
        joints: Topic names of the driven joints.
        takes: Meaning and unit of a command; empty where it is the torque of the joint.
    """

    is_actuator = True
    gives_work = True
    joints: tuple[str, ...]
    takes: str = ""

    def command(self, torque: Array, x: State) -> Array:
        """Return the commands for a torque, shape (len(inputs),); here the torque itself.

        Args:
            torque: Torque of `joints` [N·m or N], shape (len(joints),). Losses and limits of the
                actuator are not compensated.
            x: State of all joints.
        """
        return torque

    def demanded(self, torque: Array, x: State) -> Array:
        """Return the commands that exert a torque, losses compensated, shape (len(inputs),).

        Their force is that torque, unless it exceeds a limit. This serves recordings; in a live
        loop, noise of the velocity would come back as force.
        """
        return self.command(torque, x)

    def limits(self) -> Array:
        """Return the largest torque of each of `joints` [N·m or N]; inf without a limit."""
        return np.full(len(self.joints), math.inf)


class Measures(IntEnum):
    """The highest derivative, or force, that a measurement depends on."""

    POSITION = 0
    VELOCITY = 1
    ACCELERATION = 2
    FORCE = 3


class Sensor(Part):
    """A measurement of a mechanism, without influence on the motion.

    A sensor models the exact measurement, its derivative by the state, and its noise. The same
    sensors serve a simulator, marker kinematics and estimators.

    Attributes:
        level: Highest derivative, or force, that a measurement depends on.
        unit: Unit of every component.
        components: Names of the components; one empty string for a single number.
        label: Name of the sensor in recordings and messages; its own name by default.
        delay: Time from a measurement to its message [s]; the message carries the time of the
            measurement.
        is_linear: Whether it is a constant linear function of q and v: `jacobian` and
            `by_position` never change.
        noise_varies: Whether `covariance` depends on the state.
        point: Point that it is fixed to; None without one.
        weight: Weight of a marker in fits; 0 for sensors that are no markers.
    """

    point: Point | None = None
    weight: float = 0.0

    level: Measures = Measures.POSITION
    unit: str = ""
    components: tuple[str, ...] = ("",)
    label: str = ""
    delay: float = 0.0
    is_linear: bool = False
    noise_varies: bool = False

    @property
    def title(self) -> str:
        """Name in recordings and messages."""
        return self.label or self.name

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the exact measurement, shape (n,) with n components.

        `now` is needed from `Measures.ACCELERATION` on, with reactions for `Measures.FORCE`.
        """
        raise NotImplementedError

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative by q, v or a, as `level` says, shape (n, nv).

        k is refreshed to Jacobians. Sensors of forces need no derivative.
        """
        raise NotImplementedError

    def by_position(self, k: Kinematics, x: State) -> Array | None:
        """Return the derivative by a step of q at constant velocity, where `level` is higher.

        Returns:
            Shape (n, nv); None by default, so that callers take differences of `measure`.
        """
        return None

    def by_internal(self, nz: int) -> Array | None:
        """Return the constant derivative by all internal states, shape (n, nz); None for 0."""
        return None

    def near(self, values: Array, expected: Array) -> Array:
        """Return the representation of measured values that is nearest to expected ones.

        Angles and quaternions have several representations; most values have one.
        """
        return values

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the noise [unit^2], shape (n, n); 0 by default."""
        return np.zeros((len(self.components), len(self.components)))


def reactions_of(sensor: Sensor, now: Now | None) -> Array:
    """Return the reactions of all joints; raise a ModelError where they are unknown."""
    if now is None or now.reactions is None:
        raise ModelError(f"{sensor.name} needs reactions of joints, and none are known")
    return now.reactions


def specific_force(
    sensor: Sensor, k: Kinematics, point: Point, now: Now | None, gravity: Array
) -> Array:
    """Return R' (a - g) of a point in its axes, the reading of an accelerometer, shape (3,).

    Args:
        sensor: The sensor, for the message.
        k: Kinematics at the state, refreshed to drifts.
        point: Point at which it is mounted.
        now: Accelerations.
        gravity: Gravity in the world [m/s^2], shape (3,).

    Raises:
        ModelError: The accelerations are unknown.
    """
    if now is None:
        raise ModelError(f"{sensor.name} needs accelerations, and none are known")
    moved = k.jacobian(point).dot(now.a) + k.acceleration(point)
    felt: Array = k.rotation(point).T.dot(moved - gravity)
    return felt


class Kind(Enum):
    """Kinds of quantities, each with the names of its components; empty for a scalar.

    Wrenches and cones are drawn; their numbers are also outputs of the part.
    """

    SCALAR = ("",)
    VECTOR = ("x", "y", "z")
    WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")  # force, then torque about `at`
    POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
    PLACED_WRENCH = ("x", "y", "z", *WRENCH)  # where it acts, less `Robot.origin`; torque there
    FRICTION_CONE = ("x", "y", "z", "fx", "fy", "fz", "mu")  # tip, the normal force, coefficient


class Output(NamedTuple):
    """A quantity that a part shows.

    Attributes:
        name: Unique in the part, without a dot; columns and messages put the name of the part
            before it.
        unit: Unit, empty for pure numbers; for a wrench those of force and torque.
        kind: Kind of quantity, with its components.
        frame: Frame in whose axes it is expressed, empty for scalars and for axes of the world;
            for a wrench, which is in axes of the world, the link on which it acts.
        at: Point at which a wrench of `Kind.WRENCH` acts.
    """

    name: str
    unit: str
    kind: Kind = Kind.SCALAR
    frame: str = ""
    at: Point | None = None

    @property
    def is_drawn(self) -> bool:
        """Whether it is drawn as an arrow or a cone, without columns."""
        return self.kind in (Kind.WRENCH, Kind.PLACED_WRENCH, Kind.FRICTION_CONE)


class Now(NamedTuple):
    """Results of an evaluation that a part may show.

    Attributes:
        a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        lam: Multipliers of the rows of the part, shape (m,).
        reactions: Wrench of the parent of every joint on its child [N, N·m], about the origin and
            in the axes of the joint on the child, in the order of `Robot.joints`, shape (n, 6);
            None where they were not computed.
    """

    a: Array
    lam: Array
    reactions: Array | None = None


def label(part: Any, quantity: str) -> str:
    """Return the name of a quantity of a part in columns, topics and messages.

    Args:
        part: The part, whose name may be empty.
        quantity: Name of the quantity in the part.
    """
    return f"{part.name}.{quantity}" if part.name else quantity


def without_multiplier(label: str) -> str:
    """Return the name on topics of joint states, where a coupling has that of its joint."""
    return label.removesuffix(".multiplier")


class FrictionCone(NamedTuple):
    """Friction cone of a contact up to its present normal force.

    Attributes:
        point: Tip of the cone, in the world less `Robot.origin` [m], shape (3,).
        normal: The normal force: axis and height, in world axes [N], shape (3,).
        mu: Coefficient of friction: its radius is mu times its height.
    """

    point: Array
    normal: Array
    mu: float


def exerted_on(link: Point, at: Point | None) -> Output:
    """Return the output of a wrench on a link.

    Args:
        link: Any point of the link.
        at: Point at which the wrench acts; None where every value contains it.
    """
    name = f"on_{link.frame.replace('.', '_')}"
    kind = Kind.PLACED_WRENCH if at is None else Kind.WRENCH
    return Output(name, "N, N·m", kind, link.frame, at)


class Wrench(NamedTuple):
    """Wrench of a constraint on one body.

    Attributes:
        frame: Link on which it acts.
        point: Point of application, in the world less `Robot.origin` [m], shape (3,).
        force: Force in world axes [N], shape (3,).
        torque: Torque about `point`, in world axes [N·m], shape (3,).
    """

    frame: str
    point: Array
    force: Array
    torque: Array

    @property
    def numbers(self) -> Array:
        """Force, then torque, shape (6,)."""
        return np.concatenate((self.force, self.torque))
