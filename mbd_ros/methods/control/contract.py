"""Contract of controllers: torques from a state and a reference, and delays that are tolerated."""

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
LONGEST = 0.04  # [s] of delay that are tolerated at most: what comes later is as good as silence


class Controller:
    """A control law; a value: new gains are a new controller for the same joints.

    The constructor takes `joints` and, by keyword, the gains. It is the only home of their
    defaults, ranges and units (`mbd_ros.core.ranges`), and its docstring of their meaning; code
    that configures the law reads them there. `Gain` stands for a float for all joints, or one a
    joint. A constructor raises a ModelError that names the gain, what is wrong and what is
    accepted.

    A control law does not keep its own states (an integral): it gives their rates
    (`Control.memory_rate`), and the loop integrates or freezes them.

    Attributes:
        joints: The controlled joints.
        limit_names: Names of the limits that it keeps itself, one an entry of `Control.active`.
        example: Gains with which the law works on a small arm.
        files: Arguments that name files of plans; who builds the law reads them and gives what
            they hold.
    """

    example: ClassVar[dict[str, Any]]
    files: ClassVar[tuple[str, ...]] = ()
    limit_names: tuple[str, ...] = ()
    joints: ControlledJoints

    def begin(self) -> Array:
        """Memory at the start, shape (k,); most control laws have none."""
        return np.zeros(0)

    def details(self) -> dict[str, str]:
        """Remarks of the control law on its work, for diagnostics."""
        return {}

    def warnings(self) -> tuple[str, ...]:
        """What is wrong with its work, for diagnostics."""
        return ()

    def loop_gains(self, at_rest: Response, period: float) -> LoopGains | None:
        """How the control law answers small errors in a pose; None where it is not known.

        Args:
            at_rest: How the joints answer there.
            period: Of the loop [s].
        """
        return None

    def tracking_bound(self, at_rest: Response, period: float) -> Array:
        """Largest errors of the control law in a pose, with masses wrong by `MASS_ERROR`.

        Args:
            at_rest: How the joints answer there.
            period: Of the loop [s].

        Returns:
            [rad or m], shape (n,); inf where the law promises none.
        """
        return np.full(len(self.joints), np.inf)

    def effort(self, x: State, ref: Reference, memory: Array, box: EffortBox) -> Control:
        """The control at a state.

        Args:
            x: Consistent state of all joints of the robot.
            ref: Of the controlled joints.
            memory: States of the control law, shape (k,).
            box: Efforts that the next command may have. The sender clips the command; a
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
        """Of the controlled joints [rad or m], shape (n,), fresh."""
        return x.q[self._q]

    def velocities(self, x: State) -> Array:
        """Of the controlled joints [rad/s or m/s], shape (n,), fresh."""
        return x.v[self._v]

    def response(self, x: State, motion: tuple[Array, Array] | None = None) -> Response:
        """At a consistent state of all joints; `motion` is `accelerations` if it is known."""
        a, mobility = motion or self.accelerations(x)
        self.newest = Response(x.q[self._q], x.v[self._v], a[self._v], mobility[self._v])
        return self.newest

    def accelerations(self, x: State) -> tuple[Array, Array]:
        """Those of all joints without torque, shape (nv,), and per unit torque, (nv, n)."""
        now = self.system.evaluate(x)
        return now.a, now.respond(self._selection)


class Reference(NamedTuple):
    """Demanded motion of the controlled joints, in the order of the controller.

    Attributes:
        q: [rad or m], shape (n,).
        v: [rad/s or m/s], shape (n,).
        a: [rad/s^2 or m/s^2], shape (n,).
    """

    q: Array
    v: Array
    a: Array


class Response(NamedTuple):
    """How the controlled joints answer torques, couplings and loops kept.

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
    """Efforts that the next command may have: torque and torque-rate limits together.

    Attributes:
        lower: [N·m or N], shape (n,); -inf without a limit.
        upper: [N·m or N], shape (n,); inf without a limit.
    """

    lower: Array
    upper: Array


