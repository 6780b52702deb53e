"""Steps of fixed length by an explicit Runge-Kutta method."""

import math
from typing import Any

from mbd_ros.core.integration.nystrom_stages import NystromStages
from mbd_ros.core.integration.runge_kutta_stages import Stages
from mbd_ros.core.integration.step_length import NEAR, clip
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.integration.tableau import Tableau
from mbd_ros.core.memory import Memory
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import ModelError


class RungeKutta(Stepper):
    """Explicit Runge-Kutta steps.

    Args:
        system: The system.
        tableau: The method.
        dt: Length of a step [s].

    Attributes:
        stages: The last step at work.
    """

    def __init__(self, system: Any, tableau: Tableau, dt: float) -> None:
        self.stages = (NystromStages if system.chart.is_flat else Stages)(system, tableau)
        self._dt, self._near = dt, NEAR * dt

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        start = x[0]
        if start + self._near > end:
            h, t = clip(start, self._dt, end)
            return self.stages.step(x, u, h, t) if h > 0.0 else x
        return self.stages.step(x, u, self._dt, start + self._dt)

    def restart(self) -> None:
        """Forget the acceleration at the end of the last step."""
        self.stages.forget()

    def again(self, h: float, t: float) -> State:
        """As `Stepper.again`."""
        return self.stages.advance(h, t)

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """As `Stepper.follow`; the length of adaptive steps is kept."""
        self.stages.follow(accelerate, mode)

    def memory(self) -> Memory:
        """The last step."""
        return {**super().memory(), "stages": self.stages.memory()}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        super().recall({name: memory[name] for name in self.kept}, x)
        self.stages.recall(memory["stages"], x)

    def interpolate(self, t: float) -> State:
        """State inside the last step, by the dense output of the method.

        Raises:
            ModelError: t [s] is outside the last step.
        """
        start, end = self.stages.span
        slack = 1.0e-9 * (end - start)
        if not start - slack <= t <= end + slack:
            raise ModelError(f"t = {t:.9g} s is outside the last step, {start:.9g} .. {end:.9g} s")
        return self.stages.at(t)
