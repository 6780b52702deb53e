"""How far a fixed step goes when the end of the simulation is near."""

import math

from mbd_ros.core.thresholds import SAME_TIME

NEAR = 1.0 + 1.0e-6  # in dt: no step needs `clip` that starts farther than this from the end


def clip(t: float, dt: float, end: float) -> tuple[float, float]:
    """Length of a step of at most dt that does not go beyond `end`, and the time it leads to.

    A step that would end within rounding of `end` ends there with its full length, so that no
    sliver of a step follows it.

    Args:
        t: Time at its start [s].
        dt: Full length [s].
        end: [s]

    Returns:
        Length, <= 0 at or after `end`, and time after it [s].
    """
    left = end - t
    if abs(left - dt) <= SAME_TIME * dt + 4.0 * math.ulp(t):
        return dt, end
    return (left, end) if left < dt else (dt, t + dt)
