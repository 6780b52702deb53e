"""Guards: numbers whose zeros are events, and where they change sign."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import Guard, Now, Part, label
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError

_LINE = 1.0e-9  # of the size of points: so near to a line, they are on it
Point = tuple[float, float]  # an argument of a function, and its value there
_WIDTH = 1.0e-4  # of a bracket: for a slope
_NO_ROWS, _ALL_ROWS = slice(0, 0), slice(None)


class Crossing(Protocol):
    """A number that has a zero.

    Attributes:
        reads: Level of the kinematics that it reads.
    """

    @property
    def reads(self) -> Reads:
        """Level of the kinematics that it reads."""

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """Return the number at a state of all joints.

        Args:
            k: Kinematics there, refreshed as far as `reads` says.
            lam: Multipliers of all rows of the phase, shape (m,).
        """


class Gap(NamedTuple):
    """The least distance of the bodies of a contact [m]."""

    contact: Any
    reads: Reads = Reads.POSITION

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """Return the number at a state of all joints."""
        return float(self.contact.pair.gaps(k).min())


class Force(NamedTuple):
    """A sum of multipliers, less a level [N or N·m].

    Attributes:
        slots: Of the multipliers among those of the phase.
    """

    slots: Sequence[int]
    at: float = 0.0
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """Return the number at a state of all joints."""
        return sum(float(lam[i]) for i in self.slots) - self.at


class ConeRoom(NamedTuple):
    """Friction force that a held contact has in reserve before it slips [N].

        mu sum n - |sum t|

    Attributes:
        mu: Coefficient of friction, the smallest of its features.
        normals: Slots of the normal forces among the multipliers of the phase.
        tangents: Slots along either tangent.
    """

    mu: float
    normals: Sequence[int]
    tangents: tuple[Sequence[int], Sequence[int]]
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """Return the number at a state of all joints."""
        n = sum(float(lam[i]) for i in self.normals)
        t = (sum(float(lam[i]) for i in each) for each in self.tangents)
        return self.mu * n - math.hypot(*t)


class Footing(NamedTuple):
    """How far the centre of pressure of a contact that is held is from the edge of its points [N].

        min over edges of sum n_i d_i / d,   d_i the distance of point i from the edge

    d is the size of the points. The sums do not depend on how points share the load. Source: P.
    Sardain, G. Bessonnet, IEEE Trans. Systems, Man, Cybernetics A 34, 2004, 630-637.

    Attributes:
        normals: Slots of the normal forces among the multipliers of the phase, one a feature.
    """

    contact: Any
    normals: Sequence[int]
    reads: Reads = Reads.POSITION

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """Return the number at a state of all joints."""
        n = lam[list(self.normals)]
        return min(float(n.dot(inside)) for inside in self.edges(k))

    def edges(self, k: Kinematics) -> list[Array]:
        """Return distances d_i / d of the points from each edge, shape (n,) each."""
        places = self.contact.pair.places(k)
        away = places.point - places.point.mean(axis=0)
        return _inside(away.dot(places.axes[0][:, :2]))


def _inside(points: Array) -> list[Array]:
    """Distances of points in a plane from each edge of their hull, in sizes of it, shape (n,)."""
    _, sizes, ways = np.linalg.svd(points, full_matrices=False)
    along = points.dot(ways[0])
    size = float(np.ptp(along)) or 1.0
    if sizes[-1] <= _LINE * sizes[0]:  # on a line: its ends
        return [(along - along.min()) / size, (along.max() - along) / size]
    conditions = []
    for i, j in itertools.permutations(range(len(points)), 2):
        edge, from_i = points[j] - points[i], points - points[i]
        length = float(np.hypot(*edge))
        inside = (edge[0] * from_i[:, 1] - edge[1] * from_i[:, 0]) / max(length * size, TINY)
        if length > _LINE * size and (inside >= -_LINE).all():
            conditions.append(inside)
    return conditions


class Condition(NamedTuple):
    """Where a guard acts: a sum of joint positions times factors is above or below a level.

    Attributes:
        of: The sum, less the level.
        above: Whether it has to be positive; negative otherwise.
    """

    of: Combination
    above: bool

    def holds(self, x: State) -> bool:
        """Whether a guard acts at a state of all joints."""
        value = float(self.of.factors.dot(x.q[self.of.q])) - self.of.at
        return value > 0.0 if self.above else value < 0.0


class Combination(NamedTuple):
    """A sum of joint positions times factors, less a level [rad or m].

    Attributes:
        q: Indices of the joints in a configuration, shape (n,).
        factors: One a joint, shape (n,).
    """

    q: NDArray[np.intp]
    factors: Array
    at: float
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """Return the number at a state of all joints."""
        return float(self.factors.dot(x.q[self.q])) - self.at


def sign_change(f: Callable[[float], float], near: Point, far: Point, width: float = 0.0) -> float:
    """Return argument between two others at which f changes its sign.

    Bisection, or inverse quadratic interpolation where that is safe; ends when the bracket is a
    few units of rounding wide.

    Source: T. R. Chandrupatla, Advances in Engineering Software 28, 1997, 145-149.

    Args:
        f: Continuous between the arguments.
        near: An argument and f there, >= 0 or <= 0.
        far: Another one, with f of the other sign.
        width: Of a bracket that is short enough, beside rounding of the arguments.
    """
    (a, fa), (b, fb), part = far, near, 0.5
    for _ in range(200):
        x = a + part * (b - a)
        fx = f(x)
        if (fx > 0.0) == (fa > 0.0):
            c, fc = a, fa
        else:
            c, fc = b, fb
            b, fb = a, fa
        a, fa = x, fx
        best, f_best = (a, fa) if abs(fa) < abs(fb) else (b, fb)
        limit = max(2.0 * math.ulp(best), width) / abs(b - a) if b != a else 1.0
        if f_best == 0.0 or limit > 0.5:
            return best
        part = min(max(_interpolated((a, fa), (b, fb), (c, fc)), limit), 1.0 - limit)
    return best


def _interpolated(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Return the part of the way from a to b at which to look next."""
    (xa, fa), (xb, fb), (xc, fc) = a, b, c
    if fb == fc or fa in (fb, fc):
        return 0.5
    xi, phi = (xa - xb) / (xc - xb), (fa - fb) / (fc - fb)
    if not 1.0 - math.sqrt(1.0 - xi) < phi < math.sqrt(xi):
        return 0.5
    return fa / (fb - fa) * fc / (fb - fc) + (xc - xa) / (xb - xa) * fa / (fc - fa) * fb / (
        fc - fb
    )


