"""Scene file -> parts. An absent section is an absent feature: not built, not imported."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbd_ros import schema
from mbd_ros.core.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.control import ControlledJoints
from mbd_ros.core.couplings import Couplings
from mbd_ros.core.inverse_dynamics import InverseDynamics
from mbd_ros.core.loads import Loads
from mbd_ros.core.observed_loops import ObservedLoops
from mbd_ros.core.parts import Actuator, Constraint, ForceTerm
from mbd_ros.core.robot import Robot
from mbd_ros.core.safe_command import SafeCommand
from mbd_ros.core.simulation import Simulation
from mbd_ros.core.stabilizing import Stabilization
from mbd_ros.core.state import State
from mbd_ros.core.stepping import Integrator
from mbd_ros.core.system import System
from mbd_ros.core.tiers import build_system
from mbd_ros.coupling_entries import coupling_laws
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.locate import find_file
from mbd_ros.part_entries import (
    MeasuredWrench,
    Solver,
    build_part,
    build_parts,
    build_wrenches,
    initial_state,
)
from mbd_ros.robot_entry import build_robot, read_entry
from mbd_ros.strict_yaml import read_mapping

SECTIONS = (
    "robot",
    "couplings",
    "external_wrenches",
    "constraints",
    "forces",
    "actuators",
    "stabilization",
    "solver",
    "integrator",
    "dt",
    "initial",
    "safe",
)
DEFAULT_INTEGRATOR = {"type": "dopri5"}
DEFAULT_STABLE = 1.3  # its `stable`, known without importing it
DEFAULT_DT = 1.0e-3  # s


@dataclass(frozen=True)
class Scene:
    """What a scene file describes, built.

    Attributes:
        path: The file.
        source: File or topic of the robot description.
        robot: The robot, with the inertia of its drives.
        couplings: Its dependent joints.
        laws: Dependent joint -> parent and kind of law, for people.
        wrenches: External loads by name.
        constraints: Constraints besides the couplings.
        forces: Force terms.
        actuators: Actuators, in the order of their commands.
        stabilization: What keeps the constraints; None leaves the choice to `simulation`.
        solver: How the equations are solved.
        integrator: Method; None leaves the choice to `simulation`.
        dt: Step [s].
        initial: State of all joints at the start, as the file gives it.
        safe: What the actuators do without a command.
        absent: Sections that the file leaves out.
    """

    path: Path
    source: str
    robot: Robot
    couplings: Couplings
    laws: Mapping[str, str]
    wrenches: Mapping[str, MeasuredWrench]
    constraints: tuple[Constraint, ...]
    forces: tuple[ForceTerm, ...]
    actuators: tuple[Actuator, ...]
    stabilization: Stabilization | None
    solver: Solver
    integrator: Integrator | None
    dt: float
    initial: State
    safe: SafeCommand
    absent: tuple[str, ...]

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
            SceneError: Joints move nothing with mass.
        """
        loads = [wrench.load for wrench in self.wrenches.values()]
        try:
            return ClosedLoopInverseDynamics(
                self.robot, self.couplings, self.constraints, self.actuated, loads, self.forces
            )
        except ModelError as error:
            raise SceneError(f"{self.path}: {error}") from error

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
        where = f"{self.path}: solver"
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
            SceneError: No joint can be controlled.
        """
        bilateral = [part for part in self.constraints if part.bounds is None]
        loads = Loads(self.robot.model.nv, self.forces)
        try:
            system = build_system(self.robot, self.couplings, bilateral, loads)
            return ControlledJoints(system, self.actuated)
        except ModelError as error:
            raise SceneError(f"{self.path}: {error}") from error

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
            method = build_part("integrators", given, f"{self.path}: integrator")
        if stabilization is not None or correction is None:
            given = stabilization or {"type": "projection" if system.rows else "none"}
            correction = build_part("stabilization", given, f"{self.path}: stabilization")
        try:
            return Simulation(system, method, correction, self.dt if dt is None else dt)
        except ModelError as error:
            raise SceneError(f"{self.path}: {error}") from error


def load_scene(path: str | Path, description: str | None = None) -> Scene:
    """Read and build a scene.

    Args:
        path: Scene file, or `package://<package>/<path>`.
        description: URDF that arrived on the `description_topic` of the scene.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    path = find_file(Path(), str(path), "scene")
    given = _read_sections(path)
    robot, source = build_robot(path, read_entry(path, given["robot"]), description)
    couplings, laws = _build_couplings(path, robot, given.get("couplings", {}))
    actuators = build_parts(path, "actuators", robot, given.get("actuators", []))
    robot = _with_armature(robot, actuators)
    return Scene(
        path=path,
        source=source,
        robot=robot,
        couplings=couplings,
        laws=laws,
        wrenches=build_wrenches(path, robot, given.get("external_wrenches", {})),
        constraints=build_parts(path, "constraints", robot, given.get("constraints", [])),
        forces=build_parts(path, "forces", robot, given.get("forces", [])),
        actuators=actuators,
        stabilization=_single(path, "stabilization", "stabilization", given),
        solver=schema.call(Solver, given.get("solver", {}), f"{path}: solver"),
        integrator=_single(path, "integrator", "integrators", given),
        dt=_step(path, given.get("dt", DEFAULT_DT)),
        initial=initial_state(path, robot, couplings, given.get("initial", {})),
        safe=schema.call(SafeCommand, given.get("safe", {}), f"{path}: safe"),
        absent=tuple(section for section in SECTIONS if not given.get(section)),
    )


def description_topic(path: str | Path) -> str | None:
    """Topic from which the scene takes its robot description; None where it names a file.

    Raises:
        SceneError: The file cannot be read, or its robot section is wrong.
    """
    path = find_file(Path(), str(path), "scene")
    return read_entry(path, _read_sections(path)["robot"]).description_topic


def _read_sections(path: Path) -> dict[str, Any]:
    sections = read_mapping(path)
    for key in sections:
        if key not in SECTIONS:
            raise SceneError(f"{path}: unknown key '{key}', accepted: {', '.join(SECTIONS)}")
    if "robot" not in sections:
        raise SceneError(f"{path}: key 'robot' is missing")
    return {
        key: section for key, section in sections.items() if section is not None or key == "robot"
    }


def _build_couplings(
    path: Path, robot: Robot, section: Any
) -> tuple[Couplings, Mapping[str, str]]:
    laws = coupling_laws(path, section)
    try:
        couplings = Couplings(robot, {name: coupling for name, (coupling, _) in laws.items()})
    except ModelError as error:
        raise SceneError(f"{path}: couplings: {error}") from error
    kinds = {m.joint: "URDF mimic" for m in robot.mimics} | {n: k for n, (_, k) in laws.items()}
    return couplings, {n: f"{couplings.parents[n]} ({kinds[n]})" for n in couplings.dependent}


def _single(path: Path, key: str, section: str, given: Mapping[str, Any]) -> Any:
    return build_part(section, given[key], f"{path}: {key}") if key in given else None


def _step(path: Path, given: Any) -> float:
    dt: float = schema.value(given, float, f"{path}: dt")
    if not dt > 0:
        raise SceneError(f"{path}: dt: {dt:g} s must be > 0")
    return dt


def _with_armature(robot: Robot, actuators: Sequence[Actuator]) -> Robot:
    """The robot with the inertia that its drives add to the joints."""
    added = sum(actuator.armature() for actuator in actuators)
    if not actuators or not added.any():
        return robot
    model = robot.model.copy()
    model.armature = model.armature + added
    return replace(robot, model=model)
