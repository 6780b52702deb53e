"""Phases by names -> a system a phase, with guards and resets."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.events.phase import PhaseGuards
from mbd_ros.core.events.phase_reset import Demand, PhaseReset
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.held_contact import HeldContact
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.phases.phase_exits import PhaseExits
from mbd_ros.scene.reading.phase_plans import GuardPlan, PhasePlan

if TYPE_CHECKING:
    from mbd_ros.scene.reading.part_entries import Solver
    from mbd_ros.scene.scene_parts import SceneParts

from collections.abc import Collection
from typing import TYPE_CHECKING

from mbd_ros.core.events.phase_reset import Relabelling
from mbd_ros.core.ranges import NotZero
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.scene.reading.phase_entries import known
from mbd_ros.scene.reading.phase_plans import ResetEntry
from mbd_ros.scene.schema import schema

if TYPE_CHECKING:
    from mbd_ros.scene.scene_parts import SceneParts


# Joints and internal states that change their names between two phases: exchanged legs.

Sources = dict[str, dict[str, float]]


def relabelling_of(scene: "SceneParts", entry: ResetEntry, where: str) -> Relabelling | None:
    """The relabelling of a reset; None where everything keeps its name.

    Args:
        scene: The scene.
        entry: The reset.
        where: File and key, for the messages.

    Raises:
        SceneError: A name that nothing has or that is given twice, a joint whose source is a
            state, or what cannot be told apart afterwards.
    """
    joints = {joint.name: joint for joint in scene.robot.joints}
    states = {name: i for i, name in enumerate(scene.internals.names) if name}
    sources = _sources(entry, (*joints, *states), where)
    shifts = entry.shift or {}
    chosen = list(dict.fromkeys([*sources, *shifts, *(n for s in sources.values() for n in s)]))
    if not chosen:
        return None
    own, inner = ([n for n in chosen if n in kind] for kind in (joints, states))
    for name, given in sources.items():
        if any((source in states) != (name in states) for source in given):
            raise SceneError(f"{where}: {name}: a joint and an internal state are not the same")
    A, B = _matrix(own, sources, where), _matrix(inner, sources, where)
    b = np.array([shifts.get(name, 0.0) for name in own])
    q, v = (np.array([getattr(joints[n], key) for n in own], dtype=np.intp) for key in "qv")
    return Relabelling(q, v, A, b, np.array([states[n] for n in inner], dtype=np.intp), B)


def _sources(entry: ResetEntry, names: Collection[str], where: str) -> Sources:
    """Name -> what it is made of, by factors."""
    sources = {name: dict(given) for name, given in (entry.relabel or {}).items()}
    for name, given in sources.items():
        for one in (name, *given):
            known(one, names, _WHAT, f"{where}.relabel.{name}")
    for name, swapped in (entry.exchange or {}).items():
        key = f"{where}.exchange.{name}"
        one = swapped if isinstance(swapped, Mapping) else {"joint": swapped}
        other, factor = schema.call(_swapped, one, key)
        for each in {known(name, names, _WHAT, key), known(other, names, _WHAT, key)}:
            if each in sources:
                raise SceneError(f"{key}: {each} is relabelled twice")
        sources[name] = {other: factor}
        sources[other] = {name: 1.0 / factor}
    return sources


def _matrix(names: Sequence[str], sources: Sources, where: str) -> Array:
    """What makes the values of all names of those before, shape (n, n)."""
    matrix = np.eye(len(names))
    for name in (name for name in names if name in sources):
        row = names.index(name)
        matrix[row] = 0.0
        for source, factor in sources[name].items():
            matrix[row, names.index(source)] = factor
    if not abs(np.linalg.det(matrix)) > TINY:
        raise SceneError(
            f"{where}: {', '.join(names)} cannot be told apart afterwards: each needs a source "
            "of its own"
        )
    return matrix


_WHAT = "joint or internal state"


def _swapped(joint: str, factor: NotZero = 1.0) -> tuple[str, float]:
    return joint, factor


def phased_system(scene: "SceneParts", loads: Loads, solver: "Solver") -> PhasedSystem:
    """The systems of all phases of a scene.

    Args:
        scene: A scene with a section `phases`.
        loads: Everything that acts on its joints.
        solver: How the equations are solved.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    return _Systems(scene, loads, solver).build()


