"""Values that flow between parts and methods: states, motions, and what steppers remember."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NANOSECOND = 1.0e-9  # s
Mode = tuple[int, ...]
Memory = dict[str, Any]  # what is remembered from step to step, to be kept and pickled
NONE: Array = np.zeros(0)
NONE.setflags(write=False)


class State(NamedTuple):
    """All that the future depends on, at one time.

    Attributes:
        t: Time [s].
        q: Configuration [m, rad], shape (nq,).
        v: Velocity [m/s, rad/s], shape (nv,).
        z: Internal states of parts, in units of their own, shape (nz,).
        mode: Whole numbers that say which of several smooth motions goes on: the phase, the side
            of a surface, stick or slip.
    """

    t: float
    q: Array
    v: Array
    z: Array = NONE
    mode: Mode = ()


class Evaluation(NamedTuple):
    """What the equations of motion say at one state.

    Attributes:
        x: State of all joints.
        a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        zdot: Rates of the internal states, shape (nz,).
        lam: Multipliers, one a row of `System.multiplier_rows`, shape (m,).
        respond: Forces on all joints, shape (nv, k), -> the accelerations that they add, same
            shape, constraints kept. A SolveError after the next evaluation of the system.
    """

    x: State
    a: Array
    zdot: Array
    lam: Array
    respond: Callable[[Array], Array]


class BodyMotion(NamedTuple):
    """Sampled motion of a free body, one row a sample.

    Attributes:
        name: Of the body.
        pose: Place in the world [m], then quaternion (x, y, z, w), shape (n, 7); a quaternion has
            the sign of the one before.
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
        position: [rad or m], shape (n, len(names)).
        velocity: [rad/s or m/s], same shape; NaN where it was not measured; None without any.
        acceleration: [rad/s^2 or m/s^2], same shape, or None.
        effort: Measured effort [N·m or N], same shape, NaN where not measured; None without any.
        command: What actuators take, same shape, NaN where there is none; None without any.
        bodies: Motion of the free bodies.
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
        wrench: Force [N] then torque [N·m] about the declared point, shape (n, 6).
        frame_id: Frame that the messages name; empty where they name none.
    """

    stamps: NDArray[np.int64]
    wrench: Array
    frame_id: str = ""


def copied(value: Any) -> Any:
    """A value with arrays of its own, in tuples too."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, State):
        return State(value.t, value.q.copy(), value.v.copy(), value.z.copy(), value.mode)
    if isinstance(value, tuple):
        return _like(value)(map(copied, value))
    return value


def _like(value: Any) -> Any:
    """What makes a tuple, or a named one, of the same kind."""
    return getattr(type(value), "_make", tuple)


def recognised(value: Any, x: State) -> Any:
    """The value; x itself in place of a state with the same bits, as steppers look for it."""
    if isinstance(value, State):
        return x if is_same(value, x) else value
    if isinstance(value, tuple):
        return _like(value)(recognised(each, x) for each in value)
    return value


def is_same(one: State, other: State) -> bool:
    """Whether two states have the same bits."""
    arrays = zip(one[1:4], other[1:4], strict=True)
    return (
        one.t == other.t
        and one.mode == other.mode
        and all(have_same_bits(a, b) for a, b in arrays)
    )


def have_same_bits(a: Array | None, b: Array | None) -> bool:
    """Whether two arrays are equal, or both None; NaN equals NaN, and 0 does not equal -0."""
    if a is None or b is None or a is b:
        return a is b
    return a.tobytes() == b.tobytes()


def is_symbol(value: object) -> bool:
    """Whether a number is an expression, as in a system that is traced."""
    return hasattr(value, "piecewise")
