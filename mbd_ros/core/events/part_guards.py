"""Guards that parts bring, and what they reset."""

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from mbd_ros.core.contracts.outputs import Now
from mbd_ros.core.contracts.parts import Guard, Part
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.names import label
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import ModelError

_NO_ROWS, _ALL_ROWS = slice(0, 0), slice(None)


def guarding(system: Any) -> Iterator[tuple[Part, slice]]:
    """Parts with guards and the slots of the multipliers they see: constraints, loads, others."""
    blocks = ((block.part, block.slots) for block in system.layout.blocks)
    loads = ((part, _NO_ROWS) for part in (*system.loads.actuators, *system.loads.forces))
    others = ((part, _ALL_ROWS) for part in system.loads.watching)
    yield from ((part, slots) for part, slots in (*blocks, *loads, *others) if part.guards)


class PartGuards:
    """The guards of all parts of a system.

    Args:
        system: The system.

    Attributes:
        names: `<part>.<guard>`, in the order of the scene.
        guards: In the same order.
    """

    def __init__(self, system: System) -> None:
        self._system, self._parts = system, list(guarding(system))
        self.guards: tuple[Guard, ...] = tuple(g for part, _ in self._parts for g in part.guards)
        self.names = tuple(
            label(part, guard.name) for part, _ in self._parts for guard in part.guards
        )
        self._owners = [part for part, _ in self._parts for _ in part.guards]

    def values(self, y: State, u: Array | None, mode: Mode) -> Array:
        """Values of all guards at a state of what is integrated, shape (n,).

        Raises:
            ModelError: A part has another number of values than of guards.
        """
        if not self.guards:
            return np.zeros(0)
        system = self._system
        x = system.expand(y)._replace(mode=mode)
        now, given, found = system.evaluate(x, u), system.loads.inputs(x, u), []
        for part, slots in self._parts:
            system.k.refresh(x.q, x.v, part.reads)
            values = np.asarray(part.guard_values(system.k, x, given, Now(now.a, now.lam[slots])))
            if values.shape != (len(part.guards),):
                raise ModelError(
                    f"{part.name} gives guard values of shape {values.shape}, guards: "
                    f"{len(part.guards)}"
                )
            found.append(values)
        return np.concatenate(found)

    def sides(self, values: Array, slack: float, mode: Mode, left: Collection[int]) -> list[int]:
        """The side on which each guard is watched, 0 where it does not act.

        Args:
            values: At the start of a step.
            slack: Values of that size are none.
            mode: The present one.
            left: Guards that were zero just now.
        """
        found = []
        for i, (guard, value) in enumerate(zip(self.guards, values.tolist(), strict=True)):
            side = -guard.direction or (1 if value > 0.0 else -1)
            is_left = i in left and guard.direction != 0
            acts = side * value > slack or is_left
            acts = acts and (guard.armed is None or guard.armed(mode))
            found.append(side if acts else 0)
        return found

    def acts(self, y: State, guard: int) -> bool:
        """Whether a guard acts at a state where it is zero."""
        condition = self.guards[guard].condition
        return condition is None or condition(self._system.expand(y))

    def reset(self, y: State, u: Array | None, fired: Collection[int]) -> State:
        """The state after the resets of the parts whose guards have fired, in their order."""
        system = self._system
        x, done = system.expand(y), list[Part]()
        for i in sorted(fired):
            part = self._owners[i]
            if part not in done:
                done.append(part)
                system.k.refresh(x.q, x.v, part.reads)
                x = part.reset(system.k, x, system.loads.inputs(x, u))._replace(t=x.t)
        return system.reduce(x)
