"""Joint whose position is a given function of time."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.coupling_functions import Polynomial, natural_cubic_spline
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import OptionalDuration, Positive, Unit, is_value
from mbd_ros.core.rows.constraint import Constraint, Row, drive
from mbd_ros.core.state import Array, State, is_symbol
from mbd_ros.errors import ModelError

Motion = Callable[[Kinematics, float], tuple[float, float, float]]
_HARMONIC = ("amplitude", "angular_frequency", "offset", "phase")


class PrescribedMotion(Constraint):
    """Rheonomic constraint g = q - f(t), where f is exactly one of three kinds of functions.

    The multiplier is the effort of an ideal drive. With a finite `limit` the drive lags behind
    where its effort does not suffice, and returns to the motion by g'' + 2 g' / T + g / T^2 = 0.

    Args:
        joint: Driven joint.
        polynomial: Coefficients c0, c1, ... of f = c0 + c1 t + c2 t^2 + ...
        harmonic: Amplitude [rad or m], angular_frequency [rad/s] and optionally offset [rad or m]
            and phase [rad] of f = offset + amplitude sin(angular_frequency t + phase).
        spline: Times x [s] and positions y [rad or m] of a natural cubic spline, which is
            extrapolated by straight lines.
        limit: Largest effort of the drive; unlimited by default.
        smoothed: Whether a drive with a limit is solved for in every evaluation instead of
            switching at events, which lowers the order of the integrator; `time_constant` implies
            it.
        time_constant: Time constant T of a drive with a finite limit, 0.02 s by default.
    """

    example = {
        "joint": "hip_flexion",
        "harmonic": {"offset": 0.2, "amplitude": 0.3, "angular_frequency": 6.0, "phase": 0.5},
        "limit": 100.0,
    }

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        polynomial: Annotated[Sequence[float] | None, Unit("rad or m, per power of s")] = None,
        harmonic: Annotated[Mapping[str, float] | None, Unit("as above")] = None,
        spline: Annotated[Mapping[str, Sequence[float]] | None, Unit("as above")] = None,
        limit: Annotated[Positive, Unit("N·m or N")] = math.inf,
        smoothed: bool = False,
        time_constant: OptionalDuration = None,
    ) -> None:
        self.joint = robot.joint(joint)
        self._motion = _motion(polynomial, harmonic, spline)
        self.law = drive(limit)
        if not is_value(limit, math.inf):
            self.smoothed = smoothed or time_constant is not None
            T = 0.02 if time_constant is None else time_constant
            self.gains = (1.0 / T**2, 2.0 / T)
        self.driven = (joint,)
        self.rows = (Row(self.joint.effort_name, self.joint.effort_unit),)
        self._jacobian = np.zeros((1, robot.model.nv))
        self._jacobian[0, self.joint.v] = 1.0

    @staticmethod
    def check(
        polynomial: Sequence[float] | None,
        harmonic: Mapping[str, float] | None,
        spline: Mapping[str, Sequence[float]] | None,
    ) -> None:
        """Refuse more or less than one function, and unknown or missing keys of a function."""
        functions = {"polynomial": polynomial, "harmonic": harmonic, "spline": spline}
        kinds = [key for key, function in functions.items() if function is not None]
        if len(kinds) != 1:
            raise ModelError(
                f"give exactly one of {', '.join(functions)}; got {', '.join(kinds) or 'none'}"
            )
        if spline is not None and set(spline) != {"x", "y"}:
            raise ModelError(f"spline has {', '.join(spline) or 'nothing'}, accepted: x and y")
        for key in harmonic or ():
            if key not in _HARMONIC:
                raise ModelError(f"harmonic has '{key}', accepted: {', '.join(_HARMONIC)}")
        for key in _HARMONIC[:2] if harmonic is not None else ():
            if key not in harmonic:
                raise ModelError(f"harmonic: {key} is missing")

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return q - f(t) [rad or m], shape (1,)."""
        return k.array((k.item(x.q, self.joint.q) - self._motion(k, x.t)[0],))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the row with 1 at the joint, shape (1, nv)."""
        return self._jacobian

    def rate(self, k: Kinematics, x: State) -> Array:
        """Return -f', shape (1,)."""
        return k.array((-self._motion(k, x.t)[1],))

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return -f'', shape (1,)."""
        return k.array((-self._motion(k, x.t)[2],))


def _motion(
    polynomial: Sequence[float] | None,
    harmonic: Mapping[str, float] | None,
    spline: Mapping[str, Sequence[float]] | None,
) -> Motion:
    if harmonic is not None:
        return _harmonic(harmonic)
    if spline is not None:
        return _motion_of(natural_cubic_spline(spline["x"], spline["y"]))
    assert polynomial is not None
    return _motion_of(Polynomial(polynomial))


def _motion_of(function: Callable[[float], tuple[float, float, float]]) -> Motion:
    return lambda k, t: function(t if is_symbol(t) else float(t))


def _harmonic(entry: Mapping[str, float]) -> Motion:
    amplitude, frequency = entry["amplitude"], entry["angular_frequency"]
    offset, phase = entry.get("offset", 0.0), entry.get("phase", 0.0)

    def motion(k: Kinematics, t: float) -> tuple[float, float, float]:
        angle = frequency * t + phase
        swing = amplitude * k.sin(angle)
        slope = amplitude * frequency * k.cos(angle)
        return offset + swing, slope, -frequency * frequency * swing

    return motion
