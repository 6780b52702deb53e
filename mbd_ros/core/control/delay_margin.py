"""How much delay a control loop tolerates, from its gains and its period."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array

MASS_ERROR = 0.3  # share by which the masses of a model may be too large
_TOO_STRONG = 1.0 / (1.0 - MASS_ERROR)
_ROUNDING = 1.0e-6
LONGEST = 0.04  # [s] of delay that are tolerated at most: what comes later is as good as silence


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
