"""A built scene: its entries, its parts, its robot, and the equations of motion they make.

A scene is a value. Whatever reads, changes, describes or runs one takes it as an argument and
stands above it: `reader`, `variants`, `describe`, `runs`; `api.Scene` has these as methods.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.core.contracts import Actuator, Load
from mbd_ros.core.dynamics.mass import check_mass_anywhere
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import TIERS, build_system
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.inputs import Inputs, Source, bound
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.qp_solvers import check_backend
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError, SceneError, SolveError
from mbd_ros.methods.control.contract import ControlledJoints
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics, ObservedLoops
from mbd_ros.methods.inverse_dynamics.efforts import joint_efforts
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics, SampleSolver
from mbd_ros.methods.inverse_dynamics.stance import StanceThresholds, find_root_joints
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.methods.simulation.safe_command import SafeCommand
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.phase_plans import PhasePlan
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.sections import Section, parts_in

if TYPE_CHECKING:
    from mbd_ros.core.contracts import Sensor
    from mbd_ros.core.muscles.muscle import Muscle

SOLVERS = (*TIERS, "plain", "compiled")
NO_SOURCES: Mapping[str, Source] = {}


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """The built parts of a scene, and the equations of motion that they make.

    Attributes:
        origin: The file, or what else its sections came from.
        robot: The robot, with the inertia of its drives.
        parts: The built sections, by key; the robot there is without its drives.
        entries: The sections of the file, by key.
        sections: Lines of the table, those of other packages included.
        code: Key -> `package.module:Class` of what was imported from outside this package.
        inputs: Inputs u of all parts.
        internals: Internal states z of all parts.
    """

    origin: Origin
    robot: Robot
    parts: Mapping[str, Any]
    entries: Mapping[str, Any]
    sections: tuple[Section, ...]
    code: Mapping[str, str]
    inputs: Inputs = field(init=False)
    internals: Internals = field(init=False)
    _initial_internals: Array = field(init=False)

    def __post_init__(self) -> None:
        parts, inputs = bind_inputs(self.sections, self.parts)
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "inputs", inputs)
        all_parts = (
            part
            for section in self.sections
            if section.key in parts
            for part in parts_in(section, parts[section.key])
        )
        with_states = [part for part in all_parts if getattr(part, "internal", ())]
        object.__setattr__(self, "internals", Internals(with_states))
        initial = self.entries.get("initial") or {}
        z = first_values(self.internals, initial.get("internal"), f"{self.name}: initial")
        object.__setattr__(self, "_initial_internals", z)

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
    def wrenches(self) -> "Mapping[str, MeasuredWrench]":
        """External loads by name."""
        return self.parts.get("external_wrenches", {})

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """Constraints besides the couplings, of all sections."""
        return self._offering("residual")

    @property
    def forces(self) -> tuple[Load, ...]:
        """Loads that nobody commands, of all sections."""
        return tuple(part for part in self._offering("force") if not part.is_actuator)

    @property
    def forces_without_input(self) -> tuple[Load, ...]:
        """Forces that take no input."""
        return tuple(force for force in self.forces if not force.inputs)

    @property
    def muscles(self) -> "tuple[Muscle, ...]":
        """Muscles, in the order of their excitations."""
        return self._offering("active_force")

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Actuators, in the order of their commands."""
        return self._offering("command")

    @property
    def sensors(self) -> "tuple[Sensor, ...]":
        """Sensors of all sections."""
        return self._offering("measure")

    @property
    def commanded(self) -> tuple[Actuator, ...]:
        """Actuators, then muscles: the parts whose inputs are commands."""
        return (*self.actuators, *self.muscles)

    @property
    def phases(self) -> Mapping[str, PhasePlan]:
        """Phases of the motion by name, empty where it has none."""
        return self.parts.get("phases", {})

    @property
    def stabilization(self) -> Stabilization | None:
        """Stabilization of the constraints; None leaves the choice to `build_simulation`."""
        return self.parts.get("stabilization")

    @property
    def solver(self) -> "Solver":
        """How the equations are solved."""
        solver: Solver = self.parts["solver"]
        return solver

    @property
    def integrator(self) -> Integrator | None:
        """Method; None leaves the choice to `build_simulation`."""
        return self.parts.get("integrator")

    @property
    def integrator_entry(self) -> Mapping[str, Any]:
        """The entry of the file, empty without one."""
        return self.entries.get("integrator", {})

    @property
    def dt(self) -> float:
        """Step [s]."""
        dt: float = self.parts["dt"]
        return dt

    @property
    def initial(self) -> State:
        """State of all joints at the start as the file gives it, NaN where z is left open."""
        initial: State = self.parts["initial"]
        return initial if len(initial.z) else initial._replace(z=self._initial_internals)

    @property
    def safe(self) -> SafeCommand:
        """The safe command of the actuators."""
        safe: SafeCommand = self.parts["safe"]
        return safe

    @property
    def absent(self) -> tuple[str, ...]:
        """Sections that the file leaves out; gravity acts without one."""
        keys = (section.key for section in self.sections if section.key != "gravity")
        return tuple(key for key in keys if not self.entries.get(key))

    @property
    def has_loops(self) -> bool:
        """Whether bilateral constraints act besides the couplings."""
        return any(part.law.is_rigid for part in self.constraints)

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Parts with states that no measured motion shows, besides actuators."""
        return tuple(part.name for part in (*self.forces, *self.constraints) if part.internal)

    @property
    def actuated(self) -> tuple[str, ...]:
        """Joints with an actuator; without any, all independent ones that no drive moves."""
        if self.actuators:
            return tuple(dict.fromkeys(name for part in self.actuators for name in part.joints))
        driven = {name for part in self.constraints for name in part.driven}
        return tuple(name for name in self.couplings.independent if name not in driven)

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
    def root_joints(self) -> tuple[str, ...]:
        """Joints that stand for a free base, where forces of contacts are unknown."""
        return find_root_joints(self.robot, self.actuated if self.actuators else None)

    def _offering(self, method: str) -> tuple[Any, ...]:
        """Parts of all sections whose parts have a method, in the order of the table."""
        return tuple(
            part
            for section in self.sections
            if method in " or ".join(section.offers).split(" or ") and section.key in self.parts
            for part in parts_in(section, self.parts[section.key])
            if hasattr(part, method)
        )

    def holding(self, **parts: Any) -> "Scene":
        """A copy that holds other built parts, from objects rather than entries.

        Args:
            **parts: By key of their section, such as `forces=(*scene.forces, part)`.
        """
        return replace(self, parts={**self.parts, **parts})

    def without(self, keys: Iterable[str]) -> "Scene":
        """A copy without what some sections built, and without first values of its states."""
        keys = [key for key in keys if key in self.parts]
        parts = {key: part for key, part in self.parts.items() if key not in keys}
        initial = self.entries.get("initial") or {}
        if not initial.get("internal"):
            return replace(self, parts=parts)
        built = [(s, self.parts[s.key]) for s in self.sections if s.key in keys]
        gone = {part.name for section, parts in built for part in parts_in(section, parts)}
        values = {n: z for n, z in initial["internal"].items() if n.partition(".")[0] not in gone}
        entries = {**self.entries, "initial": {**initial, "internal": values}}
        return replace(self, parts=parts, entries=entries)

    def system(
        self,
        forces: Sequence[Load] = (),
        solver: Mapping[str, str] | None = None,
        sources: Mapping[str, Source] = NO_SOURCES,
    ) -> System:
        """Forward dynamics with its own Pinocchio data.

        Args:
            forces: Force terms besides those of the scene.
            solver: Entry that replaces that of the scene.
            sources: Sources of inputs, by name of the part.

        Raises:
            SceneError: The tier cannot serve the scene, or a package is missing.
        """
        chosen = self.chosen_solver(solver)
        try:
            loads = self.system_loads(forces, sources)
            return build_system(
                self.robot, self.couplings, self.constraints, loads, chosen.tier, chosen.backend
            )
        except ModelError as error:
            raise SceneError(f"{self.name}: solver: {error}") from error

    def system_loads(self, forces: Sequence[Load], sources: Mapping[str, Source]) -> Loads:
        """Return everything that exerts forces on the joints; for the arguments see `system`."""
        every = (*self.forces, *forces, *self.wrenches.values())
        input_sources = self.inputs.sources(sources)
        return Loads(self.robot.model.nv, every, self.commanded, input_sources)

    def chosen_solver(self, entry: Mapping[str, str] | None) -> "Solver":
        """Return the solver of an entry, or that of the scene without an entry."""
        if entry is None:
            return self.solver
        solver: Solver = schema.call(Solver, dict(entry), f"{self.name}: solver")
        return solver

    def inverse_dynamics(
        self,
        *,
        with_bounds: bool = False,
        contacts: Collection[str] = (),
        thresholds: StanceThresholds | None = None,
    ) -> SampleSolver:
        """A solver with its own Pinocchio data, for the independent joints.

        Without loops and bounds it is an `InverseDynamics`, which takes many samples at once.

        Arguments are those of `closed_loop`.
        """
        self._refuse_internal("inverse dynamics")
        if self.has_loops or with_bounds or contacts:
            return ObservedLoops(
                self.closed_loop(with_bounds=with_bounds, contacts=contacts, thresholds=thresholds)
            )
        loads = tuple(self.wrenches.values())
        return InverseDynamics(self.robot, self.couplings, loads, self.forces_without_input)

    def closed_loop(
        self,
        *,
        with_bounds: bool = False,
        contacts: Collection[str] = (),
        thresholds: StanceThresholds | None = None,
    ) -> ClosedLoopInverseDynamics:
        """A solver for the efforts of `actuated` and all multipliers, with its own data.

        Args:
            with_bounds: Whether efforts keep the limits of their actuators, and stops, dry
                friction and limited drives exert at most what their law allows.
            contacts: Names of rigid contacts whose forces are unknown, see `unmeasured_contacts`;
                joints that stand for a free base exert nothing then.
            thresholds: Which contacts count as on the ground.

        Raises:
            SceneError: An actuated joint is unknown or repeated.
        """
        self._refuse_internal("inverse dynamics")
        loads = tuple(self.wrenches.values())
        try:
            limits, free = self._effort_limits(), self.root_joints if contacts else ()
            driven = {name: limits[name] for name in limits if name not in free}
            efforts = joint_efforts(self.robot, list(driven), list(driven.values()))
            return ClosedLoopInverseDynamics(
                self.robot,
                self.couplings,
                self.constraints,
                efforts,
                loads,
                self.forces_without_input,
                with_bounds=with_bounds,
                contacts=contacts,
                root_joints=free,
                thresholds=thresholds,
            )
        except ModelError as error:
            raise SceneError(f"{self.name}: {error}") from error

    def controlled_joints(self) -> ControlledJoints:
        """The actuated joints as a controller sees them, with their own Pinocchio data.

        Raises:
            SceneError: No joint can be controlled, or one moves nothing with mass.
        """
        self._refuse_internal("a controller")
        if self.muscles:
            raise SceneError(
                f"{self.name}: a controller drives actuators but no muscles; leave the muscles out"
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
                f"{self.name}: {who} cannot know the internal states of {parts}; leave it out"
            )

    def _effort_limits(self) -> dict[str, float]:
        """Largest effort of each of `actuated` [N·m or N], inf without actuators."""
        limits = dict.fromkeys(self.actuated, 0.0 if self.actuators else math.inf)
        for actuator in self.actuators:
            for name, limit in zip(actuator.joints, actuator.limits().tolist(), strict=True):
                limits[name] += limit
        return limits


@dataclass(frozen=True)
class Solver:
    """The `solver` section.

    Attributes:
        type: A tier of `mbd_ros.core.dynamics.tiers`; or the cheapest one that serves, and how
            its steps run: `plain`, `compiled`, or `auto`, compiled where they can be.
        backend: Solver of the QP: proxqp, or one that qpsolvers knows.
    """

    type: str = "plain"
    backend: str = "proxqp"

    def __post_init__(self) -> None:
        if self.type not in SOLVERS:
            raise ModelError(f"unknown solver type '{self.type}', accepted: {', '.join(SOLVERS)}")
        check_backend(self.backend)

    @property
    def tier(self) -> str:
        """The tier that is asked for; `auto` for the cheapest one that serves."""
        return self.type if self.type in TIERS else "auto"

    @property
    def compiles(self) -> bool:
        """Whether steps are compiled where they can be."""
        return self.type in ("auto", "compiled")

    @property
    def must_compile(self) -> bool:
        """Whether it is an error where they cannot be."""
        return self.type == "compiled"


class MeasuredWrench(ExternalWrench):
    """An external load and the topic that carries it; None stands for `~/wrench/<name>`."""

    topic: str | None = None

    @property
    def heard_on(self) -> str:
        """The topic that carries it."""
        return self.topic or f"~/wrench/{self.name}"


def bind_inputs(
    sections: Sequence[Section], parts: Mapping[str, Any]
) -> tuple[dict[str, Any], Inputs]:
    """Built sections whose parts know where their inputs and states stand, and all inputs.

    Actuators come first, in their order, then the others in the order of the table.

    Args:
        parts: Built sections by key.
    """
    built = [(s, parts[s.key]) for s in sections if s.key in parts]
    every = [part for section, section_parts in built for part in parts_in(section, section_parts)]
    takers = [p for p in every if getattr(p, "inputs", ()) or getattr(p, "internal", ())]
    takers.sort(key=lambda part: not part.is_actuator)  # stable
    after, inputs = bound(takers)
    swapped = {id(a): b for a, b in zip(takers, after, strict=True) if a is not b}
    if not swapped:
        return dict(parts), inputs
    return {key: _replaced(section_parts, swapped) for key, section_parts in parts.items()}, inputs


def first_values(internals: Internals, values: Any, where: str) -> Array:
    """Internal states at the start, NaN where nothing is given, shape (nz,).

    Args:
        internals: Of the scene.
        values: Values by name, `<part>.<name>: 0.1` or `<part>: {<name>: 0.1}`; None for none.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    z = np.full(internals.nz, np.nan)
    for name, value in _flat(values or {}):
        if name not in internals.names:
            accepted = ", ".join(internals.names) or "none, no part has internal states"
            raise SceneError(f"{where}.internal: unknown '{name}', accepted: {accepted}")
        z[internals.names.index(name)] = schema.value(value, float, f"{where}.internal.{name}")
    try:
        internals.completed(z)
    except ModelError as error:
        raise SceneError(f"{where}.internal: {error}") from error
    return z


def _flat(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names with dots, and values."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{rest}", one) for rest, one in _flat(value))
        else:
            yield name, value


def _replaced(built: Any, swapped: Mapping[int, Any]) -> Any:
    if type(built) in (tuple, list):
        return tuple(swapped.get(id(part), part) for part in built)
    if isinstance(built, dict):
        return {name: swapped.get(id(part), part) for name, part in built.items()}
    return swapped.get(id(built), built)
