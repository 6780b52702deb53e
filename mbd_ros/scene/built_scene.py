"""A built scene, and the systems and simulations that it makes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.inputs import Source
from mbd_ros.core.loads.loads import Loads
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.reading.building import parts_in
from mbd_ros.scene.reading.part_entries import Solver, build_part
from mbd_ros.scene.schema import schema

if TYPE_CHECKING:
    from mbd_ros.core.dynamics.phased_system import PhasedSystem
    from mbd_ros.scene.runs.batch import Batch

import math
from collections.abc import Collection

from mbd_ros.core.dynamics.mass import check_mass_anywhere
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.errors import SolveError
from mbd_ros.methods.control.contract import ControlledJoints
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics, ObservedLoops
from mbd_ros.methods.inverse_dynamics.efforts import joint_efforts
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics, SampleSolver
from mbd_ros.methods.inverse_dynamics.standing import Nearness, carriers
from mbd_ros.scene.scene_parts import SceneParts

# What a scene makes for motion that is measured: solvers for efforts, and joints to control.


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


DEFAULT_INTEGRATOR = {"type": "dopri5"}
DEFAULT_STABLE = 1.3  # its `stable`, known without importing it
_TIME_STEPPING = {"type": "moreau_jean"}
_ADAPTIVE = {"type": "dopri5", "tolerance": 1.0e-8}  # fibres beside a tendon are stiff
Tell = Callable[[str], None]
_NO_SOURCES: Mapping[str, Source] = {}


class Scene(MeasuredScene):
    """A built scene, which makes systems, solvers and simulations."""

    def with_(self, numbers: Mapping[str, Any] | None = None, /, **sections: Any) -> "Scene":
        """The scene with other sections and other numbers, built as far as they change it.

        Args:
            numbers: Numbers by `<name of a part>.<argument>`, such as
                `ankle_joint_spring.stiffness`; lists of numbers too. A section of one entry, such
                as `integrator` or `initial`, goes by its key.
            **sections: As `scene_from` takes them; None removes a section.

        Raises:
            SceneError: Names key, what is wrong and what is accepted.
        """
        from mbd_ros.scene.from_python import with_sections
        from mbd_ros.scene.numbers import with_numbers

        scene = with_sections(self, sections) if sections or not numbers else self
        return with_numbers(scene, numbers) if numbers else scene

    def with_inertias(self, inertias: Mapping[str, Any]) -> "Scene":
        """The scene with other inertias of some links.

        `core.model.robot_reader.with_inertias` describes the argument.

        Raises:
            SceneError: Names link, value and condition.
        """
        from mbd_ros.scene.from_python import with_inertias

        return with_inertias(self, inertias)

    def check(self) -> str:
        """The lines of `mbd-ros check`: parts that are built and left out, and the cost of a call.

        Raises:
            MbdError: The scene has no consistent start.
        """
        from mbd_ros.scene.describe.check import describe

        return "\n".join(describe(self))

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
        gone = {part.name for section, given in built for part in parts_in(section, given)}
        values = {n: z for n, z in initial["internal"].items() if n.partition(".")[0] not in gone}
        entries = {**self.entries, "initial": {**initial, "internal": values}}
        return replace(self, parts=parts, entries=entries)

    def system(
        self,
        forces: Sequence[Load] = (),
        solver: Mapping[str, str] | None = None,
        sources: Mapping[str, Source] = _NO_SOURCES,
    ) -> System:
        """Forward dynamics with its own Pinocchio data.

        Args:
            forces: Force terms besides those of the scene.
            solver: Entry that replaces that of the scene.
            sources: What gives the inputs of parts, by name of the part.

        Raises:
            SceneError: The tier cannot serve the scene, or a package is missing.
        """
        where = f"{self.name}: solver"
        chosen = self.chosen_solver(solver)
        try:
            loads = self._loads(forces, sources)
            return build_system(
                self.robot, self.couplings, self.constraints, loads, chosen.tier, chosen.backend
            )
        except ModelError as error:
            raise SceneError(f"{where}: {error}") from error

    def phased_system(
        self,
        forces: Sequence[Load] = (),
        solver: Mapping[str, str] | None = None,
        sources: Mapping[str, Source] = _NO_SOURCES,
    ) -> "PhasedSystem":
        """The systems of all phases, behind one; arguments and errors as for `system`."""
        from mbd_ros.scene.phased_systems import phased_system

        return phased_system(self, self._loads(forces, sources), self.chosen_solver(solver))

    def _loads(self, forces: Sequence[Load], sources: Mapping[str, Source]) -> Loads:
        every = (*self.forces, *forces, *self.wrenches.values())
        given = self.inputs.sources(sources)
        return Loads(self.robot.model.nv, every, self.commanded, given)

    def chosen_solver(self, entry: Mapping[str, str] | None) -> Solver:
        """The solver of an entry; without one that of the scene."""
        if entry is None:
            return self.solver
        solver: Solver = schema.call(Solver, dict(entry), f"{self.name}: solver")
        return solver

    def batch(self, count: int, **options: Any) -> "Batch":
        """Many runs side by side, from other starts and with other numbers.

        Args:
            count: How many.
            **options: As for `Batch`.

        Raises:
            SceneError: Names what is wrong and what is accepted.
        """
        from mbd_ros.scene.runs.batch import Batch

        return Batch(self, count, **options)

    @property
    def default_integrator(self) -> Mapping[str, Any]:
        """Entry of the method where the file names none.

        No events where gaps are not smooth; adaptive steps beside elastic tendons.
        """
        pairs = (part.pair for part in self.constraints if hasattr(part, "pair"))
        if not all(p.is_smooth for p in pairs):
            return _TIME_STEPPING
        return _ADAPTIVE if any(part.is_elastic for part in self.muscles) else DEFAULT_INTEGRATOR

    @property
    def method(self) -> Integrator:
        """The integrator of the file, or that of `default_integrator`."""
        if self.integrator is not None:
            return self.integrator
        method: Integrator = build_part("integrators", self.default_integrator, self.name)
        return method

    def simulation(
        self,
        *,
        integrator: Mapping[str, Any] | None = None,
        dt: float | None = None,
        stabilization: Mapping[str, Any] | None = None,
        solver: Mapping[str, str] | None = None,
        forces: Sequence[Load] = (),
        sources: Mapping[str, Source] = _NO_SOURCES,
        tell: Tell | None = None,
    ) -> Simulation:
        """A simulation with its own Pinocchio data.

        Args:
            integrator: Entry that replaces that of the scene.
            dt: Step that replaces that of the scene [s].
            stabilization: Entry that replaces that of the scene.
            solver: Entry that replaces that of the scene.
            forces: Force terms besides those of the scene.
            sources: What gives the inputs of parts, by name of the part.
            tell: Is told what takes time while steps are compiled.

        Raises:
            SceneError: Names file and key.
        """
        build = self.phased_system if self.phases else self.system
        system: System = build(forces, solver, sources)
        correction = self.stabilization
        if integrator is None:
            method = self.method
        else:
            method = build_part("integrators", integrator, f"{self.name}: integrator")
        if stabilization is not None or correction is None:
            has_rows = bool(self.phases) or bool(system.held.rows)
            given = stabilization or {"type": "projection" if has_rows else "none"}
            correction = build_part("stabilization", given, f"{self.name}: stabilization")
        try:
            parts = system, method, correction, self.dt if dt is None else dt
            chosen = self.chosen_solver(solver)
            if self.phases and chosen.must_compile:
                raise ModelError("solver: compiled does not serve phases; accepted: plain, auto")
            if self.phases or not chosen.compiles:
                simulation = Simulation(*parts)
                if chosen.compiles:
                    simulation.how = "not compiled: phases change what holds"
                return simulation
            from mbd_ros.scene.runs.compiling import compiled_simulation, kept_for

            kept = None if forces else kept_for(self, chosen.backend)
            wish = {"start": self.initial, "is_demanded": chosen.must_compile}
            return compiled_simulation(*parts, tell=tell, kept=kept, **wish)
        except ModelError as error:
            raise SceneError(f"{self.name}: {error}") from error
