"""From serialized joint states to messages with the nearest state on the constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import without_multiplier
from mbd_ros.core.dynamics.mass import check_mass_anywhere
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TOGGLE
from mbd_ros.features.estimation.state_reconstruction import StateReconstructor
from mbd_ros.methods.projection.state_projection import ProjectedState, StateProjector
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.shell.parameters import tuning
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
from msg_adapters.multi_array import MultiArrayCdrWriter


class ProjectorPipeline:
    """Scene and projector of a configured node `joint_state_projector`.

    Args:
        description: URDF, where the scene takes it from a topic.

    Attributes:
        joints: Which joints the newest joint state carried.
        reader: Serialized joint states to samples.
        reconstructor: Samples to consistent states.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self.scene = scene = load_scene(values.scene, description)
        rows, loads = rigid(scene.constraints), Loads(scene.robot.model.nv)
        self._system = build_system(scene.robot, scene.couplings, rows, loads, "kkt")
        check_mass_anywhere(self._system)  # the metric of what is nearest
        self._projector = StateProjector(
            self._system, limits=values.limits, amplification=values.amplification
        )
        self.reconstructor = StateReconstructor(
            self._projector, scene.couplings, scene.initial, tuning(values)
        )
        names = self.reconstructor.names
        self.joints = JointStateReader(names, with_effort=False)
        self.reader = JointStateCdrReader(self.joints, joint_state)
        low, high = np.isfinite(self._projector.lower), np.isfinite(self._projector.upper)
        self._limited = (low | high).nonzero()[0]
        self._rows = tuple(without_multiplier(row.name) for row in self._system.rows)
        self._rows += tuple(f"{names[i]}.limit" for i in self._limited)
        self._states = JointStateCdrWriter(names, ("position", "velocity"))
        self._forces = JointStateCdrWriter(self._rows)
        self._no_rates = np.zeros(len(self._limited))
        self._violation = MultiArrayCdrWriter(3)
        self.forget()

    def forget(self) -> None:
        """Forget the past."""
        self.reconstructor.reset()
        self._newest: ProjectedState | None = None
        self._off = np.zeros(len(self._rows))
        self._worst = [0.0, 0.0, 0.0]

    def answer(self, stamp: int, sample: JointSample) -> ProjectorMessages | SampleStatus:
        """Messages for a sample, or why it cannot be used.

        Args:
            stamp: Time [ns].
            sample: What `reader` read last.

        Raises:
            SolveError: There is no consistent state near the sample.
        """
        observation = self.reconstructor.observe(
            stamp, sample.position, sample.velocity, self.joints.present
        )
        if isinstance(observation, SampleStatus):
            return observation
        self._newest, excess = observation, observation.excess[self._limited]
        self._off = np.concatenate([observation.gap, excess])
        self._worst = [_largest(part) for part in (observation.gap, observation.rate, excess)]
        forces = None
        if self._rows:
            forces = self._forces.write(
                stamp,
                position=self._off,
                velocity=np.concatenate([observation.rate, self._no_rates]),
                effort=np.concatenate(
                    [observation.multipliers, observation.limit_multipliers[self._limited]]
                ),
            )
        states = self._states.write(stamp, position=observation.x.q, velocity=observation.x.v)
        return ProjectorMessages(states, forces, self._violation.write(self._worst))

    def health(self, tolerance: float) -> tuple[int, str]:
        """WARN where the measurement is off a constraint or beyond a limit, or near a toggle.

        Args:
            tolerance: Accepted violation [rad or m].
        """
        texts = [
            f"{name} by {distance:.4g}"
            for name, distance in zip(self._rows, self._off, strict=True)
            if abs(distance) > tolerance
        ]
        reasons = [f"measurement violates {', '.join(texts)}"] if texts else []
        if self._newest is not None and self._newest.condition > TOGGLE:
            reasons.append("redundant rows or near a toggle position: multipliers are unreliable")
        return (WARN, "; ".join(reasons)) if reasons else (OK, "projected states published")

    def held_joints(self) -> Sequence[str]:
        """Joints that keep their last position: the newest joint state lacked them."""
        return self.reconstructor.held_joints

    def details(self) -> dict[str, str]:
        """Origin of the newest state, for diagnostics."""
        robot, newest = self.scene.robot, self._newest
        held_names, missing = self.reconstructor.held_joints, self.reconstructor.missing
        solves, qp = self._projector.statistics
        position, velocity, excess = (f"{value:.6g}" for value in self._worst)
        return {
            "joints dropped": ", ".join(robot.locked) or "none",
            "joints reconstructed": ", ".join(n for n in missing if n not in held_names) or "none",
            "joints held": ", ".join(held_names) or "none",
            "limits": "kept" if len(self._limited) else "not kept",
            "limits acting": ", ".join(self._active_limits()) or "none",
            "largest position violation": position,
            "largest velocity violation": velocity,
            "largest excess beyond a limit": excess,
            "iterations of the last state": str(newest.iterations if newest else 0),
            "condition number": f"{newest.condition:.3g}" if newest else "none yet",
            "solves with acting limits": str(solves),
            "QP": ", ".join(f"{key} {count}" for key, count in qp._asdict().items()),
            "gravity": "not used",
        }

    def _active_limits(self) -> list[str]:
        if self._newest is None:
            return []
        pairs = zip(self.reconstructor.names, self._newest.limit_multipliers, strict=True)
        return [name for name, force in pairs if force != 0.0]


class ProjectorMessages(NamedTuple):
    """Messages that answer a joint state.

    Attributes:
        states: All joints, serialized.
        forces: One entry a row and a limit, serialized; None without any.
        violation: Float64MultiArray of three numbers, serialized.
    """

    states: bytes
    forces: bytes | None
    violation: bytes


def _largest(values: Array) -> float:
    return max(map(abs, values.tolist()), default=0.0)
