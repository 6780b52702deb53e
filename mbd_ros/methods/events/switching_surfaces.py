"""Forces that jump at switching surfaces, and Filippov's motion on these surfaces.

Off the surfaces h_i(t, q, v) = 0 a force is smooth, with the signs s_i = sign h_i. Where a motion
stays on surfaces, the signs there take the values in -1 .. 1 that keep h_i' = 0: the equivalent
control. Source: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.system import Accelerator, System
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TIE
from mbd_ros.errors import SolveError

Mode = tuple[int, ...]  # one a surface: 1 above it, -1 below, 0 sliding on it
MOST_SURFACES = 6  # on which a motion may be at once; 3^k cases are looked at
_SAME = 1.0e-6  # signs that give the same motion
Choice = Callable[[State, Array | None], Array]
_CORRECTIONS = 5


class DiscontinuousForce(Load):
    """A force that is smooth except where h_i(t, q, v) = 0.

        tau = blend(signs),   signs_i = sign h_i off the surfaces, in -1 .. 1 on them

    `blend` is affine in `signs`, and with fixed signs smooth across the surfaces. So the convex
    combination of Filippov, the equivalent control of Utkin and the multilinear blend of the 2^k
    sides are one and the same motion.

    Source: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, §4.

    Attributes:
        surfaces: Names of the surfaces, for messages.
    """

    surfaces: tuple[str, ...]

    def heights(self, k: Kinematics, x: State) -> Array:
        """The h_i, shape (k,); in any unit."""
        raise NotImplementedError

    def rates(self, k: Kinematics, x: State, a: Array) -> Array:
        """The dh_i/dt, affine in the acceleration, shape (k,).

        Args:
            k: Kinematics at the state.
            a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        """
        raise NotImplementedError

    def blend(self, k: Kinematics, x: State, signs: Array) -> Array:
        """Generalized force between the sides [N·m or N], shape (nv,).

        Args:
            k: Kinematics at the state.
            signs: One a surface, shape (k,): 1 above it, -1 below.
        """
        raise NotImplementedError

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """The force by the signs of the heights, for methods without surfaces, shape (nv,)."""
        return self.blend(k, x, np.sign(self.heights(k, x)))

    def beside(self, k: Kinematics, x: State) -> Load:
        """The force with the signs of a state everywhere; on a surface itself the mean of both."""
        return OneSide(self, np.sign(self.heights(k, x)))


class OneSide(Load):
    """A switching force that does not switch.

    Args:
        signs: The side, one sign a surface, shape (k,).
    """

    def __init__(self, force: DiscontinuousForce, signs: Array) -> None:
        self._force, self._signs, self.reads = force, signs, force.reads

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force [N·m or N], shape (nv,)."""
        return self._force.blend(k, x, self._signs)


def mode_on(r: Array, D: Array, names: Sequence[str]) -> Mode:
    """The only way to continue where surfaces meet: h' = r + D s with s in -1 .. 1.

        h_i' > 0 and s_i = 1 (leaves above), h_i' < 0 and s_i = -1 (leaves below),
        or h_i' = 0 and -1 <= s_i <= 1 (slides)

    This is Filippov's solution with the equivalent control on every surface that it slides on.
    It is unique where -D is a P-matrix; for one surface: s D < 0, the surface attracts or is
    crossed. At a tangency, where two ways begin with the same velocity, sliding comes first; it
    ends at once if it has to.

    Source: A. F. Filippov, 1988, §4 and §10; V. I. Utkin, Sliding Modes in Control and
    Optimization, 1992, ch. 2.

    Args:
        r: Rates of the surfaces with zero signs, shape (k,).
        D: Change of the rates per sign, shape (k, k).
        names: Of the surfaces.

    Raises:
        SolveError: Several solutions start here (a surface repels), or none does.
    """
    k = len(r)
    if k > MOST_SURFACES:
        raise SolveError(
            f"{k} switching surfaces at once ({', '.join(names)}): {MOST_SURFACES} go"
        )
    cases = sorted(itertools.product((0, 1, -1), repeat=k), key=lambda mode: -mode.count(0))
    found = [(mode, s) for mode in cases if (s := _signs(r, D, mode)) is not None]
    where = f"switching surface {', '.join(names)}"
    if not found:
        raise SolveError(
            f"{where}: no Filippov solution goes on; rates {r}, per sign {D.tolist()}"
        )
    mode, s = found[0]
    if any(np.abs(other - s).max() > _SAME for _, other in found[1:]):
        ways = "; ".join(_words(way) for way, _ in found[:4])
        raise SolveError(f"{where}: the solution is not unique, it may go on {ways}")
    return mode


def _signs(r: Array, D: Array, mode: Mode) -> Array | None:
    """Signs that a mode needs; None where it is not consistent with the rates."""
    s = np.array(mode, dtype=np.float64)
    slides = s == 0.0
    if slides.any():
        held = _solve(D[np.ix_(slides, slides)], -(r + D.dot(s))[slides])
        if held is None or np.abs(held).max() > 1.0 + TIE:
            return None
        s[slides] = held
    h_rate = r + D.dot(s)
    allowed = -TIE * (np.abs(r) + np.abs(D).sum(axis=1))
    leaves = (np.array(mode) * h_rate)[~slides] >= allowed[~slides]
    return s if leaves.all() else None


def _solve(D: Array, right: Array) -> Array | None:
    """Solution of a small system with rows of any size; None where it is singular."""
    size = np.abs(D).max(axis=1)
    if not (size > TIE * np.abs(right)).all():
        return None
    scaled = D / size[:, None]
    if np.linalg.cond(scaled) > 1.0 / TIE:
        return None
    return np.linalg.solve(scaled, right / size)


def _words(mode: Mode) -> str:
    return ", ".join({1: "above", 0: "on it", -1: "below"}[way] for way in mode)


def equivalent_signs(r: Array, D: Array, names: Sequence[str]) -> Array:
    """Signs s with r + D s = 0, which keep a motion on the surfaces, shape (k,).

    Raises:
        SolveError: The force does not act across the surfaces: D is singular.
    """
    signs = _solve(D, -r)
    if signs is None:
        raise SolveError(f"switching surface {', '.join(names)}: no force keeps a motion on it")
    return signs


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
