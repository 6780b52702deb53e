"""Feedback of position and velocity violations into the acceleration."""

from mbd_ros.core.ranges import Duration
from mbd_ros.errors import ModelError
from mbd_ros.methods.projection.assembly import Stabilization


class Baumgarte(Stabilization):
    """g'' + (2 zeta / T) g' + g / T^2 = 0. Violations are bounded, not zero.

    The rows of a scene take kp = 1 / T^2 and kd = 2 zeta / T as J a = -drift - kd g' - kp g.

    A time constant below 2 dt would make explicit steps unstable: 2 dt is used then, and `check`
    and `simulate` say so.

    Source: J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1 (1972).

    Args:
        time_constant: T [s], > 0.
        damping_ratio: zeta, > 0; 1 is critical.
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
        """The time constant that is used with steps of dt [s]."""
        return max(self.time_constant, 2.0 * dt)

    def gains(self, dt: float) -> tuple[float, float]:
        """Kp [1/s^2] and kd [1/s]."""
        T = self.floor(dt)
        return 1.0 / T**2, 2.0 * self.damping_ratio / T
