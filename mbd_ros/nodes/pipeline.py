"""A built scene between messages: from an accepted sample to the messages that answer it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from mbd_ros.core.differentiation import NANOSECOND
from mbd_ros.core.torque_estimator import Observation, TorqueEstimator
from mbd_ros.core.wrenches import WrenchBuffer
from mbd_ros.nodes.inverse_dynamics_parameters import tuning
from mbd_ros.scene import load_scene
from mbd_ros.scene_check import tier
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import JointStateReader, JointStateWriter


class Pipeline:
    """What the node `inverse_dynamics` builds when it is configured.

    Args:
        values: Parameters of the node.
        description: URDF, where the scene takes it from a topic.

    Attributes:
        scene: The scene.
        estimator: Samples to torques.
        reader: Joint states to samples.
        buffers: Newest samples of every wrench, by name.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self.scene = load_scene(values.scene, description)
        couplings = self.scene.couplings
        self.estimator = TorqueEstimator(
            self.scene.robot, self.scene.inverse_dynamics(), tuning(values)
        )
        self.reader = JointStateReader(self.estimator.names)
        self._torques = JointStateWriter(JointState(), couplings.independent)
        self._forces = JointStateWriter(JointState(), couplings.dependent, ("position", "effort"))
        ages = int(values.wrench_max_age / NANOSECOND), int(values.rewind / NANOSECOND)
        self.buffers = {name: WrenchBuffer(*ages) for name in self.scene.wrenches}
        self._violation = np.zeros(len(couplings.dependent))

    def reset(self) -> None:
        """Forget the past."""
        self.estimator.reset()
        for buffer in self.buffers.values():
            buffer.clear()

    def answer(self, x: Observation, wrenches: Sequence[Any]) -> tuple[Any, Any] | None:
        """Messages for an observation; None if the torques are not finite.

        Args:
            x: The observation.
            wrenches: One (6,) array for every load of the scene.

        Returns:
            Kept messages: joint torques, and constraint forces (position = violation of the coupling,
            effort = multiplier) or None without dependent joints.
        """
        torques = self.estimator.solve(x, wrenches)
        if torques is None:
            return None
        answer = self._torques.write(
            x.stamp, position=x.position, velocity=x.velocity, effort=torques.tau
        )
        if not self.scene.couplings.dependent:
            return answer, None
        self._violation = self.estimator.violation(x)
        forces = self._forces.write(
            x.stamp, position=self._violation, effort=torques.multipliers
        )
        return answer, forces

    def health(self, tolerance: float) -> tuple[int, str]:
        """WARN where a measured dependent joint is off its coupling.

        Args:
            tolerance: Accepted distance [rad or m].
        """
        off = [
            f"{name} by {distance:.4g}"
            for name, distance in zip(self._dependent, self._violation, strict=True)
            if abs(distance) > tolerance
        ]
        if off:
            return WARN, f"off their couplings: {', '.join(off)}; the independent joints are used"
        return OK, "torques published"

    def details(self) -> dict[str, str]:
        """What the numbers contain and how they are made, for diagnostics."""
        robot, filters = self.scene.robot, self.estimator.differentiator
        reconstructed = [name for name in self.reader.missing if name in self._dependent]
        held = [name for name in self.reader.missing if name not in self._dependent]
        return {
            "gravity": f"included, {robot.model.gravity.linear.tolist()} m/s^2",
            "joints dropped": ", ".join(robot.locked) or "none",
            "joints reconstructed": ", ".join(reconstructed) or "none",
            "joints held": ", ".join(held) or "none",
            "derivatives": f"causal, delay {filters.delay:.4f} s, "
            f"settled after {filters.settling_time:.4f} s",
            "largest coupling violation": f"{np.abs(self._violation).max(initial=0.0):.6g}",
            "solver tier": tier(self.scene),
        }

    @property
    def _dependent(self) -> tuple[str, ...]:
        return self.scene.couplings.dependent
