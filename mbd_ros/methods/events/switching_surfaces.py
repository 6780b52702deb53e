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
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import TIE
from mbd_ros.errors import SolveError

ABOVE, SLIDING, BELOW = 1, 0, -1  # entries of a mode, one a surface
MEAN = 2  # the same for a force with the sign 0, the mean of both sides; never the mode of a state
MOST_SURFACES = 6  # on which a motion may be at once; 3^k cases are tried
_SAME = 1.0e-6  # signs that give the same motion
ChooseSigns = Callable[[State, Array | None], Array]
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
        """Return the h_i, shape (k,), in any unit."""
        raise NotImplementedError

    def rates(self, k: Kinematics, x: State, a: Array) -> Array:
        """Return the dh_i/dt, affine in the acceleration, shape (k,).

        Args:
            k: Kinematics at the state.
            x: State of all joints.
            a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        """
        raise NotImplementedError

    def blend(self, k: Kinematics, x: State, signs: Array) -> Array:
        """Return the generalized force between the sides [N·m or N], shape (nv,).

        Args:
            k: Kinematics at the state.
            x: State of all joints.
            signs: One a surface, shape (k,): 1 above it, -1 below.
        """
        raise NotImplementedError

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the force by the signs of the heights, for methods without surfaces."""
        return self.blend(k, x, np.sign(self.heights(k, x)))

    def beside(self, k: Kinematics, x: State) -> Load:
        """Return the force with the signs of a state everywhere; on a surface the mean of both."""
        return OneSide(self, np.sign(self.heights(k, x)))


class OneSide(Load):
    """A switching force that stays on one side of its surfaces.

    Args:
        force: The switching force.
        signs: The side, one sign a surface, shape (k,).
    """

    def __init__(self, force: DiscontinuousForce, signs: Array) -> None:
        self._force = force
        self._signs = signs
        self.reads = force.reads

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force [N·m or N], shape (nv,)."""
        return self._force.blend(k, x, self._signs)


def mode_on(r: Array, D: Array, names: Sequence[str]) -> Mode:
    """Return the only mode in which a motion continues where surfaces meet: h' = r + D s.

        h_i' > 0 and s_i = 1 (leaves above), h_i' < 0 and s_i = -1 (leaves below),
        or h_i' = 0 and -1 <= s_i <= 1 (slides)

    This is Filippov's solution with the equivalent control on every surface that it slides on.
    It is unique where -D is a P-matrix; for one surface: s D < 0, the surface attracts or is
    crossed. At a tangency, where two motions begin with the same velocity, sliding comes first; it
    ends at once if it has to.

    Source: A. F. Filippov, 1988, §4 and §10; V. I. Utkin, Sliding Modes in Control and
    Optimization, 1992, ch. 2.

    Args:
        r: Rates of the surfaces with zero signs, shape (k,).
        D: Change of the rates per sign, shape (k, k).
        names: Names of the surfaces.

    Raises:
        SolveError: Several solutions start here (a surface repels), or none does.
    """
    k = len(r)
    if k > MOST_SURFACES:
        raise SolveError(
            f"the motion is on {k} switching surfaces at once ({', '.join(names)}), but at most "
            f"{MOST_SURFACES} are accepted"
        )
    cases = sorted(itertools.product((0, 1, -1), repeat=k), key=lambda mode: -mode.count(0))
    solutions = [(mode, s) for mode in cases if (s := _signs(r, D, mode)) is not None]
    where = f"switching surface {', '.join(names)}"
    if not solutions:
        raise SolveError(
            f"{where}: no Filippov solution goes on; rates {r}, per sign {D.tolist()}"
        )
    mode, s = solutions[0]
    if any(np.abs(other - s).max() > _SAME for _, other in solutions[1:]):
        sides = "; ".join(_side_names(mode) for mode, _ in solutions[:4])
        raise SolveError(f"{where}: the solution is not unique, it may go on {sides}")
    return mode


def _signs(r: Array, D: Array, mode: Mode) -> Array | None:
    """Return the signs that a mode needs; None where it is not consistent with the rates."""
    s = np.array(mode, dtype=np.float64)
    slides = s == 0.0
    if slides.any():
        sliding_signs = _solve(D[np.ix_(slides, slides)], -(r + D.dot(s))[slides])
        if sliding_signs is None or np.abs(sliding_signs).max() > 1.0 + TIE:
            return None
        s[slides] = sliding_signs
    h_rate = r + D.dot(s)
    allowed = -TIE * (np.abs(r) + np.abs(D).sum(axis=1))
    leaves = (np.array(mode) * h_rate)[~slides] >= allowed[~slides]
    return s if leaves.all() else None


