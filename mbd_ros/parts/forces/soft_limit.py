"""Joint limits as springs whose stiffness rises smoothly beyond the ends of a range."""

from typing import Annotated

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class SoftLimit(Load):
    """Spring and damper beyond each end of the range of a joint, with a smooth transition.

        tau = lower_stiffness S(l) l - upper_stiffness S(u) u - damping (S(l) + S(u)) v

    l = lower - q and u = q - upper are the excesses beyond the ends, and the smooth step
    S(e) = x^3 (10 - 15 x + 6 x^2) with x = e / transition is 0 for x < 0 and 1 for x > 1. Force
    and stiffness are continuous, so integration needs no event.

    Source: OpenSim's CoordinateLimitForce, A. Seth et al., PLoS Comput. Biol. 14, 2018, e1006223;
        it counts in degrees where this part counts in radians.

    Args:
        joint: Joint that the springs act on.
        lower: Lower end of the range; none by default.
        upper: Upper end of the range; none by default.
        lower_stiffness: Stiffness of the spring below `lower`.
        upper_stiffness: Stiffness of the spring above `upper`.
        damping: Damping beyond either end.
        transition: Excess beyond an end at which spring and damper act fully.
    """

    example = {
        "joint": "ankle",
        "lower": -0.3,
        "upper": 0.3,
        "lower_stiffness": 50.0,
        "upper_stiffness": 40.0,
        "damping": 1.0,
        "transition": 0.1,
    }

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        transition: Annotated[Positive, Unit("rad or m")],
        lower: Annotated[float | None, Unit("rad or m")] = None,
        upper: Annotated[float | None, Unit("rad or m")] = None,
        lower_stiffness: Annotated[NotNegative, Unit("N·m/rad or N/m")] = 0.0,
        upper_stiffness: Annotated[NotNegative, Unit("N·m/rad or N/m")] = 0.0,
        damping: Annotated[NotNegative, Unit("N·m·s/rad or N·s/m")] = 0.0,
    ) -> None:
        self.joint = robot.joint(joint)
        self._damping = damping
        self._width = transition
        self._lower = lower
        self._upper = upper
        self._below = lower_stiffness
        self._above = upper_stiffness
        self._nv = int(robot.model.nv)

    @staticmethod
    def check(lower: float | None, upper: float | None) -> None:
        """Refuse a range without ends, or with a lower end above the upper one."""
        if lower is None and upper is None:
            raise ModelError("lower and upper are missing; give at least one of them")
        if lower is not None and upper is not None and lower > upper:
            raise ModelError(f"lower {lower:g} is above upper {upper:g}")

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau, rate = k.zeros(self._nv), k.item(x.v, self.joint.v)
        total = 0.0
        for excess, stiffness, sign in self._excesses(k, x):
            share, _ = self._smooth_step(k, excess)
            total = total + share * (sign * stiffness * excess - self._damping * rate)
        tau[self.joint.v] = total
        return tau

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of the springs [J], which is zero inside of the range."""
        return sum(
            stiffness * self._smooth_step(k, excess)[1]
            for excess, stiffness, _ in self._excesses(k, x)
        )

    def _excesses(self, k: Kinematics, x: State) -> list[tuple[float, float, float]]:
        """Return the excess beyond each end, with the stiffness and sign of the force there."""
        q, ends = k.item(x.q, self.joint.q), []
        if self._lower is not None:
            ends.append((self._lower - q, self._below, 1.0))
        if self._upper is not None:
            ends.append((q - self._upper, self._above, -1.0))
        return ends

    def _smooth_step(self, k: Kinematics, excess: float) -> tuple[float, float]:
        """Return S(excess) and the integral of S(e) e from 0 to `excess`."""
        width = self._width
        x = k.maximum(0.0, -k.maximum(-excess / width, -1.0))
        share = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
        inner = width * width * x**5 * (2.0 - 2.5 * x + 6.0 / 7.0 * x * x)
        beyond = k.maximum(excess, width)
        return share, inner + 0.5 * (beyond * beyond - width * width)
