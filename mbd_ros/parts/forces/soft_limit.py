"""Springs that come in softly beyond the ends of a range."""

from typing import Annotated

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class SoftLimit(Load):
    """Spring and damper beyond either end of a range, which come in over a transition.

        tau = lower_stiffness S(l) l - upper_stiffness S(u) u - damping (S(l) + S(u)) v

    with the ways l = lower - q and u = q - upper beyond the ends, in units of length or angle, and
    S(e) = x^3 (10 - 15 x + 6 x^2) of x = e / transition, 0 before and 1 after it. Force and
    stiffness are continuous, so that steps need no event.

    Source: OpenSim's CoordinateLimitForce, A. Seth et al., PLoS Comput. Biol. 14, 2018, e1006223;
        what is per degree there is per radian here.

    Args:
        joint: Joint that carries the springs.
        lower: End of the range, none by default.
        upper: End of the range, none by default.
        lower_stiffness: Of the spring below.
        upper_stiffness: Of the spring above.
        damping: Of the damper beyond either end.
        transition: Way beyond an end over which both come in.
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
        """Refuse a range without ends, or whose ends are the wrong way round."""
        if lower is None and upper is None:
            raise ModelError("give lower, upper or both")
        if lower is not None and upper is not None and lower > upper:
            raise ModelError(f"lower {lower:g} is above upper {upper:g}")

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau, rate = k.zeros(self._nv), k.item(x.v, self.joint.v)
        total = 0.0
        for way, stiffness, sign in self._ways(k, x):
            share, _ = self._step(k, way)
            total = total + share * (sign * stiffness * way - self._damping * rate)
        tau[self.joint.v] = total
        return tau

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the springs, zero inside the range [J]."""
        return sum(stiffness * self._step(k, way)[1] for way, stiffness, _ in self._ways(k, x))

    def _ways(self, k: Kinematics, x: State) -> list[tuple[float, float, float]]:
        """Way beyond each end, stiffness and sign of the force there."""
        q, ends = k.item(x.q, self.joint.q), []
        if self._lower is not None:
            ends.append((self._lower - q, self._below, 1.0))
        if self._upper is not None:
            ends.append((q - self._upper, self._above, -1.0))
        return ends

    def _step(self, k: Kinematics, way: float) -> tuple[float, float]:
        """S of a way, and the integral of S(e) e up to it."""
        width = self._width
        x = k.maximum(0.0, -k.maximum(-way / width, -1.0))
        share = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
        inner = width * width * x**5 * (2.0 - 2.5 * x + 6.0 / 7.0 * x * x)
        beyond = k.maximum(way, width)
        return share, inner + 0.5 * (beyond * beyond - width * width)
