"""The smooth pieces of a system with switching forces, and its motion on their surfaces."""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import Accelerator, System
from mbd_ros.core.events.surface_modes import Mode, equivalent_signs
from mbd_ros.core.events.switching import DiscontinuousForce
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.state import Array, State

Choice = Callable[[State, Array | None], Array]
_CORRECTIONS = 5


class SignResponse(NamedTuple):
    """How accelerations and rates answer the signs s of some surfaces.

        acceleration = a + B s,   h' = r + D s

    Attributes:
        a: Of the integrated coordinates, shape (nv,).
        B: One column a chosen surface, shape (nv, k).
        r: Of all surfaces, shape (m,).
        D: Shape (m, k).
    """

    a: Array
    B: Array
    r: Array
    D: Array


class SwitchedLoads(Loads):
    """Loads whose switching forces follow given signs.

    Args:
        nv: Size of the velocity of the robot.
        loads: The same loads, by the signs of the heights.
        choice: Signs at a state of all joints while `signs` is None, shape (m,).

    Attributes:
        switching: The switching forces.
        signs: One a surface, shape (m,).
    """

    def __init__(self, nv: int, loads: Loads, choice: Choice) -> None:
        super().__init__(nv, loads.forces, loads.actuators, loads.sources)
        self.switching = tuple(f for f in loads.forces if isinstance(f, DiscontinuousForce))
        others = [f for f in loads.forces if not isinstance(f, DiscontinuousForce)]
        self._smooth, self._choice = loads.having(others), choice
        ends = np.cumsum([0, *(len(f.surfaces) for f in self.switching)]).tolist()
        self._mine = [slice(*pair) for pair in itertools.pairwise(ends)]
        self.signs: Array | None = None

    def total(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Generalized force [N·m or N], shape (nv,); as `Loads.total`."""
        signs = self._choice(x, u) if self.signs is None else self.signs
        tau = self._smooth.total(k, x, u)
        for force, mine in zip(self.switching, self._mine, strict=True):
            tau = tau + force.blend(k, x, signs[mine])
        return tau


class SlidingField:
    """A system in one mode at a time: smooth, also across its switching surfaces.

    Where it slides, a = a_0 + B s with the signs for which h' = 0: Filippov's combination, whose
    weights are (1 + s) / 2 and (1 - s) / 2. The system knows the modes too: it evaluates a state
    in the mode that the state has, sliding included.

    Source: A. F. Filippov, 1988, §4; L. Dieci, L. Lopez, SIAM J. Numer. Anal. 47, 2009, 2023-2051.

    Args:
        system: The system, without rows that are solved for in every evaluation.

    Attributes:
        system: The same one, built for loads that know the modes.
        mode: Mode of the accelerations, one entry a surface.
        beside: Mode of the exact rows, one entry each; modes of states begin with it.
        names: Of the surfaces.
    """

    def __init__(self, system: System) -> None:
        self._loads = SwitchedLoads(int(system.model.nv), system.loads, self._signs_of)
        self.system = system.with_loads(self._loads)
        self.names = tuple(name for f in self._loads.switching for name in f.surfaces)
        self.nv, self._zdot = system.nv, np.zeros(system.internals.nz)
        self.mode: Mode = (1,) * len(self.names)
        self.beside: Mode = (1,) * (0 if system.exact is None else len(system.exact.names))

    @property
    def sliding(self) -> list[int]:
        """Surfaces that the motion slides on."""
        return [i for i, way in enumerate(self.mode) if way == 0]

    def accelerator(self) -> Accelerator:
        """As that of a `System`, in the mode at the time of the call."""

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            out[...] = self._in_mode(State(t, q, v), u)

        def with_rates(
            t: float, q: Array, v: Array, z: Array, u: Array | None, a_out: Array, z_out: Array
        ) -> None:
            a_out[...] = self._in_mode(State(t, q, v, z), u)
            z_out[...] = self._zdot

        return with_rates if len(self._zdot) else accelerate

    def heights(self, x: State) -> Array:
        """The h of all surfaces, shape (m,)."""
        full = self._placed(x)
        parts = [f.heights(self.system.k, full) for f in self._loads.switching]
        return np.concatenate(parts)

    def rates(self, x: State, u: Array | None) -> Array:
        """The h' of all surfaces in this mode, shape (m,)."""
        return self.rates_at(x, self._in_mode(x, u))

    def signs(self, x: State, u: Array | None) -> Array:
        """Signs that keep the motion on the surfaces that it slides on, shape (k,)."""
        return self._equivalent(self.answer(x, u, self.sliding), self.sliding)

    def answer(self, x: State, u: Array | None, chosen: Sequence[int]) -> SignResponse:
        """How the motion answers the signs of some surfaces, the others in their mode."""
        signs = np.array(self.mode, dtype=np.float64)
        signs[list(chosen)] = 0.0
        a = self._accelerate(x, u, signs)
        r = self.rates_at(x, a)
        B, D = np.zeros((self.nv, len(chosen))), np.zeros((len(r), len(chosen)))
        for column, i in enumerate(chosen):
            signs[i] = 1.0
            moved = self._accelerate(x, u, signs)
            B[:, column], D[:, column] = moved - a, self.rates_at(x, moved) - r
            signs[i] = 0.0
        return SignResponse(a, B, r, D)

    def onto(self, x: State, u: Array | None) -> State:
        """The state on the surfaces that it slides on, moved only as their forces move it.

        Newton's method for h(t, q, v + B c) = 0; dh/dv B = D. Rows J v = 0 stay, since J B = 0.
        """
        on = self.sliding
        h = self.heights(x)[on] if on else np.zeros(0)
        if not h.any():
            return x
        answer = self.answer(x, u, on)
        for _ in range(_CORRECTIONS):
            move = answer.B.dot(equivalent_signs(h, answer.D[on], self._named(on)))
            nearer = x._replace(v=x.v + move)
            left = self.heights(nearer)[on]
            if not np.abs(left).max() < np.abs(h).max():
                break
            x, h = nearer, left
        return x

    def _equivalent(self, answer: SignResponse, on: Sequence[int]) -> Array:
        return equivalent_signs(answer.r[on], answer.D[on], self._named(on))

    def _named(self, chosen: Sequence[int]) -> list[str]:
        return [self.names[i] for i in chosen]

    def _in_mode(self, x: State, u: Array | None) -> Array:
        """Acceleration of the integrated coordinates in this mode, shape (nv,)."""
        if 0 not in self.mode:
            return self._accelerate(x, u, np.array(self.mode, dtype=np.float64))
        on = self.sliding
        answer = self.answer(x, u, on)
        return answer.a + answer.B.dot(self._equivalent(answer, on))

    def _accelerate(self, x: State, u: Array | None, signs: Array) -> Array:
        a: Array = np.empty(self.nv)
        self._loads.signs = signs
        try:
            write = self.system.accelerator(self.beside)
            if len(self._zdot):
                write(x.t, x.q, x.v, x.z, u, a, self._zdot)
            else:
                write(x.t, x.q, x.v, u, a)
        finally:
            self._loads.signs = None
        return a

    def rates_at(self, x: State, a: Array) -> Array:
        """The h' under an acceleration that was just evaluated at x."""
        full_a = self.system.lift(x, a)
        full = self._placed(x)
        parts = [f.rates(self.system.k, full, full_a) for f in self._loads.switching]
        return np.concatenate(parts)

    def _placed(self, x: State) -> State:
        """State of all joints, with `k` as the forces need it."""
        full = self.system.expand(x)
        self.system.k.refresh(full.q, full.v, self._loads.reads)
        return full

    def _signs_of(self, full: State, u: Array | None) -> Array:
        """Signs at a state of all joints: those of its mode, without one those of its heights."""
        x, rows = self.system.reduce(full), len(self.beside)
        mode = full.mode[rows:]
        if len(mode) != len(self.names):
            return np.sign(self.heights(x))
        now, self.mode, self.beside = (self.mode, self.beside), mode, full.mode[:rows]
        signs = np.array(mode, dtype=np.float64)
        try:
            if 0 in mode:
                signs[self.sliding] = self.signs(x, u)
        finally:
            self.mode, self.beside = now
        self._placed(x)
        return signs
