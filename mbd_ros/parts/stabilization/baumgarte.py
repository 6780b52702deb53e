"""Baumgarte stabilization of constraints."""

from mbd_ros.core.ranges import Duration
from mbd_ros.errors import ModelError
from mbd_ros.methods.projection.assembly import Stabilization


class Baumgarte(Stabilization):
    """Feedback of constraint violations: g'' + (2 zeta / T) g' + g / T^2 = 0.

    Constraints become J a = -drift - kd g' - kp g with kp = 1 / T^2 and kd = 2 zeta / T.
    Violations stay bounded but do not vanish.

    Explicit steps are unstable with a time constant below 2 dt. In that case 2 dt is used, and
    `mbd-ros check` and `simulate` report it.

    Source: J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1 (1972).

    Args:
        time_constant: T, > 0.
        damping_ratio: zeta, > 0; 1 is critical damping.
    """

    example = {"time_constant": 0.02, "damping_ratio": 1.0}

    def __init__(self, *, time_constant: Duration, damping_ratio: float = 1.0) -> None:
        if time_constant <= 0 or damping_ratio <= 0:
            raise ModelError(
                f"time_constant {time_constant:g} and damping_ratio {damping_ratio:g} must be > 0"
            )
        self.time_constant = time_constant
        self.damping_ratio = damping_ratio

    def floor(self, dt: float) -> float:
        """Return the time constant for steps of length dt, at least 2 dt [s]."""
        return max(self.time_constant, 2.0 * dt)

    def gains(self, dt: float) -> tuple[float, float]:
        """Return kp [1/s^2] and kd [1/s] for steps of length dt."""
        T = self.floor(dt)
        return 1.0 / T**2, 2.0 * self.damping_ratio / T