def narrowed(
    f: Callable[[float], float], like: Callable[[float], float], near: Point, far: Point
) -> tuple[Point, Point]:
    """A shorter bracket of a change of sign, by two arguments of f; the same where they miss it.

    Args:
        like: One that is nearly the same and costs less; asked before f.
        near: An argument and f there, > 0.
        far: Another one, with f < 0.
    """
    start, end = like(near[0]), like(far[0])
    if not start > 0.0 > end:
        return near, far
    guess = sign_change(like, (near[0], start), (far[0], end))
    ends = min(near[0], far[0]), max(near[0], far[0])
    width = _WIDTH * (ends[1] - ends[0])
    low, high = max(guess - width, ends[0]), min(guess + width, ends[1])
    slope = (like(high) - like(low)) / (high - low)
    first = guess, f(guess)
    if slope == 0.0 or first[1] == 0.0:
        return near, far
    other = guess - 2.0 * first[1] / slope
    if not ends[0] < other < ends[1]:
        return near, far
    second = other, f(other)
    if (first[1] > 0.0) == (second[1] > 0.0):
        return near, far
    return (first, second) if first[1] > 0.0 else (second, first)


class PartGuards:
    """The guards of all parts of a system.

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
        """Return values of all guards at a state of what is integrated, shape (n,).

        Raises:
            ModelError: A part has another number of values than of guards.
        """
        if not self.guards:
            return np.zeros(0)
        system = self._system
        x = system.expand(y)._replace(mode=mode)
        now, given, results = system.evaluate(x, u), system.loads.inputs(x, u), []
        for part, slots in self._parts:
            system.k.refresh(x.q, x.v, part.reads)
            values = np.asarray(part.guard_values(system.k, x, given, Now(now.a, now.lam[slots])))
            if values.shape != (len(part.guards),):
                raise ModelError(
                    f"{part.name} gives guard values of shape {values.shape}, guards: "
                    f"{len(part.guards)}"
                )
            results.append(values)
        return np.concatenate(results)

    def sides(self, values: Array, slack: float, mode: Mode, left: Collection[int]) -> list[int]:
        """Return the side on which each guard is watched, 0 where it does not act.

        Args:
            values: At the start of a step.
            slack: Values of that size are none.
            mode: The present one.
            left: Guards that were zero just now.
        """
        signs = []
        for i, (guard, value) in enumerate(zip(self.guards, values.tolist(), strict=True)):
            side = -guard.direction or (1 if value > 0.0 else -1)
            is_left = i in left and guard.direction != 0
            acts = side * value > slack or is_left
            acts = acts and (guard.armed is None or guard.armed(mode))
            signs.append(side if acts else 0)
        return signs

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


def guarding(system: Any) -> Iterator[tuple[Part, slice]]:
    """Parts with guards and the slots of the multipliers they see: constraints, loads, others."""
    blocks = ((block.part, block.slots) for block in system.layout.blocks)
    loads = ((part, _NO_ROWS) for part in (*system.loads.actuators, *system.loads.forces))
    others = ((part, _ALL_ROWS) for part in system.loads.watching)
    yield from ((part, slots) for part, slots in (*blocks, *loads, *others) if part.guards)
