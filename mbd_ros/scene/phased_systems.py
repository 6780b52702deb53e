"""Phases by names -> a system a phase, with guards and resets.

A guard is a number whose zero ends a phase; a contact that is held may neither pull, slip nor tip.
A reset is an impact, and a relabelling of joints and internal states that change their names
between two phases, such as exchanged legs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.inputs import Source
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotZero
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.constraint_rows import CouplingRows, RowLayout
from mbd_ros.core.rows.frame_rows import HeldContact
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.events.crossings import (
    Combination,
    Condition,
    ConeRoom,
    Crossing,
    Footing,
    Force,
    Gap,
)
from mbd_ros.methods.events.phases import (
    Check,
    Demand,
    Exit,
    Phase,
    PhaseGuards,
    PhaseReset,
    Relabelling,
)
from mbd_ros.scene.built_scene import NO_SOURCES, Scene, Solver
from mbd_ros.scene.phase_plans import GuardPlan, PhasePlan, ResetEntry
from mbd_ros.scene.reading.phase_entries import known
from mbd_ros.scene.schema import schema

_WHAT = "joint or internal state"
_WAYS = {"up": 1, "down": -1, "both": 0}
Sources = dict[str, dict[str, float]]  # name -> what it is made of, by factors
_DOWN = ("touch_down", "lift_off", "slip", "tip")  # act so, unless an entry says it


def build_phased_system(
    scene: Scene,
    forces: Sequence[Load] = (),
    solver: Mapping[str, str] | None = None,
    sources: Mapping[str, Source] = NO_SOURCES,
) -> PhasedSystem:
    """The systems of all phases of a scene, behind one.

    Args:
        scene: A scene with a section `phases`.
        forces: Force terms besides those of the scene.
        solver: Entry that replaces that of the scene.
        sources: What gives the inputs of parts, by name of the part.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    loads = scene.system_loads(forces, sources)
    return _Systems(scene, loads, scene.chosen_solver(solver)).build()


class _Systems:
    """Systems of all phases of a scene; phases share contacts and rows."""

    def __init__(self, scene: Scene, loads: Loads, solver: Solver) -> None:
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
        self.closed_contacts: dict[str, HeldContact] = {}

    def build(self) -> PhasedSystem:
        """The systems, in the order of the scene."""
        phases, systems = [], []
        for plan in self.plans.values():
            bare = self.system(plan, self.rows(plan, plan.contacts if plan.keeps_closed else ()))
            at = {row.name: i for i, row in enumerate(bare.multiplier_rows)}
            following = [list(self.plans).index(guard.then) for guard in plan.guards]
            resets = [self.reset(plan, guard) for guard in plan.guards]
            phases.append(self.exits.phase(plan, at, following, resets))
        for plan, phase in zip(self.plans.values(), phases, strict=True):
            guards = PhaseGuards(plan.name, phase.exits, phase.checks)
            rows = self.rows(plan, plan.contacts if plan.keeps_closed else ())
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
        self, plan: PhasePlan, closed: Iterable[str], free: Iterable[str] = ()
    ) -> list[Constraint]:
        """Constraints of a phase, with some contacts held and others that may bounce."""
        closed, free = set(closed), set(free)
        if not plan.keeps_closed:
            free |= set(plan.contacts) - closed
        constraints: list[Constraint] = []
        for part in self.scene.constraints:
            name = part.name
            if name in closed:
                constraints.append(self.hold(name, plan.where))
            elif self.contacts.get(name) is part:
                if name in free or name not in self.named:
                    constraints.append(part)
            elif plan.constraints is None or name in plan.constraints:
                constraints.append(part)
        return constraints

    def hold(self, name: str, where: str) -> HeldContact:
        """A contact that is held closed."""
        if name not in self.closed_contacts:
            try:
                self.closed_contacts[name] = HeldContact(self.robot, self.contacts[name])
            except ModelError as error:
                raise SceneError(f"{where}.contacts: {error}") from error
        return self.closed_contacts[name]

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
        continuing = {
            name: Coupling(every.parents[name], pair.function)
            for name, pair in pairs
            if name in plan.couplings
        }
        return Couplings(self.robot, continuing)

    def slots(self, system: System) -> Any:
        """Where the multipliers of a system stand among those of the scene."""
        return np.array([self.slot[row.name] for row in system.multiplier_rows], dtype=np.intp)

    def reset(self, plan: PhasePlan, guard: GuardPlan) -> PhaseReset:
        """Return the instantaneous change where a guard fires."""
        then, size = self.plans[guard.then], len(self.layout.rows)
        relabelling = relabelling_of(self.scene, guard.reset, f"{guard.where}.reset")
        struck = self.struck(guard, relabelling is not None)
        stay = set(then.contacts) if then.keeps_closed else set[str]()
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
        is_rigid = name is not None and self.contacts[name].is_constraint
        return {name} if is_relabelled and is_rigid and name is not None else set()

    def holds(self, plan: PhasePlan, contacts: Iterable[str]) -> set[str]:
        """Names of everything that holds whatever force that takes in a phase."""
        closed = set(contacts) if plan.keeps_closed else set[str]()
        rigid = (part.name for part in self.rows(plan, closed) if part.law.is_rigid)
        return {*rigid, *self.couplings(plan).dependent}


