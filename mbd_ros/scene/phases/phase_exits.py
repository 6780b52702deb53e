"""Guards of phases by names -> numbers whose zeros end a phase."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.events.crossings import (
    Combination,
    Condition,
    ConeRoom,
    Crossing,
    Footing,
    Force,
    Gap,
)
from mbd_ros.core.events.phase import Check, Exit, Phase
from mbd_ros.core.events.phase_reset import PhaseReset
from mbd_ros.core.model.robot import Robot
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.phase_plans import GuardPlan, PhasePlan

_WAYS = {"up": 1, "down": -1, "both": 0}
_DOWN = ("touch_down", "lift_off", "slip", "tip")  # act so, unless an entry says it


class PhaseExits:
    """What ends the phases of a scene, and what may not happen in them.

    Args:
        robot: The robot.
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
            plan: Its plan.
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
        held = plan.contacts if plan.held else ()
        every = [(name, *one) for name in held for one in self.checks(name, at)]
        demands = tuple(check for _, _, check in every)
        checks = tuple(check for name, word, check in every if (name, word) not in looked_at)
        limit = float("inf") if plan.limit is None else plan.limit
        return Phase(plan.name, exits, checks, demands, limit)

    def checks(self, name: str, at: Mapping[str, int]) -> list[tuple[str, Check]]:
        """What a contact that is held may not do."""
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
        """What friction of a contact that is held has left."""
        tangents = self._along(name, at, 1), self._along(name, at, 2)
        return ConeRoom(self._friction(name), self._along(name, at, 0), tangents)
