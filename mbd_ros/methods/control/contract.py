"""Contract of controllers: torques from a state and a reference, and tolerable delays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.ranges import Gain
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

MASS_ERROR = 0.3  # share by which the masses of a model may be too large
_TOO_STRONG = 1.0 / (1.0 - MASS_ERROR)
_ROUNDING = 1.0e-6
LONGEST = 0.04  # largest tolerable delay [s]; a later command counts as missing


class Controller:
    """Control law. It is an immutable value: new gains mean a new controller for the same joints.

    The constructor takes `joints` and, by keyword, the gains. Its signature defines their
    defaults, ranges and units (`mbd_ros.core.ranges`), and its docstring their meaning; code that
    configures the law reads them there. `Gain` is a number for all joints, or one for each. The
    constructor raises a ModelError that names the gain, what is wrong and what is accepted.

    A control law does not store states of its own, such as an integral. It returns their rates
    (`Control.memory_rate`), and the loop integrates or freezes them.

    Attributes:
        joints: The controlled joints.
        limit_names: Names of the limits that it enforces, one for each entry of `Control.active`.
        example: Gains with which the law works on a small arm.
        files: Arguments that name files of plans; the builder of the law reads the files and
            passes their content.
    """

    example: ClassVar[dict[str, Any]]
    files: ClassVar[tuple[str, ...]] = ()
    limit_names: tuple[str, ...] = ()
    joints: ControlledJoints

    def begin(self) -> Array:
        """Return the initial memory, shape (k,); most control laws have none."""
        return np.zeros(0)

    def details(self) -> dict[str, str]:
        """Return remarks about the operation of the control law, for diagnostics."""
        return {}

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about the operation of the control law, for diagnostics."""
        return ()

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains | None:
        """Return the gains for small errors in a pose; None if they are not known.

        Args:
            at_rest: Response of the joints in that pose, at rest.
            period: Period of the loop [s].
        """
        return None

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Return the largest errors of the law in a pose, with masses wrong by `MASS_ERROR`.

        Args:
            at_rest: Response of the joints in that pose, at rest.
            period: Period of the loop [s].

        Returns:
            Bounds [rad or m], shape (n,); inf where the law guarantees none.
        """
        return np.full(len(self.joints), np.inf)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """Compute the efforts at a state.

        Args:
            x: Consistent state of all joints of the robot.
            ref: Reference of the controlled joints.
            memory: States of the control law, shape (k,).
            box: Bounds of the next command. The sender clips the command; a
                control law may use the box to do better.
        """
        raise NotImplementedError


class ControlledJoints:
    """The actuated joints of a scene as a controller sees them: free motion and mobility.

        a_free = S (a at tau = 0),   mobility = S A S'

    A are the accelerations of generalized forces on the constraint manifold, by
    `Evaluation.respond`, S picks the controlled joints. Bounded rows (stops, dry friction) belong
    to the plant.

    Args:
        system: Dynamics without actuators and bounded rows; owned by this object from now on.
        names: Controlled joints, in the order of efforts and references.

    Attributes:
        joints: Their descriptions, with limits.
        newest: The last result of `response`; None before the first.

    Raises:
        ModelError: No joint, an unknown one, one twice, or a body that moves freely.
    """

    def __init__(self, system: System, names: Sequence[str]) -> None:
        if not names or len(set(names)) != len(names):
            raise ModelError(f"controlled joints {list(names)} must be one or more, each once")
        if system.robot.floating:
            free = ", ".join(base.title for base in system.robot.bases)
            raise ModelError(f"a controller needs fixed bases: {free} must not move freely")
        self.names, self.system = tuple(names), system
        self.joints = tuple(system.robot.joint(name) for name in names)
        self._q = np.array([joint.q for joint in self.joints])
        self._v = np.array([joint.v for joint in self.joints])
        self._selection = np.eye(system.robot.model.nv)[:, self._v]
        self.newest: Response | None = None

    def __len__(self) -> int:
        return len(self.names)

    def positions(self, x: State) -> Array:
        """Return the positions of the controlled joints [rad or m] as a new array, (n,)."""
        return x.q[self._q]

    def velocities(self, x: State) -> Array:
        """Return the velocities of the controlled joints [rad/s or m/s] as a new array, (n,)."""
        return x.v[self._v]

    def response(self, x: State, motion: tuple[Array, Array] | None = None) -> Response:
        """Return the response at a consistent state of all joints.

        Args:
            x: State of all joints.
            motion: Result of `accelerations` at x; None to compute it.
        """
        a, mobility = motion or self.accelerations(x)
        self.newest = Response(x.q[self._q], x.v[self._v], a[self._v], mobility[self._v])
        return self.newest

    def accelerations(self, x: State) -> tuple[Array, Array]:
        """Return accelerations without torque, shape (nv,), and per unit torque, (nv, n)."""
        now = self.system.evaluate(x)
        return now.a, now.respond(self._selection)


class Reference(NamedTuple):
    """Demanded motion of the controlled joints, in the order of the controller.

    Attributes:
        q: Positions [rad or m], shape (n,).
        v: Velocities [rad/s or m/s], shape (n,).
        a: Accelerations [rad/s^2 or m/s^2], shape (n,).
    """

    q: Array
    v: Array
    a: Array


class Response(NamedTuple):
    """Response of the controlled joints to torques, with couplings and loops.

        a = a_free + mobility tau

    Attributes:
        q: Their positions [rad or m], shape (n,).
        v: Their velocities [rad/s or m/s], shape (n,).
        a_free: Their accelerations without torque [rad/s^2 or m/s^2], shape (n,).
        mobility: Accelerations per unit torque, symmetric, positive semidefinite, shape (n, n).
    """

    q: Array
    v: Array
    a_free: Array
    mobility: Array


class EffortBox(NamedTuple):
    """Bounds of the next command: torque limits and torque-rate limits together.

    Attributes:
        lower: [N·m or N], shape (n,); -inf without a limit.
        upper: [N·m or N], shape (n,); inf without a limit.
    """

    lower: Array
    upper: Array


class Control(NamedTuple):
    """Result of a control law.

    Attributes:
        effort: Efforts of the controlled joints [N·m or N], shape (n,).
        s: Sliding variable e' + lambda e of each [rad/s or m/s], shape (n,).
        equivalent: The part of `effort` that keeps s constant [N·m or N], shape (n,).
        memory_rate: Rate of change of the memory [1/s of its unit], shape (k,).
        active: Which of `Controller.limit_names` reduce the effort; empty without limits.
    """

    effort: Array
    s: Array
    equivalent: Array
    memory_rate: Array
    active: NDArray[np.bool_]


def per_joint(
    value: Gain, n: int, name: str, *, above: float = 0.0, least: float | None = None
) -> Array:
    """Return a gain as a read-only array with one value for each joint, shape (n,).

    Args:
        value: One value for all joints, or one for each.
        n: Number of joints.
        name: Name of the gain for messages.
        above: Strict lower bound of the values.
        least: Lower bound of the values, instead of `above`.

    Raises:
        ModelError: Wrong number of values, or values that are not finite or too small.
    """
    values = np.array(value, dtype=np.float64)
    if values.ndim and values.shape != (n,):
        raise ModelError(f"{name} has {values.size} values; accepted: one, or one a joint ({n})")
    gains = np.full(n, values)
    is_enough = gains > above if least is None else gains >= least
    if not (np.isfinite(gains).all() and is_enough.all()):
        bound = f"> {above:g}" if least is None else f">= {least:g}"
        raise ModelError(f"{name} {values.tolist()} must be finite and {bound}")
    gains.flags.writeable = False
    return gains


def tolerable_delay(gains: LoopGains, period: float) -> Array:
    """Return the largest delay from state to command with which the loop of each joint is stable.

    The open loop with a zero-order hold of one period h, a delay D, and masses that are too large
    in the model by `MASS_ERROR`,

        L(jw) = g C(jw) / (jw)^2 sinc(w h / 2) exp(-jw (D + h/2)),   g = 1 / (1 - MASS_ERROR)
        C(jw) = stiffness + jw damping + integral (1 + slope / (jw))

    is on the edge of stability where |L| = 1 and its phase is -pi. Without hold and integral

        w^2 = g (g damping^2 + (g^2 damping^4 + 4 stiffness^2)^(1/2)) / 2
        D = atan(damping w / stiffness) / w - h / 2

    A command takes effect at the next period, so delays are whole numbers of periods.

    Args:
        gains: Gains of the control law.
        period: Period h [s], > 0.

    Returns:
        Delays [s], multiples of the period of at most `LONGEST`, shape (n,); 0 where the loop
        tolerates none.

    Source: K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed., 2021, sec. 10.3 (delay
        margin); G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems,
        3rd ed., 1998, sec. 7.4 (the hold as a delay of h/2).
    """
    w = _frequencies(gains)
    s = 1j * w
    integral = gains.integral[:, None] * (1.0 + gains.slope[:, None] / s)
    C = gains.stiffness[:, None] + s * gains.damping[:, None] + integral
    size = _TOO_STRONG * np.abs(C) / w**2 * np.abs(np.sinc(w * period / (2.0 * np.pi)))
    crosses = (size[:, :-1] >= 1.0) & (size[:, 1:] < 1.0)
    spare = np.angle(C) / w - 0.5 * period
    near = np.minimum(spare[:, :-1], spare[:, 1:])
    least: Array = np.where(crosses, near, np.inf).min(axis=1)
    least = np.clip(np.where(np.isfinite(least), least, 0.0), 0.0, LONGEST)
    return np.floor(least / period + _ROUNDING) * period


def _frequencies(gains: LoopGains) -> Array:
    """Return a grid of frequencies about the crossover of each joint [rad/s], shape (n, k)."""
    kd, kp = _TOO_STRONG * gains.damping, _TOO_STRONG * gains.stiffness
    about = np.sqrt(0.5 * (kd**2 + np.sqrt(kd**4 + 4.0 * kp**2)))
    return np.asarray(about[:, None] * np.geomspace(0.2, 5.0, 1000))


class LoopGains(NamedTuple):
    """Gains of a control law for small errors of decoupled joints.

        e'' = -(damping e' + stiffness e + integral of (e' + lambda e))

    Attributes:
        stiffness: Gain of e [1/s^2], shape (n,).
        damping: Gain of e' [1/s], shape (n,).
        integral: Gain of the integral of s = e' + lambda e [1/s^2], shape (n,).
        slope: lambda [1/s], shape (n,).
    """

    stiffness: Array
    damping: Array
    integral: Array
    slope: Array


def sliding_gains(slope: Array, reaching: Array, integral: Array | float = 0.0) -> LoopGains:
    """Return the gains of s' = -reaching s - integral of s with s = e' + slope e."""
    wanted = np.broadcast_to(np.asarray(integral, dtype=np.float64), slope.shape)
    return LoopGains(slope * reaching, slope + reaching, wanted, slope)


def pd_gains(stiffness: Array, damping: Array) -> LoopGains:
    """Return gains without an integral; stiffness in 1/s^2, damping in 1/s."""
    return LoopGains(stiffness, damping, np.zeros_like(damping), np.zeros_like(damping))


def disturbance(a_free: Array) -> Array:
    """Return accelerations due to masses wrong by `MASS_ERROR`, at rest [rad/s^2 or m/s^2]."""
    return MASS_ERROR * _TOO_STRONG * np.abs(a_free)
