"""From serialized joint states with efforts to mass and inertia of what the robot carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.inertial_parameters import PARAMETER_NAMES, inertia_of
from mbd_ros.errors import SceneError
from mbd_ros.features.identification.payload.job import find_carrier
from mbd_ros.features.identification.payload.recursive import RecursivePayload
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.methods.inverse_dynamics.torque_estimator import JointObserver
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.shell.parameters import tuning
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader


class PayloadPipeline:
    """Scene and estimator of a configured node `payload_estimator`.

    Args:
        description: URDF, where the scene takes it from a topic.

    Attributes:
        frame: Link that carries the payload.
        joints: Which joints the newest joint state carried.
        reader: Serialized joint states to samples.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self.scene = scene = load_scene(values.scene, description)
        _refuse(scene)
        self.frame, _ = find_carrier(scene, values.frame or None)
        self.joints = JointStateReader((*scene.couplings.independent, *scene.couplings.dependent))
        self.reader = JointStateCdrReader(self.joints, joint_state)
        self._n = len(scene.couplings.independent)
        self._observer = JointObserver(scene.robot, scene.couplings, tuning(values))
        self.tune(values)

    def tune(self, values: Any) -> None:
        """Other numbers; the estimate starts again."""
        solver = self.scene.inverse_dynamics()
        assert isinstance(solver, InverseDynamics)
        self._observer.tune(tuning(values))
        self.estimate = RecursivePayload(
            self.scene.robot,
            solver,
            self.frame,
            cutoff=values.cutoff,
            memory=values.memory,
            mass=values.largest_mass,
            size=values.size,
        )
        self.forget()

    def forget(self) -> None:
        """Forget the past."""
        self._observer.reset()
        self.estimate.reset()
        self._lacking: tuple[str, ...] = ()

    def answer(self, stamp: int, sample: JointSample) -> Carried | SampleStatus | None:
        """The newest estimate, or why a sample cannot be used; None between two estimates.

        Args:
            stamp: Time [ns].
            sample: What `reader` read last.

        Raises:
            SolveError: No finite estimate explains the sample.
        """
        present = self.joints.present
        seen = self._observer.observe(stamp, sample.position, sample.velocity, present)
        if isinstance(seen, SampleStatus):
            return seen
        if self._observer.outcome is SampleStatus.RESTARTED:
            self.estimate.reset()
        effort = sample.effort[: self._n]
        names = self.scene.couplings.independent
        self._lacking = tuple(
            name for name, there in zip(names, np.isfinite(effort), strict=True) if not there
        )
        if self._lacking or self._observer.outcome is SampleStatus.DUPLICATE:
            return None
        if not self.estimate.update(stamp, seen.position, effort):
            return None
        body = inertia_of(self.estimate.body)
        I = body.inertia  # noqa: E741, the field's name
        moments = [float(I[i, j]) for i in range(3) for j in range(i, 3)]
        covariance = self.estimate.covariance.ravel().tolist()
        return Carried(float(body.mass), body.lever.tolist(), moments, covariance)

    def health(self) -> tuple[int, str]:
        """WARN where efforts lack or the motion does not show everything."""
        if self._lacking:
            return WARN, f"no effort of {', '.join(self._lacking)}"
        if not self.estimate.updates:
            return OK, "filters settle"
        hidden = self._hidden()
        if hidden:
            return WARN, f"the motion does not show {', '.join(hidden)}"
        return OK, "payload published"

    def held_joints(self) -> Sequence[str]:
        """Joints that nothing gives."""
        return ()

    def details(self) -> dict[str, str]:
        """The newest estimate, for diagnostics."""
        payload = self.estimate
        sigma = np.sqrt(np.diag(payload.covariance))
        residual = ", ".join(f"{x:.3g}" for x in payload.deviation)
        return {
            "link": self.frame,
            "mass": f"{payload.numbers[0]:.6g} +- {sigma[0]:.2g} kg",
            "not shown by the motion": ", ".join(self._hidden()) or "none",
            "residual of the joints": f"{residual} N·m or N",
            "joints without effort": ", ".join(self._lacking) or "none",
            "joints dropped": ", ".join(self.scene.robot.locked) or "none",
            "gravity": "included",
        }

    def _hidden(self) -> list[str]:
        return [
            name
            for name, there in zip(PARAMETER_NAMES, self.estimate.is_determined, strict=True)
            if not there
        ]


class Carried(NamedTuple):
    """The payload of the robot, in the axes of the link.

    Attributes:
        mass: [kg].
        centre: Mass centre [m], three numbers.
        moments: About the mass centre: xx, xy, xz, yy, yz, zz [kg·m^2].
        covariance: Of mass, mass times centre, and xx, xy, yy, xz, yz, zz about the origin of the
            link, row by row, 100 numbers.
    """

    mass: float
    centre: list[float]
    moments: list[float]
    covariance: list[float]


def _refuse(scene: Scene) -> None:
    """Refuse scenes whose torques joint states do not tell."""
    why = "loops" if scene.has_loops else "free bases" if scene.robot.floating else ""
    why = why or ("external_wrenches" if scene.wrenches else "")
    if not why:
        return
    advice = {
        "loops": "record the motion: mbd-ros identify takes mechanisms with loops",
        "free bases": "hold the base and give a scene with `robot: {base: fixed}`",
        "external_wrenches": "give a scene without this section",
    }[why]
    raise SceneError(f"{scene.name}: payload_estimator serves scenes without {why}; {advice}")