class Control(NamedTuple):
    """The answer of a controller.

    Attributes:
        effort: Of the controlled joints [N·m or N], shape (n,).
        s: Sliding variable e' + lambda e of each [rad/s or m/s], shape (n,).
        equivalent: The part of `effort` that keeps s constant [N·m or N], shape (n,).
        memory_rate: Rate of change of the memory [1/s of its unit], shape (k,).
        active: Which of `Controller.limit_names` hold the effort back; empty without limits.
    """

    effort: Array
    s: Array
    equivalent: Array
    memory_rate: Array
    active: NDArray[np.bool_]


def per_joint(
    value: Gain, n: int, name: str, *, above: float = 0.0, least: float | None = None
) -> Array:
    """A gain as one value a joint, shape (n,), read-only.

    Args:
        value: One for all joints, or one a joint.
        n: Number of joints.
        name: Of the gain, for the message.
        above: Every value must be greater.
        least: Smallest value allowed, instead of `above`.

    Raises:
        ModelError: Another length, not finite, or too small.
    """
    given = np.array(value, dtype=np.float64)
    if given.ndim and given.shape != (n,):
        raise ModelError(f"{name} has {given.size} values; accepted: one, or one a joint ({n})")
    gains = np.full(n, given)
    is_enough = gains > above if least is None else gains >= least
    if not (np.isfinite(gains).all() and is_enough.all()):
        bound = f"> {above:g}" if least is None else f">= {least:g}"
        raise ModelError(f"{name} {given.tolist()} must be finite and {bound}")
    gains.flags.writeable = False
    return gains


def tolerable_delay(gains: LoopGains, period: float) -> Array:
    """The delay between a state and its command up to which a loop is stable, for each joint.

    The open loop with the hold of one period h, a delay D and masses that the model takes for
    too large by `MASS_ERROR`,

        L(jw) = g C(jw) / (jw)^2 sinc(w h / 2) exp(-jw (D + h/2)),   g = 1 / (1 - MASS_ERROR)
        C(jw) = stiffness + jw damping + integral (1 + slope / (jw))

    is on the edge of stability where |L| = 1 and its phase is -pi. Without hold and integral

        w^2 = g (g damping^2 + (g^2 damping^4 + 4 stiffness^2)^(1/2)) / 2
        D = atan(damping w / stiffness) / w - h / 2

    A command acts from the next period on: delays count in whole periods.

    Args:
        gains: Of the control law.
        period: h [s], > 0.

    Returns:
        A whole number of periods [s], >= 0, at most `LONGEST`, shape (n,); 0 where the gains leave
        no room for one.

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
    """Grid about the crossover of each joint [rad/s], shape (n, k)."""
    kd, kp = _TOO_STRONG * gains.damping, _TOO_STRONG * gains.stiffness
    about = np.sqrt(0.5 * (kd**2 + np.sqrt(kd**4 + 4.0 * kp**2)))
    return np.asarray(about[:, None] * np.geomspace(0.2, 5.0, 1000))


class LoopGains(NamedTuple):
    """How a control law answers small errors of decoupled joints.

        e'' = -(damping e' + stiffness e + integral of (e' + lambda e))

    Attributes:
        stiffness: [1/s^2], shape (n,).
        damping: [1/s], shape (n,).
        integral: Of s = e' + lambda e, with lambda = `slope` [1/s^2], shape (n,).
        slope: lambda [1/s], shape (n,).
    """

    stiffness: Array
    damping: Array
    integral: Array
    slope: Array


def sliding_gains(slope: Array, reaching: Array, integral: Array | float = 0.0) -> LoopGains:
    """Of s' = -reaching s - integral of s with s = e' + slope e [1/s, 1/s, 1/s^2]."""
    wanted = np.broadcast_to(np.asarray(integral, dtype=np.float64), slope.shape)
    return LoopGains(slope * reaching, slope + reaching, wanted, slope)


def pd_gains(stiffness: Array, damping: Array) -> LoopGains:
    """Without an integral [1/s^2, 1/s]."""
    return LoopGains(stiffness, damping, np.zeros_like(damping), np.zeros_like(damping))


def disturbance(a_free: Array) -> Array:
    """Accelerations that masses wrong by `MASS_ERROR` cause at rest [rad/s^2 or m/s^2]."""
    return MASS_ERROR * _TOO_STRONG * np.abs(a_free)
