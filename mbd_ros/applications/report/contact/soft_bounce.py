"""Restitution of a linear spring and damper that only pushes."""

import math

_HALVINGS = 60


def damping_ratio(restitution: float) -> float:
    """Damping ratio of the contact that gives back a share of the speed of an impact.

    The contact ends when its force vanishes, not when its gap does.

    Args:
        restitution: From 0 to 1; 0 gives critical damping.

    Source: T. Schwager, T. Pöschel, Granular Matter 9, 2007, 465-469, eq. 21.
    """
    if restitution == 0.0:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        ratio = 0.5 * (low + high)
        low, high = (ratio, high) if _restitution(ratio) > restitution else (low, ratio)
    return 0.5 * (low + high)


def _restitution(ratio: float) -> float:
    """With damping beta and frequency omega, both in units of the undamped frequency."""
    beta, omega = ratio, math.sqrt(1.0 - ratio**2)
    phase = math.pi - math.atan2(2.0 * beta * omega, omega**2 - beta**2)
    return math.exp(-beta / omega * phase)
