"""Phases by names -> a system a phase, with guards and resets."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.events.crossings import (
    Combination,
    Condition,
    ConeRoom,
    Crossing,
    Force,
    Gap,
)
from mbd_ros.core.events.phase import Check, Exit, Phase, PhaseGuards
from mbd_ros.core.events.phase_reset import PhaseReset
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.held_contact import HeldContact
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.phase_entries import GuardPlan, PhasePlan
from mbd_ros.scene.relabelling import relabelling_of

if TYPE_CHECKING:
    from mbd_ros.scene.part_entries import Solver
    from mbd_ros.scene.scene_parts import SceneParts

_WAYS = {"up": 1, "down": -1, "both": 0}
_DOWN = ("touch_down", "lift_off", "slip")  # guards that act so unless an entry says otherwise


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
            phases.append(self.phase(plan, bare.layout))
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

    def phase(self, plan: PhasePlan, layout: RowLayout) -> Phase:
        """What ends a phase, by the multipliers of its system."""
        at = {row.name: i for i, row in enumerate(layout.rows)}
        exits = tuple(self.exit(plan, guard, at) for guard in plan.guards)
        checks = [] if not plan.held else [c for n in plan.contacts for c in self.checks(n, at)]
        looked_at = {(g.entry.lift_off, "pulls") for g in plan.guards}
        looked_at |= {(g.entry.slip, "slips") for g in plan.guards}
        kept = tuple(one for contact, word, one in checks if (contact, word) not in looked_at)
        limit = float("inf") if plan.limit is None else plan.limit
        return Phase(plan.name, exits, kept, limit)

    def checks(self, name: str, at: Mapping[str, int]) -> list[tuple[str, str, Check]]:
        """What a contact that is held may not do."""
        pulls = Check(
            f"{name}_pulls",
            self.normal(name, at),
            f"contact {name} is held and would pull; accepted: a guard lift_off: {name}, or "
            "held: false",
        )
        slips = Check(
            f"{name}_slips",
            self.room(name, at),
            f"contact {name} is held and would slip, friction {self.friction(name):g} is too "
            f"small; accepted: a guard slip: {name}, more friction, or held: false",
        )
        return [(name, "pulls", pulls), (name, "slips", slips)]

    def friction(self, name: str) -> float:
        """Smallest coefficient of friction of a contact."""
        return float(np.min(self.contacts[name].law.mu))

    def normal(self, name: str, at: Mapping[str, int], level: float = 0.0) -> Force:
        """Force along the normals of a contact that is held."""
        return Force(self.along(name, at, 0), level)

    def along(self, name: str, at: Mapping[str, int], axis: int) -> list[int]:
        """Slots of a contact along its normals (0) or tangents (1, 2), those that exist."""
        rows = [f"{name}.{row.name}" for row in self.contacts[name].rows[axis::3]]
        return [at[row] for row in rows if row in at]

    def room(self, name: str, at: Mapping[str, int]) -> ConeRoom:
        """What friction of a contact that is held has left."""
        tangents = self.along(name, at, 1), self.along(name, at, 2)
        return ConeRoom(self.friction(name), self.along(name, at, 0), tangents)

    def exit(self, plan: PhasePlan, guard: GuardPlan, at: Mapping[str, int]) -> Exit:
        """A way out of a phase."""
        entry, then = guard.entry, list(self.plans).index(guard.then)
        usual = "down" if any(getattr(entry, key) is not None for key in _DOWN) else "both"
        condition = None
        if guard.when is not None:
            above = guard.when.above
            level = guard.when.below if above is None else above
            assert level is not None
            condition = Condition(self.sum_of(guard.when, level), above is not None)
        crossing = None if entry.time is not None else self.crossing(plan, guard, at)
        way = _WAYS[entry.direction or usual]
        reset = self.reset(plan, guard)
        return Exit(guard.name, crossing, way, condition, entry.time, then, reset)

    def crossing(self, plan: PhasePlan, guard: GuardPlan, at: Mapping[str, int]) -> Crossing:
        """The number whose zero ends a phase."""
        entry = guard.entry
        if entry.touch_down is not None:
            return Gap(self.contacts[entry.touch_down])
        if entry.lift_off is not None:
            return self.normal(entry.lift_off, at)
        if entry.slip is not None:
            return self.room(entry.slip, at)
        if entry.force is not None:
            return self.normal(entry.force, at, entry.at)
        if entry.multiplier is not None:
            if entry.multiplier not in at:
                there = ", ".join(at) or "none"
                raise SceneError(
                    f"{guard.where}.multiplier: phase {plan.name} has no multiplier "
                    f"'{entry.multiplier}', there are: {there}"
                )
            return Force([at[entry.multiplier]], entry.at)
        return self.sum_of(entry, entry.at)

    def sum_of(self, entry: Any, level: float) -> Combination:
        """A sum of joint positions times factors, less a level."""
        factors = {entry.joint: 1.0} if entry.joint is not None else dict(entry.joints)
        q = np.array([self.robot.joint(name).q for name in factors], dtype=np.intp)
        return Combination(q, np.array(list(factors.values()), dtype=np.float64), level)

    def reset(self, plan: PhasePlan, guard: GuardPlan) -> PhaseReset:
        """What happens at once where a guard fires."""
        then, size = self.plans[guard.then], len(self.layout.rows)
        relabelling = relabelling_of(self.robot, guard.reset, f"{guard.where}.reset")
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
        return PhaseReset(size, system, self.slots(system), tuple(touching), relabelling)

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
