"""Steps of any method with velocities of free bodies in the axes of the world."""

from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.core.integration.adapted_steps import AdaptedSteps
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.state import State


class TurnedSteps(AdaptedSteps):
    """Steps whose states have velocities in the axes of the bodies, as all others.

    Args:
        world: The system in the axes of the world.
        inner: Steps of that.
    """

    def __init__(self, world: InWorldAxes, inner: Stepper) -> None:
        super().__init__(world, inner)
        self._world = world

    def _adapted(self, x: State) -> State:
        return self._world.turned(x)

    def _given(self, after: State) -> State:
        return self._world.turned_back(after)
