"""Motion in phases: one system a phase, behind one `System`; the mode of a state says which."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.mass import Mass
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint_rows import RowLayout
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import Array, Evaluation, Mode, State

Slots = NDArray[np.intp]


class PhasedSystem:
    """The systems of all phases, with the multipliers of the whole scene.

    The mode of a state begins with the number of its phase; one entry for each switch of the
    scene follows, 1 where the phase does not have it. A state without a mode is in the first
    phase, and what takes no state answers for that one.

    Args:
        phases: What else is known of each, `methods.events.phases.Phase`.
        systems: One a phase.
        layout: All rows of the scene.
        slots: Where the multipliers of each system stand among those of the scene.
        first: Number of the phase that begins.

    Attributes:
        switches: Names of the switches of all phases.
    """

    def __init__(
        self,
        phases: Sequence[Any],
        systems: Sequence[System],
        layout: RowLayout,
        slots: Sequence[Slots],
        first: int = 0,
    ) -> None:
        self.phases = tuple(phases)
        self.systems = tuple(systems)
        self.layout = layout
        self.slots = slots
        self.first = first
        self.multiplier_rows = layout.rows
        names = [() if s.event_rows is None else s.event_rows.names for s in systems]
        self.switches = tuple(dict.fromkeys(name for each in names for name in each))
        self._at = [[self.switches.index(name) for name in each] for each in names]
        now = self._now = self.systems[first]
        self.robot = now.robot
        self.model = now.model
        self.loads = now.loads
        self.k = now.k
        self.internals = now.internals
        self.sizes = now.sizes
        self.tier = now.tier
        self.chart = now.chart
        self.nq = now.nq
        self.nv = now.nv
        self.rows = now.rows
        self.constraints = now.constraints
        self.bilateral = now.bilateral
        self.bounded = now.bounded
        self.event_rows = now.event_rows

    def phase(self, x: State) -> int:
        """Return the number of the phase of a state."""
        return x.mode[0] if x.mode else self.first

    def during(self, x: State) -> System:
        """Return the system of the phase of a state."""
        return self.systems[self.phase(x)]

    def inward(self, x: State) -> State:
        """Return the state with the mode that the system of its phase has for it."""
        if not x.mode:
            return x
        return x._replace(mode=tuple(x.mode[1 + i] for i in self._at[x.mode[0]]))

    def outward(self, phase: int, x: State) -> State:
        """Return the state of a system with the mode that the scene has for it."""
        mode = [phase, *(1 for _ in self.switches)]
        for i, way in zip(self._at[phase], x.mode, strict=True):
            mode[1 + i] = way
        return x._replace(mode=tuple(mode))

    def impulse(self, phase: int, of_phase: Array) -> Array:
        """Return numbers one a multiplier of a phase, as those of the scene, 0 elsewhere."""
        whole = np.zeros(len(self.multiplier_rows))
        whole[self.slots[phase]] = of_phase
        return whole

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Accelerations, the multipliers of the scene and the response to forces, at a state."""
        phase = self.phase(x)
        found = self.systems[phase].evaluate(self.inward(x), u)
        return found._replace(x=x, lam=self.impulse(phase, found.lam))

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """The function that writes accelerations in a mode, and rates with internal states."""
        if not mode:
            return self._now.accelerator()
        return self.systems[mode[0]].accelerator(tuple(mode[1 + i] for i in self._at[mode[0]]))

    def rates(self, y: State, u: Array | None = None) -> Array:
        """Return rates of the internal states at a state, shape (nz,)."""
        return self.during(y).rates(self.inward(y), u)

    def at_rest(self, y: State, u: Array | None = None) -> Array:
        """Internal states with what parts know of their equilibrium, NaN where none is known."""
        return self.during(y).at_rest(self.inward(y), u)

    def derivatives(self, y: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Return derivatives of the accelerations in the phase of a state."""
        return self.during(y).derivatives(self.inward(y), u, inputs=inputs)

    def with_loads(self, loads: Loads) -> "PhasedSystem":
        """Return the same phases, built for other loads; guards of each phase stay."""
        changed = [
            system.with_loads(loads.watched_by(system.loads.watching)) for system in self.systems
        ]
        return PhasedSystem(self.phases, changed, self.layout, self.slots, self.first)

    def with_gains(self, kp: float, kd: float) -> "PhasedSystem":
        """Return the same phases with g'' + kd g' + kp g = 0 of bilateral rows."""
        changed = [system.with_gains(kp, kd) for system in self.systems]
        if all(one is other for one, other in zip(changed, self.systems, strict=True)):
            return self
        return PhasedSystem(self.phases, changed, self.layout, self.slots, self.first)

    def expand(self, y: State) -> State:
        """Return the state of all joints."""
        return self.during(y).expand(y)

    def reduce(self, x: State) -> State:
        """Return the state of what is integrated."""
        return self.during(x).reduce(x)

    def lift(self, y: State, a: Array) -> Array:
        """Return accelerations of all joints from those of what is integrated."""
        return self.during(y).lift(y, a)

    def energy(self, y: State) -> float:
        """Return the kinetic and potential energy [J]."""
        return self.during(y).energy(y)

    def applied_with(self, y: State, u: Array | None = None) -> Array:
        """Return the generalized force tau - h at a state with internal states, shape (nv,)."""
        return self.during(y).applied_with(y, u)

    def integrated(self, a: Array) -> Array:
        """Return values of what is integrated among those of all joints."""
        return self._now.integrated(a)

    def mass(self, q: Array) -> Mass:
        """Return the mass matrix of the first phase."""
        return self._now.mass(q)

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Return the generalized force tau - h in the first phase, shape (nv,)."""
        return self._now.applied(t, q, v, u)

    def residual(self, t: float, q: Array) -> Array:
        """Return the residual of the rows of the first phase."""
        return self._now.residual(t, q)

    def jacobian(self, t: float, q: Array) -> Array:
        """Return Jacobian of the rows of the first phase."""
        return self._now.jacobian(t, q)

    def rate(self, t: float, q: Array) -> Array:
        """Return the rate dg/dt of the rows of the first phase."""
        return self._now.rate(t, q)

    def factorise(self, t: float, q: Array) -> RowFactor:
        """Return the factor of the rows of the first phase."""
        return self._now.factorise(t, q)

    @property
    def condition(self) -> float:
        """Condition number of the rows of the first phase."""
        return self._now.condition

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the equations of motion of all phases."""
        return sum(system.evaluations for system in self.systems)
