"""What a scene makes for motion that is measured: solvers for efforts, and joints to control."""

import math
from collections.abc import Collection
from typing import Any

from mbd_ros.core.control.contract import ControlledJoints
from mbd_ros.core.dynamics.mass_check import check_mass_anywhere
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.inverse_dynamics.efforts import joint_efforts
from mbd_ros.core.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.core.inverse_dynamics.observed_loops import ObservedLoops
from mbd_ros.core.inverse_dynamics.standing import Nearness, carriers
from mbd_ros.core.inverse_dynamics.torques import SampleSolver
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.multiplier_laws import Kind
from mbd_ros.core.rows.row_layout import rigid
from mbd_ros.errors import ModelError, SceneError, SolveError
from mbd_ros.scene.scene_parts import SceneParts


class MeasuredScene(SceneParts):
    """The parts of a scene, and what they make where its motion is measured."""

    def inverse_dynamics(
        self,
        *,
        with_bounds: bool = False,
        contacts: Collection[str] = (),
        near: Nearness | None = None,
    ) -> SampleSolver:
        """A solver with its own Pinocchio data, for the independent joints.

        Without loops and bounds it is an `InverseDynamics`, which takes many samples at once.

        Args:
            with_bounds: As for `closed_loop`.
            contacts: As for `closed_loop`.
            near: As for `closed_loop`.
        """
        self._refuse_internal("inverse dynamics")
        if self.has_loops or with_bounds or contacts:
            asked: dict[str, Any] = {"contacts": contacts, "near": near}
            return ObservedLoops(self.closed_loop(with_bounds=with_bounds, **asked))
        loads = tuple(self.wrenches.values())
        return InverseDynamics(self.robot, self.couplings, loads, self.acting)

    def closed_loop(
        self,
        *,
        with_bounds: bool = False,
        contacts: Collection[str] = (),
        near: Nearness | None = None,
    ) -> ClosedLoopInverseDynamics:
        """A solver for the efforts of `actuated` and all multipliers, with its own data.

        Args:
            with_bounds: Whether efforts keep the limits of their actuators, and stops, dry
                friction and limited drives exert what their law lets them.
            contacts: Names of rigid contacts whose forces are unknown, see `unmeasured_contacts`;
                joints that stand for a free base exert nothing then.
            near: What counts as on the ground.

        Raises:
            SceneError: An actuated joint is unknown or repeated.
        """
        self._refuse_internal("inverse dynamics")
        loads = tuple(self.wrenches.values())
        parts = self.robot, self.couplings, self.constraints
        try:
            limits, free = self._effort_limits(), self.carriers if contacts else ()
            acting = {name: limits[name] for name in limits if name not in free}
            efforts = joint_efforts(self.robot, list(acting), list(acting.values()))
            return ClosedLoopInverseDynamics(
                *(*parts, efforts, loads, self.acting),
                with_bounds=with_bounds,
                contacts=contacts,
                carriers=free,
                near=near,
            )
        except ModelError as error:
            raise SceneError(f"{self.name}: {error}") from error

    @property
    def closed_contacts(self) -> tuple[str, ...]:
        """Names of its rigid contacts."""
        return tuple(part.name for part in self.constraints if part.law.kind is Kind.CONE)

    @property
    def unmeasured_contacts(self) -> tuple[str, ...]:
        """Rigid contacts of links that no external wrench acts on."""
        links = {wrench.carrier.number for wrench in self.wrenches.values()}
        return tuple(
            part.name
            for part in self.constraints
            if part.law.kind is Kind.CONE
            and not links & {self.robot.carrier(point.frame).number for point in part.pair.points}
        )

    @property
    def carriers(self) -> tuple[str, ...]:
        """Joints that stand for a free base, where forces of contacts are unknown."""
        return carriers(self.robot, self.actuated if self.actuators else None)

    def controlled_joints(self) -> ControlledJoints:
        """The actuated joints as a controller sees them, with their own Pinocchio data.

        Raises:
            SceneError: No joint can be controlled, or one moves nothing with mass.
        """
        self._refuse_internal("a controller")
        if self.muscles:
            raise SceneError(
                f"{self.name}: a controller drives actuators, no muscles; leave them out"
            )
        loads = Loads(self.robot.model.nv, self.forces, (), self.inputs.sources({}))
        try:
            system = build_system(self.robot, self.couplings, rigid(self.constraints), loads)
            check_mass_anywhere(system)
            return ControlledJoints(system, self.actuated)
        except (ModelError, SolveError) as error:
            raise SceneError(f"{self.name}: {error}") from error

    def _refuse_internal(self, who: str) -> None:
        """Refuse states that no measured motion shows, besides those of actuators.

        Raises:
            SceneError: Names the parts.
        """
        if self.unmeasured:
            parts = ", ".join(self.unmeasured)
            raise SceneError(
                f"{self.name}: {who} knows no internal states, which {parts} has; leave it out"
            )

    def _effort_limits(self) -> dict[str, float]:
        """Largest effort of each of `actuated` [N·m or N], inf without actuators."""
        limits = dict.fromkeys(self.actuated, 0.0 if self.actuators else math.inf)
        for actuator in self.actuators:
            for name, limit in zip(actuator.joints, actuator.limits().tolist(), strict=True):
                limits[name] += limit
        return limits
