"""What a scene file describes, and what can be made of it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbd_ros.core.control.contract import ControlledJoints
from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.mass_check import check_mass_anywhere
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.inverse.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.inverse.inverse_dynamics import InverseDynamics
from mbd_ros.core.inverse.observed_loops import ObservedLoops
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Actuator, Constraint, ForceTerm
from mbd_ros.core.projection.stabilizing import Stabilization
from mbd_ros.core.simulation.safe_command import SafeCommand
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError, ModelError, SceneError, SolveError
from mbd_ros.scene import schema
from mbd_ros.scene.building import parts_in
from mbd_ros.scene.coupling_entries import coupling_kinds
from mbd_ros.scene.part_entries import MeasuredWrench, Solver, build_part
from mbd_ros.scene.sections import Section
from mbd_ros.scene.site import Origin

DEFAULT_INTEGRATOR = {"type": "dopri5"}
DEFAULT_STABLE = 1.3  # its `stable`, known without importing it
SHORTEST_DT, LONGEST_DT = 1.0e-9, 9.0e9  # s: stamps hold whole nanoseconds, in 63 bits


def refuse_dt(dt: float, where: str, kind: type[MbdError]) -> None:
    """Refuse a step, and interval of the output, that stamps cannot tell apart.

    Args:
        dt: [s].
        where: File and key, or option.
        kind: The error to raise.
    """
    if not 0 < dt < math.inf:
        raise kind(f"{where}: {dt:g} s must be finite and > 0")
    if not SHORTEST_DT <= dt <= LONGEST_DT:
        raise kind(
            f"{where}: {dt:g} s, accepted: {SHORTEST_DT:g} .. {LONGEST_DT:g} s, since stamps hold "
            "whole nanoseconds"
        )


@dataclass(frozen=True, eq=False)
class Scene:
    """What a scene describes, built.

    Attributes:
        origin: The file, or what else its sections came from.
        robot: The robot, with the inertia of its drives.
        parts: What every section made, by key; the robot there is without its drives.
        entries: What the sections say, by key.
        sections: Lines of the table, those of other packages included.
        code: Key -> `package.module:Class` of what was imported from outside this package.
    """

    origin: Origin
    robot: Robot
    parts: Mapping[str, Any]
    entries: Mapping[str, Any]
    sections: tuple[Section, ...]
    code: Mapping[str, str]

    @property
    def path(self) -> Path | None:
        """The file; None for a scene that Python made."""
        return self.origin.path

    @property
    def name(self) -> str:
        """The file as messages call it, `scene` without one."""
        return self.origin.name

    @property
    def source(self) -> str:
        """File or topic of the robot description."""
        return self.robot.source

    @property
    def couplings(self) -> Couplings:
        """Its dependent joints."""
        couplings: Couplings = self.parts["couplings"]
        return couplings

    @property
    def coupling_kinds(self) -> Mapping[str, str]:
        """Dependent joint -> parent and kind of coupling function, for people."""
        return coupling_kinds(self.couplings, self.entries.get("couplings", {}))

    @property
    def wrenches(self) -> Mapping[str, MeasuredWrench]:
        """External loads by name."""
        return self.parts.get("external_wrenches", {})

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """Constraints besides the couplings, of all sections."""
        return self._offering("residual")

    @property
    def forces(self) -> tuple[ForceTerm, ...]:
        """Force terms, of all sections."""
        return self._offering("force")

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Actuators, in the order of their commands."""
        return self._offering("torque")

    @property
    def stabilization(self) -> Stabilization | None:
        """What keeps the constraints; None leaves the choice to `simulation`."""
        return self.parts.get("stabilization")

    @property
    def solver(self) -> Solver:
        """How the equations are solved."""
        solver: Solver = self.parts["solver"]
        return solver

    @property
    def integrator(self) -> Integrator | None:
        """Method; None leaves the choice to `simulation`."""
        return self.parts.get("integrator")

    @property
    def integrator_entry(self) -> Mapping[str, Any]:
        """What the file says of it, empty without a word."""
        return self.entries.get("integrator", {})

    @property
    def dt(self) -> float:
        """Step [s]."""
        dt: float = self.parts["dt"]
        return dt

    @property
    def initial(self) -> State:
        """State of all joints at the start, as the file gives it."""
        initial: State = self.parts["initial"]
        return initial

    @property
    def safe(self) -> SafeCommand:
        """What the actuators do without a command."""
        safe: SafeCommand = self.parts["safe"]
        return safe

    @property
    def absent(self) -> tuple[str, ...]:
        """Sections that the file leaves out."""
        return tuple(s.key for s in self.sections if not self.entries.get(s.key))

    def _offering(self, method: str) -> tuple[Any, ...]:
        """Parts of all sections whose parts have a method, in the order of the table."""
        return tuple(
            part
            for section in self.sections
            if method in section.offers and section.key in self.parts
            for part in parts_in(section, self.parts[section.key])
        )

    def holding(self, **parts: Any) -> "Scene":
        """A copy that holds other built parts, for who has objects rather than entries.

        Args:
            **parts: By key of their section, such as `forces=(*scene.forces, part)`.
        """
        return replace(self, parts={**self.parts, **parts})

    @property
    def has_loops(self) -> bool:
        """Whether bilateral constraints act besides the couplings."""
        return any(part.bounds is None for part in self.constraints)

    @property
    def actuated(self) -> tuple[str, ...]:
        """Joints with an actuator; without any, all independent ones that no drive moves."""
        if self.actuators:
            return tuple(dict.fromkeys(name for part in self.actuators for name in part.joints))
        driven = {name for part in self.constraints for name in part.driven}
        return tuple(name for name in self.couplings.independent if name not in driven)

    def inverse_dynamics(self) -> InverseDynamics | ObservedLoops:
        """A solver with its own Pinocchio data, for the independent joints."""
        if self.has_loops:
            return ObservedLoops(self.closed_loop())
        loads = [wrench.load for wrench in self.wrenches.values()]
        return InverseDynamics(self.robot, self.couplings, loads, self.forces)

    def closed_loop(self) -> ClosedLoopInverseDynamics:
        """A solver for the efforts of `actuated` and all multipliers, with its own data.

        Raises:
            SceneError: An actuated joint is unknown or repeated.
        """
        loads = [wrench.load for wrench in self.wrenches.values()]
        try:
            return ClosedLoopInverseDynamics(
                self.robot, self.couplings, self.constraints, self.actuated, loads, self.forces
            )
        except ModelError as error:
            raise SceneError(f"{self.name}: {error}") from error

    def system(
        self, forces: Sequence[ForceTerm] = (), solver: Mapping[str, str] | None = None
    ) -> System:
        """Forward dynamics with its own Pinocchio data.

        Args:
            forces: Force terms besides those of the scene.
            solver: Entry that replaces that of the scene.

        Raises:
            SceneError: The tier cannot serve the scene, or a package is missing.
        """
        where = f"{self.name}: solver"
        chosen = self.solver if solver is None else schema.call(Solver, dict(solver), where)
        loads = Loads(self.robot.model.nv, (*self.forces, *forces), self.actuators)
        try:
            return build_system(
                self.robot, self.couplings, self.constraints, loads, chosen.type, chosen.backend
            )
        except ModelError as error:
            raise SceneError(f"{where}: {error}") from error

    def controlled_joints(self) -> ControlledJoints:
        """The actuated joints as a controller sees them, with their own Pinocchio data.

        Raises:
            SceneError: No joint can be controlled, or one moves nothing with mass.
        """
        bilateral = [part for part in self.constraints if part.bounds is None]
        loads = Loads(self.robot.model.nv, self.forces)
        try:
            system = build_system(self.robot, self.couplings, bilateral, loads)
            check_mass_anywhere(system)
            return ControlledJoints(system, self.actuated)
        except (ModelError, SolveError) as error:
            raise SceneError(f"{self.name}: {error}") from error

    def simulation(
        self,
        *,
        integrator: Mapping[str, Any] | None = None,
        dt: float | None = None,
        stabilization: Mapping[str, Any] | None = None,
        solver: Mapping[str, str] | None = None,
        forces: Sequence[ForceTerm] = (),
    ) -> Simulation:
        """A simulation with its own Pinocchio data.

        Args:
            integrator: Entry that replaces that of the scene.
            dt: Step that replaces that of the scene [s].
            stabilization: Entry that replaces that of the scene.
            solver: Entry that replaces that of the scene.
            forces: Force terms besides those of the scene.

        Raises:
            SceneError: Names file and key.
        """
        system = self.system(forces, solver)
        method, correction = self.integrator, self.stabilization
        if integrator is not None or method is None:
            given = integrator or DEFAULT_INTEGRATOR
            method = build_part("integrators", given, f"{self.name}: integrator")
        if stabilization is not None or correction is None:
            given = stabilization or {"type": "projection" if system.rows else "none"}
            correction = build_part("stabilization", given, f"{self.name}: stabilization")
        try:
            return Simulation(system, method, correction, self.dt if dt is None else dt)
        except ModelError as error:
            raise SceneError(f"{self.name}: {error}") from error
