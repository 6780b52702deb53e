"""Contract of stabilizations, which keep a simulation on its constraints."""

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import State


class Stabilization:
    """Either corrects the acceleration, by `gains`, or the state after a step, by `correct`.

    Attributes:
        projects: Whether `correct` finds the nearest consistent state in the mass metric, which
            compiled runs do themselves.
    """

    projects: bool = False

    def gains(self, dt: float) -> tuple[float, float]:
        """Gains kp [1/s^2] and kd [1/s] of g'' + kd g' + kp g = 0, for steps of dt [s]."""
        return 0.0, 0.0

    def correct(self, system: System, x: State) -> State:
        """The state from which to continue after a step; `x` itself without a correction."""
        return x