class _Systems:
    """What all phases of a scene are made of."""

    def __init__(self, scene: "SceneParts", loads: Loads, solver: "Solver") -> None:
        self.scene, self.robot, self.loads, self.solver = scene, scene.robot, loads, solver
        self.plans: Mapping[str, PhasePlan] = scene.parts["phases"]
        self.contacts = {part.name: part for part in scene.parts.get("contacts", ())}
        self.exits = PhaseExits(self.robot, self.contacts)
        self.named = {name for plan in self.plans.values() for name in plan.contacts}
        self.named |= {
            name
            for plan in self.plans.values()
            for guard in plan.guards
            for name in (*(guard.reset.impact or ()), guard.entry.touch_down)
            if name is not None
        }
        dependent = [CouplingRows(self.robot, scene.couplings)] if scene.couplings.pairs else []
        self.layout = RowLayout([*dependent, *scene.constraints])
        self.slot = {row.name: i for i, row in enumerate(self.layout.rows)}
        self.held: dict[str, HeldContact] = {}

    def build(self) -> PhasedSystem:
        """The systems, in the order of the scene."""
        phases, systems = [], []
        for plan in self.plans.values():
            bare = self.system(plan, self.rows(plan, plan.contacts if plan.held else ()))
            at = {row.name: i for i, row in enumerate(bare.multiplier_rows)}
            following = [list(self.plans).index(guard.then) for guard in plan.guards]
            resets = [self.reset(plan, guard) for guard in plan.guards]
            phases.append(self.exits.phase(plan, at, following, resets))
        for plan, phase in zip(self.plans.values(), phases, strict=True):
            guards = PhaseGuards(plan.name, phase.exits, phase.checks)
            rows = self.rows(plan, plan.contacts if plan.held else ())
            systems.append(self.system(plan, rows, (guards,)))
        slots = [self.slots(system) for system in systems]
        wish = (self.scene.entries.get("initial") or {}).get("phase")
        first = 0 if wish is None else list(self.plans).index(wish)
        return PhasedSystem(phases, systems, self.layout, slots, first)

    def system(
        self, plan: PhasePlan, rows: Sequence[Constraint], guards: Sequence[PhaseGuards] = ()
    ) -> System:
        """The equations of motion under some rows."""
        off = self.named.difference(plan.contacts)
        forces = [force for force in self.loads.forces if force.name not in off]
        loads = self.loads.having(forces).watched_by(guards)
        try:
            return build_system(
                self.robot,
                self.couplings(plan),
                rows,
                loads,
                self.solver.tier,
                self.solver.backend,
            )
        except ModelError as error:
            raise SceneError(f"{plan.where}: {error}") from error

    def rows(
        self, plan: PhasePlan, held: Iterable[str], free: Iterable[str] = ()
    ) -> list[Constraint]:
        """Constraints of a phase, with some contacts held and others that may bounce."""
        held, free = set(held), set(free)
        if not plan.held:
            free |= set(plan.contacts) - held
        found: list[Constraint] = []
        for part in self.scene.constraints:
            name = part.name
            if name in held:
                found.append(self.hold(name, plan.where))
            elif self.contacts.get(name) is part:
                if name in free or name not in self.named:
                    found.append(part)
            elif plan.constraints is None or name in plan.constraints:
                found.append(part)
        return found

    def hold(self, name: str, where: str) -> HeldContact:
        """A contact that is held closed."""
        if name not in self.held:
            try:
                self.held[name] = HeldContact(self.robot, self.contacts[name])
            except ModelError as error:
                raise SceneError(f"{where}.contacts: {error}") from error
        return self.held[name]

    def couplings(self, plan: PhasePlan) -> Couplings:
        """The couplings that are on."""
        every = self.scene.couplings
        if plan.couplings is None or set(plan.couplings) == set(every.dependent):
            return every
        mimics = {mimic.joint for mimic in self.robot.mimics}
        off = [n for n in every.dependent if n not in plan.couplings and n in mimics]
        if off:
            raise SceneError(
                f"{plan.where}.couplings: {', '.join(off)} follows by <mimic> in every phase; "
                "accepted: a coupling of the section couplings"
            )
        pairs = zip(every.dependent, every.pairs, strict=True)
        kept = {
            name: Coupling(every.parents[name], pair.function)
            for name, pair in pairs
            if name in plan.couplings
        }
        return Couplings(self.robot, kept)

    def slots(self, system: System) -> Any:
        """Where the multipliers of a system stand among those of the scene."""
        return np.array([self.slot[row.name] for row in system.multiplier_rows], dtype=np.intp)

    def reset(self, plan: PhasePlan, guard: GuardPlan) -> PhaseReset:
        """What happens at once where a guard fires."""
        then, size = self.plans[guard.then], len(self.layout.rows)
        relabelling = relabelling_of(self.scene, guard.reset, f"{guard.where}.reset")
        struck = self.struck(guard, relabelling is not None)
        stay = set(then.contacts) if then.held else set[str]()
        if relabelling is not None:  # contacts go by their old names still
            stay = {name for name in struck if not self.contacts[name].law.restitution}
        is_struck = bool(struck)
        if guard.reset.impact is None:
            is_struck |= bool(self.holds(then, stay) - self.holds(plan, plan.contacts))
        if not is_struck:
            none = np.zeros(0, dtype=np.intp)
            return PhaseReset(size, None, none, (), relabelling)
        bounce = struck - stay
        system = self.system(then, self.rows(then, stay, bounce))
        touching = [
            i
            for cone in system.layout.cones
            if cone.name.partition(".")[0] in bounce
            for i in range(cone.slots.start, cone.slots.stop)
        ]
        at = {row.name: i for i, row in enumerate(system.multiplier_rows)}
        demands = [
            Demand(name, check.crossing, check.failure)
            for name in sorted(stay)
            for _, check in self.exits.checks(name, at)
        ]
        slots = self.slots(system)
        return PhaseReset(size, system, slots, tuple(touching), relabelling, demands)

    def struck(self, guard: GuardPlan, is_relabelled: bool) -> set[str]:
        """Contacts whose bodies hit each other where a guard fires, beside those held next.

        By default that of a guard `touch_down`, where joints are relabelled.
        """
        if guard.reset.impact is not None:
            return set(guard.reset.impact)
        name = guard.entry.touch_down
        is_rigid = name is not None and hasattr(self.contacts[name], "residual")
        return {name} if is_relabelled and is_rigid and name is not None else set()

    def holds(self, plan: PhasePlan, contacts: Iterable[str]) -> set[str]:
        """Names of everything that holds whatever force that takes in a phase."""
        held = set(contacts) if plan.held else set[str]()
        rigid = (part.name for part in self.rows(plan, held) if part.law.is_rigid)
        return {*rigid, *self.couplings(plan).dependent}