def _solve(D: Array, right: Array) -> Array | None:
    """Solve a small system with rows of any size; None where it is singular."""
    size = np.abs(D).max(axis=1)
    if not (size > TIE * np.abs(right)).all():
        return None
    scaled = D / size[:, None]
    if np.linalg.cond(scaled) > 1.0 / TIE:
        return None
    return np.linalg.solve(scaled, right / size)


def _side_names(mode: Mode) -> str:
    return ", ".join({ABOVE: "above", SLIDING: "on it", BELOW: "below"}[side] for side in mode)


def equivalent_signs(r: Array, D: Array, names: Sequence[str]) -> Array:
    """Return the signs s with r + D s = 0, which keep a motion on the surfaces, shape (k,).

    Raises:
        SolveError: The force does not act across the surfaces: D is singular.
    """
    signs = _solve(D, -r)
    if signs is None:
        raise SolveError(f"switching surface {', '.join(names)}: no force keeps a motion on it")
    return signs


class SlidingField:
    """A system in one mode: smooth, also across its switching surfaces.

    Where it slides, a = a_0 + B s with the signs for which h' = 0: Filippov's combination, whose
    weights are (1 + s) / 2 and (1 - s) / 2. A mode has one entry an event-driven row, then one a
    surface. The system evaluates a state in the mode of that state, sliding included.

    Source: A. F. Filippov, 1988, §4; L. Dieci, L. Lopez, SIAM J. Numer. Anal. 47, 2009, 2023-2051.

    Args:
        system: The system, without rows that are solved for in every evaluation.

    Attributes:
        system: The same one, built for loads that know the modes.
        names: Names of the surfaces.
    """

    def __init__(self, system: System) -> None:
        self._rows = 0 if system.event_rows is None else len(system.event_rows.names)
        nv = int(system.model.nv)
        self._loads = SwitchedLoads(nv, system.loads, self._rows, self._sliding_signs)
        self.system = system.with_loads(self._loads)
        self.names = self._loads.names
        self.nv = system.nv
        self._nz = system.internals.nz

    def sliding(self, mode: Mode) -> list[int]:
        """Return the surfaces that the motion slides on in a mode."""
        return [i for i, side in enumerate(mode[self._rows :]) if side == SLIDING]

    def accelerator(self, mode: Mode) -> Accelerator:
        """Return the function that writes accelerations in a mode, as that of a `System`."""

        def write(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            out[...] = self._accelerate(State(t, q, v), u, mode)[0]

        def write_with_rates(
            t: float, q: Array, v: Array, z: Array, u: Array | None, a_out: Array, z_out: Array
        ) -> None:
            a_out[...], z_out[...] = self._accelerate(State(t, q, v, z), u, mode)

        return write_with_rates if self._nz else write

    def heights(self, y: State) -> Array:
        """Return the h of all surfaces, shape (m,)."""
        return self._loads.heights(self.system.k, self._expand(y))

    def rates(self, y: State, u: Array | None, mode: Mode) -> Array:
        """Return the h' of all surfaces in a mode, shape (m,)."""
        return self.rates_at(y, self._accelerate(y, u, mode)[0])

    def rates_at(self, y: State, a: Array) -> Array:
        """Return the h' under an acceleration that was just evaluated at a state, shape (m,)."""
        full_a = self.system.lift(y, a)
        x = self._expand(y)
        rates = [f.rates(self.system.k, x, full_a) for f in self._loads.switching]
        return np.concatenate(rates)

    def signs(self, y: State, u: Array | None, mode: Mode) -> Array:
        """Return the signs that keep the motion on the surfaces that it slides on, shape (k,)."""
        on = self.sliding(mode)
        return self._equivalent_signs(self.response(y, u, mode, on), on)

    def response(
        self, y: State, u: Array | None, mode: Mode, chosen: Sequence[int]
    ) -> SignResponse:
        """Return the response of the motion to the signs of some surfaces.

        Args:
            y: State of what is integrated.
            u: Inputs there.
            mode: The mode; the entries of the chosen surfaces do not matter.
            chosen: Numbers of the surfaces.
        """
        sides = list(mode)
        for i in chosen:
            sides[self._rows + i] = MEAN
        a, zdot = self._evaluate(y, u, tuple(sides))
        r = self.rates_at(y, a)
        B, D = np.zeros((self.nv, len(chosen))), np.zeros((len(r), len(chosen)))
        for column, i in enumerate(chosen):
            sides[self._rows + i] = ABOVE
            above, zdot = self._evaluate(y, u, tuple(sides))
            B[:, column] = above - a
            D[:, column] = self.rates_at(y, above) - r
            sides[self._rows + i] = MEAN
        return SignResponse(a, B, r, D, zdot)

    def project(self, y: State, u: Array | None, mode: Mode) -> State:
        """Return the state on the surfaces that it slides on, moved only as their forces move it.

        Newton's method for h(t, q, v + B c) = 0; dh/dv B = D. Rows J v = 0 stay, since J B = 0.
        """
        on = self.sliding(mode)
        h = self.heights(y)[on] if on else np.zeros(0)
        if not h.any():
            return y
        response = self.response(y, u, mode, on)
        for _ in range(_CORRECTIONS):
            step = response.B.dot(equivalent_signs(h, response.D[on], self._names_of(on)))
            nearer = y._replace(v=y.v + step)
            remaining = self.heights(nearer)[on]
            if not np.abs(remaining).max() < np.abs(h).max():
                break
            y, h = nearer, remaining
        return y

    def _accelerate(self, y: State, u: Array | None, mode: Mode) -> tuple[Array, Array]:
        """Return accelerations and rates of internal states in a mode, sliding included."""
        on = self.sliding(mode)
        if not on:
            return self._evaluate(y, u, mode)
        response = self.response(y, u, mode, on)
        return response.a + response.B.dot(self._equivalent_signs(response, on)), response.zdot

    def _evaluate(self, y: State, u: Array | None, mode: Mode) -> tuple[Array, Array]:
        """Return the same in a mode that does not slide."""
        a, zdot = np.empty(self.nv), np.zeros(self._nz)
        write = self.system.accelerator(mode)
        if self._nz:
            write(y.t, y.q, y.v, y.z, u, a, zdot)
        else:
            write(y.t, y.q, y.v, u, a)
        return a, zdot

    def _equivalent_signs(self, response: SignResponse, on: Sequence[int]) -> Array:
        return equivalent_signs(response.r[on], response.D[on], self._names_of(on))

    def _names_of(self, chosen: Sequence[int]) -> list[str]:
        return [self.names[i] for i in chosen]

    def _expand(self, y: State) -> State:
        """Return the state of all joints, with `k` as the forces need it."""
        x = self.system.expand(y)
        self.system.k.refresh(x.q, x.v, self._loads.reads)
        return x

    def _sliding_signs(self, x: State, u: Array | None) -> Array:
        """Return the signs of all surfaces at a state of all joints whose mode slides on some."""
        y = self.system.reduce(x)
        signs = np.array(x.mode[self._rows :], dtype=np.float64)
        signs[self.sliding(x.mode)] = self.signs(y, u, x.mode)
        self._expand(y)
        return signs


class SwitchedLoads(Loads):
    """Loads whose switching forces follow the mode of the state.

    Args:
        nv: Size of the velocity of the robot.
        loads: The same loads, by the signs of the heights.
        rows: Number of the event-driven rows, with whose entries a mode begins.
        sliding_signs: The function from a state of all joints, and u, to all signs, for modes that
            slide.

    Attributes:
        switching: The switching forces.
        names: Names of their surfaces.
    """

    def __init__(self, nv: int, loads: Loads, rows: int, sliding_signs: ChooseSigns) -> None:
        super().__init__(nv, loads.forces, loads.actuators, loads.sources)
        self.switching = tuple(f for f in loads.forces if isinstance(f, DiscontinuousForce))
        self.names = tuple(name for f in self.switching for name in f.surfaces)
        smooth = [f for f in loads.forces if not isinstance(f, DiscontinuousForce)]
        self._smooth = loads.having(smooth)
        self._rows = rows
        self._sliding_signs = sliding_signs
        ends = np.cumsum([0, *(len(f.surfaces) for f in self.switching)]).tolist()
        self._slices = [slice(*pair) for pair in itertools.pairwise(ends)]

    def heights(self, k: Kinematics, x: State) -> Array:
        """Return the h of all surfaces at a state of all joints, with k as they read it."""
        return np.concatenate([f.heights(k, x) for f in self.switching])

    def total(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Return the generalized force [N·m or N], shape (nv,)."""
        signs = self._signs(k, x, u)
        tau = self._smooth.total(k, x, u)
        for force, surfaces in zip(self.switching, self._slices, strict=True):
            tau = tau + force.blend(k, x, signs[surfaces])
        return tau

    def _signs(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Return the signs of a mode; without a mode those of the heights."""
        sides = x.mode[self._rows :]
        if len(sides) != len(self.names):
            return np.sign(self.heights(k, x))
        if SLIDING in sides:
            return self._sliding_signs(x, u)
        return np.array([0 if side == MEAN else side for side in sides], dtype=np.float64)


class SignResponse(NamedTuple):
    """Response of accelerations and rates to the signs s of some surfaces.

        acceleration = a + B s,   h' = r + D s

    Attributes:
        a: Acceleration of the integrated coordinates with the signs 0, shape (nv,).
        B: One column a chosen surface, shape (nv, k).
        r: Rates of all surfaces with the signs 0, shape (m,).
        D: One column a chosen surface, shape (m, k).
        zdot: Rates of the internal states, which no sign changes, shape (nz,).
    """

    a: Array
    B: Array
    r: Array
    D: Array
    zdot: Array
