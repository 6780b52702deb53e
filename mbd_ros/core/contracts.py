"""What a part of a scene is: the contracts of loads, actuators and sensors, and what they show.

A part binds points and frames while it is built and asks the kinematics k for them at a state; it
never changes its inputs, and keeps no memory of earlier states. Positions are counted from
`Robot.origin`.

Methods of parts take the kinematics `k` at the state, refreshed as far as the `reads` of the part
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
        """Learn where its numbers stand; once, when all parts are known."""
        self.u, self.z = slots

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Rates of `internal`, in their order, shape (len(internal),)."""
        raise NotImplementedError

    def balance(self, k: Kinematics, x: State, u: Array, w: Array) -> Array:
        """What is zero where w are the rates, in their units, shape (len(internal),).

        A part whose rates solve an equation states that equation instead, for collocation.
        """
        return w - self.rates(k, x, u)

    def at_rest(self, k: Kinematics, x: State, u: Array) -> Array | None:
        """Values of `internal` at which their rates are 0, for a start at equilibrium.

        In x, internal states that are given keep their values, others are NaN.

        Returns:
            All of them, in their order; None where the part does not know them: they are looked
            for then.
        """
        return None

    def guard_values(self, k: Kinematics, x: State, u: Array, now: Now) -> Array:
        """Values of `guards`, in their order, shape (len(guards),)."""
        raise NotImplementedError

    def reset(self, k: Kinematics, x: State, u: Array) -> State:
        """The state of all joints after a guard of the part was zero; the same one by default."""
        return x

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Values of `outputs`, in their order; asked for at samples only."""
        return ()


def type_name(kind: type) -> str:
    """Type as scenes write it: `joint_spring` of JointSpring."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()


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
        internal: In the z of a state.
    """

    inputs: slice
    internal: slice


class Load(Part):
    """A generalized force that depends on a state and on inputs, never on accelerations.

    Attributes:
        surfaces: Names of those at which it jumps, see `events.switching.DiscontinuousForce`.
        brings: Entries of the `<dynamics>` of its `joint` that it covers: friction, damping.
        gives_work: Whether its work counts as that of an actuator, as of every `Actuator`.
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

    def beside(self, k: Kinematics, x: State) -> Load:
        """The force near a state, smooth across the surfaces at which it jumps."""
        return self

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy that it stores [J], by what is conservative in its force and by its states."""
        return 0.0

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
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

    is_actuator = True
    gives_work = True
    joints: tuple[str, ...]
    takes: str = ""

    def command(self, torque: Array, x: State) -> Array:
        """Commands that ask for a torque, shape (len(inputs),); here the torque itself.

        Args:
            torque: Of `joints` [N·m or N], shape (len(joints),). Losses and limits of the actuator
                are not compensated.
        """
        return torque

    def demanded(self, torque: Array, x: State) -> Array:
        """Commands that give a torque, losses compensated, shape (len(inputs),).

        The force of them is that torque again, unless it is beyond a limit. For recordings: live,
        noise of the velocity would come back as force.
        """
        return self.command(torque, x)

    def limits(self) -> Array:
        """Largest torque of each of `joints` [N·m or N], shape (len(joints),), inf without."""
        return np.full(len(self.joints), math.inf)


class Measures(IntEnum):
    """What a measurement depends on besides what stands above it."""

    POSITION = 0
    VELOCITY = 1
    ACCELERATION = 2
    FORCE = 3


class Sensor(Part):
    """What of a mechanism is measured; it has no influence on the motion.

    A sensor says what an exact measurement would be, how that changes with the state, and how
    noisy it is. The same sensors serve a simulator, marker kinematics and estimators.

    Attributes:
        level: What a measurement depends on at most.
        unit: Of every component.
        components: Names of the components, one empty word for a single number.
        label: What recordings and messages call the sensor; its name by default.
        delay: From a measurement to its message [s]; the message carries the time of the
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
        """What recordings and messages call it."""
        return self.label or self.name

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """An exact measurement, shape (n,) of as many components.

        `now` is needed from `Measures.ACCELERATION` on, with reactions for `Measures.FORCE`.
        """
        raise NotImplementedError

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Derivative by q, v or a, whichever `level` says, shape (n, nv); not asked for forces.

        k is refreshed to Jacobians.
        """
        raise NotImplementedError

    def by_position(self, k: Kinematics, x: State) -> Array | None:
        """Derivative by a step of q at constant velocity, shape (n, nv), where `level` is higher.

        None by default: who needs it takes differences of `measure`.
        """
        return None

    def by_internal(self, nz: int) -> Array | None:
        """Constant derivative by all internal states, shape (n, nz); None for none."""
        return None

    def near(self, values: Array, expected: Array) -> Array:
        """Measured values as near to the expected ones as they can be written; themselves here."""
        return values

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Covariance of the noise [unit^2], shape (n, n); none by default."""
        return np.zeros((len(self.components), len(self.components)))