class PhaseExits:
    """Guards that end the phases of a scene, and conditions that hold during them.

    Args:
        contacts: All contacts by name.
    """

    def __init__(self, robot: Robot, contacts: Mapping[str, Any]) -> None:
        self._robot, self._contacts = robot, contacts

    def phase(
        self,
        plan: PhasePlan,
        at: Mapping[str, int],
        following: Sequence[int],
        resets: Sequence[PhaseReset],
    ) -> Phase:
        """A phase.

        Args:
            at: Where its multipliers stand, by name.
            following: Number of the next phase, one a guard.
            resets: What happens at once, one a guard.

        Raises:
            SceneError: A guard looks at a multiplier that the phase does not have.
        """
        given = zip(plan.guards, following, resets, strict=True)
        exits = tuple(self._exit(plan, guard, at, then, reset) for guard, then, reset in given)
        looked_at = {(g.entry.lift_off, "pulls") for g in plan.guards}
        looked_at |= {(g.entry.slip, "slips") for g in plan.guards}
        looked_at |= {(g.entry.tip, "tips") for g in plan.guards}
        closed = plan.contacts if plan.keeps_closed else ()
        every = [(name, *checked) for name in closed for checked in self.checks(name, at)]
        demands = tuple(check for _, _, check in every)
        checks = tuple(check for name, word, check in every if (name, word) not in looked_at)
        limit = float("inf") if plan.limit is None else plan.limit
        return Phase(plan.name, exits, checks, demands, limit)

    def checks(self, name: str, at: Mapping[str, int]) -> list[tuple[str, Check]]:
        """Return the conditions that a closed contact must meet: it neither lifts nor slips."""
        pulls = Check(
            f"{name}_pulls",
            name,
            self._normal(name, at),
            f"contact {name} is held and would pull; accepted: a guard lift_off: {name}, or "
            "held: false",
        )
        slips = Check(
            f"{name}_slips",
            name,
            self._room(name, at),
            f"contact {name} is held and would slip, friction {self._friction(name):g} is too "
            f"small; accepted: a guard slip: {name}, more friction, or held: false",
        )
        if len(self._along(name, at, 0)) < 2:
            return [("pulls", pulls), ("slips", slips)]
        tips = Check(
            f"{name}_tips",
            name,
            Footing(self._contacts[name], self._along(name, at, 0)),
            f"contact {name} is held and would tip about an edge of its points; accepted: a "
            f"guard tip: {name}, or held: false",
        )
        return [("pulls", pulls), ("slips", slips), ("tips", tips)]

    def _exit(
        self,
        plan: PhasePlan,
        guard: GuardPlan,
        at: Mapping[str, int],
        then: int,
        reset: PhaseReset,
    ) -> Exit:
        """A way out of a phase."""
        entry = guard.entry
        usual = "down" if any(getattr(entry, key) is not None for key in _DOWN) else "both"
        condition = None
        if guard.when is not None:
            above = guard.when.above
            level = guard.when.below if above is None else above
            assert level is not None
            condition = Condition(self._sum_of(guard.when, level), above is not None)
        crossing = None if entry.time is not None else self._crossing(plan, guard, at)
        way = _WAYS[entry.direction or usual]
        return Exit(guard.name, crossing, way, condition, entry.time, then, reset)

    def _crossing(self, plan: PhasePlan, guard: GuardPlan, at: Mapping[str, int]) -> Crossing:
        """The number whose zero ends a phase."""
        entry = guard.entry
        if entry.touch_down is not None:
            return Gap(self._contacts[entry.touch_down])
        if entry.lift_off is not None:
            return self._normal(entry.lift_off, at)
        if entry.slip is not None:
            return self._room(entry.slip, at)
        if entry.tip is not None:
            return Footing(self._contacts[entry.tip], self._along(entry.tip, at, 0))
        if entry.force is not None:
            return self._normal(entry.force, at, entry.at)
        if entry.multiplier is not None:
            if entry.multiplier not in at:
                there = ", ".join(at) or "none"
                raise SceneError(
                    f"{guard.where}.multiplier: phase {plan.name} has no multiplier "
                    f"'{entry.multiplier}', there are: {there}"
                )
            return Force([at[entry.multiplier]], entry.at)
        return self._sum_of(entry, entry.at)

    def _sum_of(self, entry: Any, level: float) -> Combination:
        """A sum of joint positions times factors, less a level."""
        factors = {entry.joint: 1.0} if entry.joint is not None else dict(entry.joints)
        q = np.array([self._robot.joint(name).q for name in factors], dtype=np.intp)
        return Combination(q, np.array(list(factors.values()), dtype=np.float64), level)

    def _friction(self, name: str) -> float:
        """Smallest coefficient of friction of a contact."""
        return float(np.min(self._contacts[name].law.mu))

    def _normal(self, name: str, at: Mapping[str, int], level: float = 0.0) -> Force:
        """Force along the normals of a contact that is held."""
        return Force(self._along(name, at, 0), level)

    def _along(self, name: str, at: Mapping[str, int], axis: int) -> list[int]:
        """Slots of a contact along its normals (0) or tangents (1, 2), those that exist."""
        rows = [f"{name}.{row.name}" for row in self._contacts[name].rows[axis::3]]
        return [at[row] for row in rows if row in at]

    def _room(self, name: str, at: Mapping[str, int]) -> ConeRoom:
        """Return the margin to the friction cone of a closed contact."""
        tangents = self._along(name, at, 1), self._along(name, at, 2)
        return ConeRoom(self._friction(name), self._along(name, at, 0), tangents)


