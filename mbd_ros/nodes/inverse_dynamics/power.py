"""Powers of a solved joint state as a message."""

from collections.abc import Sequence
from typing import Any

from mbd_ros.core.inverse_dynamics.observed_power import ObservedPower
from mbd_ros.core.inverse_dynamics.torque_estimator import Observation
from mbd_ros.core.inverse_dynamics.torques import SampleSolver, Torques
from mbd_ros.scene.built_scene import Scene
from msg_adapters.multi_array_cdr import MultiArrayCdrWriter


class PowerAnswer:
    """Serialized Float64MultiArray whose labels are names of powers.

    Args:
        scene: The scene.
        solver: What solves its joint states.
    """

    def __init__(self, scene: Scene, solver: SampleSolver) -> None:
        self._power = ObservedPower(scene.robot, solver, scene.wrenches, scene.acting)
        names = [output.name for output in self._power.outputs]
        self._writer = MultiArrayCdrWriter(len(names), names)

    def write(self, x: Observation, found: Torques, wrenches: Sequence[Any]) -> bytes:
        """The message of an observation and of what was found for it."""
        values = self._power.values(x.position, x.velocity, x.acceleration, found, wrenches)
        return self._writer.write(values.tolist())