def reactions_of(sensor: Sensor, now: Now | None) -> Array:
    """Reactions of all joints, as `Now.reactions`; a ModelError where they are not given."""
    if now is None or now.reactions is None:
        raise ModelError(f"{sensor.name} needs reactions of joints, and none are known")
    return now.reactions


def specific_force(
    sensor: Sensor, k: Kinematics, point: Point, now: Now | None, gravity: Array
) -> Array:
    """R' (a - g) of a point, in its axes: what an accelerometer feels [m/s^2], shape (3,).

    Args:
        sensor: Who asks, for the message.
        k: Kinematics at the state, refreshed to drifts.
        point: Where it is.
        now: Accelerations; a ModelError without them.
        gravity: In the world [m/s^2], shape (3,).
    """
    if now is None:
        raise ModelError(f"{sensor.name} needs accelerations, and none are known")
    moved = k.jacobian(point).dot(now.a) + k.acceleration(point)
    felt: Array = k.rotation(point).T.dot(moved - gravity)
    return felt


class Kind(Enum):
    """What a quantity is made of: the words for its numbers, empty where it is one.

    Wrenches and cones are drawn: what they are made of are numbers of the part already.
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
        unit: Empty for pure numbers; of a wrench those of force and torque.
        kind: A number, or how many.
        frame: In whose axes it stands, empty for scalars and for axes of the world; of a wrench
            the link on which it acts, itself in axes of the world.
        at: Where a wrench of `Kind.WRENCH` acts.
    """

    name: str
    unit: str
    kind: Kind = Kind.SCALAR
    frame: str = ""
    at: Point | None = None

    @property
    def is_drawn(self) -> bool:
        """Whether it has no columns, but an arrow or a cone."""
        return self.kind in (Kind.WRENCH, Kind.PLACED_WRENCH, Kind.FRICTION_CONE)


class Now(NamedTuple):
    """What a part may show of an evaluation.

    Attributes:
        a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        lam: Multipliers of the own rows of the part, shape (m,).
        reactions: Wrench of the parent of every joint on its child [N, N·m], about the origin and
            in the axes of the joint on the child, in the order of `Robot.joints`, shape (n, 6);
            None where nobody asked for them.
    """

    a: Array
    lam: Array
    reactions: Array | None = None


def label(part: Any, quantity: str) -> str:
    """Quantity of a part as columns, topics and messages call it.

    Args:
        part: Has a name, or an empty one where the quantity says it all.
        quantity: Its name in the part.
    """
    return f"{part.name}.{quantity}" if part.name else quantity


def without_multiplier(label: str) -> str:
    """Name on topics of joint states, where a coupling goes by its dependent joint."""
    return label.removesuffix(".multiplier")


class FrictionCone(NamedTuple):
    """The forces that a contact can exert, as far as its normal force.

    Attributes:
        point: Its tip, in the world less `Robot.origin` [m], shape (3,).
        normal: The normal force: axis and height, in world axes [N], shape (3,).
        mu: Coefficient of friction: its radius is mu times its height.
    """

    point: Array
    normal: Array
    mu: float


def exerted_on(link: Point, at: Point | None) -> Output:
    """A wrench on a link.

    Args:
        link: Any point of it.
        at: Where the wrench acts; None where the part says that with every value.
    """
    name = f"on_{link.frame.replace('.', '_')}"
    kind = Kind.PLACED_WRENCH if at is None else Kind.WRENCH
    return Output(name, "N, N·m", kind, link.frame, at)


class Wrench(NamedTuple):
    """Wrench of a constraint on one body.

    Attributes:
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