def relabelling_of(scene: Scene, entry: ResetEntry, where: str) -> Relabelling | None:
    """The relabelling of a reset; None where everything keeps its name.

    Args:
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
    joint_names, inner = ([n for n in chosen if n in kind] for kind in (joints, states))
    for name, given in sources.items():
        if any((source in states) != (name in states) for source in given):
            raise SceneError(f"{where}: {name}: a joint and an internal state are not the same")
    A, B = _matrix(joint_names, sources, where), _matrix(inner, sources, where)
    b = np.array([shifts.get(name, 0.0) for name in joint_names])
    q, v = (
        np.array([getattr(joints[n], key) for n in joint_names], dtype=np.intp) for key in "qv"
    )
    return Relabelling(q, v, A, b, np.array([states[n] for n in inner], dtype=np.intp), B)


def _sources(entry: ResetEntry, names: Collection[str], where: str) -> Sources:
    """Name -> what it is made of, by factors."""
    sources = {name: dict(given) for name, given in (entry.relabel or {}).items()}
    for name, given in sources.items():
        for source in (name, *given):
            known(source, names, _WHAT, f"{where}.relabel.{name}")
    for name, swapped in (entry.exchange or {}).items():
        key = f"{where}.exchange.{name}"
        source = swapped if isinstance(swapped, Mapping) else {"joint": swapped}
        other, factor = schema.call(_swapped, source, key)
        for each in {known(name, names, _WHAT, key), known(other, names, _WHAT, key)}:
            if each in sources:
                raise SceneError(f"{key}: {each} is relabelled twice")
        sources[name] = {other: factor}
        sources[other] = {name: 1.0 / factor}
    return sources


def _swapped(joint: str, factor: NotZero = 1.0) -> tuple[str, float]:
    return joint, factor


def _matrix(names: Sequence[str], sources: Sources, where: str) -> Array:
    """Return the matrix that maps old values to new ones, shape (n, n)."""
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
