"""What keeps a simulation on its constraints: the contract of stabilizations."""

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import State


class Stabilization:
    """Either corrects the acceleration, by `gains`, or the state after a step, by `correct`."""

    def gains(self, dt: float) -> tuple[float, float]:
        """Kp [1/s^2] and kd [1/s] of g'' + kd g' + kp g = 0, for steps of dt [s]."""
        return 0.0, 0.0

    def correct(self, system: System, x: State) -> State:
        """The state to go on from after a step; `x` itself where nothing is corrected."""
        return x
