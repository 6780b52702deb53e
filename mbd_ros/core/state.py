"""Values that flow between parts and methods: states, evaluations, motions, checkpoints."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NANOSECOND = 1.0e-9  # s
Mode = tuple[int, ...]
Memory = dict[str, Any]  # checkpoint of a stepper: values that may be stored and pickled
NONE: Array = np.zeros(0)
NONE.setflags(write=False)


class State(NamedTuple):
    """State at one time, on which alone the future motion depends.

    Attributes:
        t: Time [s].
        q: Configuration [m, rad], shape (nq,).
        v: Velocity [m/s, rad/s], shape (nv,).
        z: Internal states of parts, in their own units, shape (nz,).
        mode: Integers that select one of several smooth motions: the phase, the side of a surface,
            stick or slip.
    """

    t: float
    q: Array
    v: Array
    z: Array = NONE
    mode: Mode = ()


class Evaluation(NamedTuple):
    """Result of the equations of motion at one state.

    Attributes:
        x: State of all joints.
        a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        zdot: Rates of the internal states, shape (nz,).
        lam: Multipliers, one a row of `System.multiplier_rows`, shape (m,).
        respond: Function from forces on all joints, shape (nv, k), to the accelerations that they
            add while the constraints hold, same shape. It raises a SolveError after the next
            evaluation of the system.
    """

    x: State
    a: Array
    zdot: Array
    lam: Array
    respond: Callable[[Array], Array]


class BodyMotion(NamedTuple):
    """Sampled motion of a free body, one row a sample.

    Attributes:
        name: Name of the body.
        pose: Position in the world [m], then quaternion (x, y, z, w), shape (n, 7); the signs of
            successive quaternions agree.
        twist: Velocity [m/s], then angular velocity [rad/s], in axes of the body, shape (n, 6);
            NaN where it was not measured; None without any.
        acceleration: Derivative of the twist, same shape, or None.
    """

    name: str
    pose: Array
    twist: Array | None = None
    acceleration: Array | None = None


class Motion(NamedTuple):
    """Sampled motion, one row a sample, one column a joint.

    Attributes:
        names: Joint names, one a column.
        stamps: Sample times [ns], strictly increasing, shape (n,), int64.
        position: Joint positions [rad or m], shape (n, len(names)).
        velocity: Joint velocities [rad/s or m/s], same shape; NaN where not measured; None without
            any.
        acceleration: Joint accelerations [rad/s^2 or m/s^2], same shape, or None.
        effort: Measured effort [N·m or N], same shape, NaN where not measured; None without any.
        command: Commands of actuators, same shape, NaN where there is none; None without any.
        bodies: Motions of the free bodies.
    """

    names: tuple[str, ...]
    stamps: NDArray[np.int64]
    position: Array
    velocity: Array | None = None
    acceleration: Array | None = None
    effort: Array | None = None
    command: Array | None = None
    bodies: tuple[BodyMotion, ...] = ()


class WrenchSamples(NamedTuple):
    """Sampled wrench of one external load.

    Attributes:
        stamps: Sample times [ns], strictly increasing, shape (n,), int64.
        wrench: Force [N], then torque [N·m] about the declared point, shape (n, 6).
        frame_id: Frame of the messages; empty where they name none.
    """

    stamps: NDArray[np.int64]
    wrench: Array
    frame_id: str = ""


def copied(value: Any) -> Any:
    """Return a copy of a value, with the arrays inside tuples copied, too."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, State):
        return State(value.t, value.q.copy(), value.v.copy(), value.z.copy(), value.mode)
    if isinstance(value, tuple):
        return _like(value)(map(copied, value))
    return value


def _like(value: Any) -> Any:
    """Return the constructor of a tuple, or of a named tuple, from an iterable."""
    return getattr(type(value), "_make", tuple)


def recognised(value: Any, x: State) -> Any:
    """Return the value with x itself in place of a state of the same bits.

    Steppers recognise the state of their last step by identity.
    """
    if isinstance(value, State):
        return x if is_same(value, x) else value
    if isinstance(value, tuple):
        return _like(value)(recognised(each, x) for each in value)
    return value


def is_same(x: State, y: State) -> bool:
    """Whether two states have the same bits."""
    arrays = zip(x[1:4], y[1:4], strict=True)
    return x.t == y.t and x.mode == y.mode and all(have_same_bits(a, b) for a, b in arrays)


def have_same_bits(a: Array | None, b: Array | None) -> bool:
    """Whether two arrays are equal, or both None; NaN equals NaN, and 0 does not equal -0."""
    if a is None or b is None or a is b:
        return a is b
    return a.tobytes() == b.tobytes()


def is_symbol(value: object) -> bool:
    """Whether a number is a symbolic expression, as in a system that is traced."""
    return hasattr(value, "piecewise")
