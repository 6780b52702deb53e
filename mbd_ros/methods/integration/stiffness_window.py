"""The window of the stiffness of contacts: what depth asks, what a step follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import Accelerator, System
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.state import Array, Evaluation, Mode, State
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import DivergedError
from mbd_ros.methods.integration.linear_motion import SpringMotion, is_bounded, longest_step
from mbd_ros.methods.integration.stepping import Integrator

Linked = NDArray[np.bool_]
_INSIDE = 1.0 - 1.0e-9  # of a cone: friction that sticks
_APART = 1.0e-12  # of the inverse masses: contacts that do not move one another
GAIN = 0.01  # of the speed of the approach, which counts as none
_PHASES, _STAGED = 24, 256  # of a step in which a mass arrives, more where stages stand inside it
_BEFORE = 10  # steps on the way there, in which methods with a history gather theirs
_STEPS = 400
_SHARES = np.geomspace(1.0e-3, 1.0, 25).tolist()
_SPRING_REBOUND_HALVINGS = 8
_WIDE = 4.0  # factor by which the end of a window is looked for
_FARTHEST = 1.0e12
_HALVINGS = 16  # of the ratio `_WIDE`
_GENTLE = 0.1  # k dt^2/m up to which other methods of fixed steps gain no more than `GAIN`
_LONGER = 1.0e4  # than the shortest time of a motion: steps that no bound is looked for beyond


def windows(motion: ContactMotion, method: Integrator, dt: float) -> list[Window]:
    """Return the window of each contact, all contacts that move one another made stiffer together.

    Args:
        method: What integrates it.
        dt: Its step [s].
    """
    entries = []
    for group in motion.parted():
        ends = ends_of(group, method, dt)
        for part in dict.fromkeys(feature.part for feature in group.features):
            loads = [feature.load for feature in group.features if feature.part is part]
            k, depth, load = part.normal.stiffness, part.max_penetration, max(loads)
            lower = part.normal.least(load, depth) if depth else 0.0
            opening = longest(group, method, lower / k) if lower > k * ends.share else math.inf
            entries.append(
                Window(
                    *(part, len(loads), load, lower, k * ends.share, k * ends.impacts),
                    *(ends.longest, opening),
                )
            )
    return entries


def ends_of(motion: ContactMotion, method: Integrator, dt: float) -> Ends:
    """Return the largest multiples of the stiffness of contacts, and their longest step.

    Args:
        motion: Of contacts that move one another.
        method: What integrates it.
        dt: Its step [s].
    """
    if method.stable == math.inf:
        return Ends(math.inf, math.nan, math.inf)

    def holds(share: float) -> bool:
        return is_bounded(method, motion.linear(share), dt)

    share = _largest(holds) if method.is_explicit else math.inf
    rate, damping = motion.stiffest()
    a, b = rate * dt * dt, damping * dt
    is_known = type(method).growth is not Integrator.growth and not method.finds_surfaces
    impacts = _GENTLE / a if a > 0.0 and share > 0.0 else math.nan
    if is_known and 0.0 < share < math.inf and a > 0.0:
        impacts = share * largest_without_gain(method, share * a, b)
    return Ends(share, impacts, longest(motion, method, 1.0))


def _largest(holds: Any) -> float:
    """Return the largest share for which something holds, 0 for none, inf for all."""
    share = 1.0
    if holds(share):
        while holds(_WIDE * share):
            share *= _WIDE
            if share > _FARTHEST:
                return math.inf
    else:
        while not holds(share / _WIDE):
            share /= _WIDE
            if share < 1.0 / _FARTHEST:
                return 0.0
        share /= _WIDE
    return bisected(holds, share, _WIDE * share, _HALVINGS)


def bisected(holds: Callable[[float], bool], low: float, high: float, halvings: int) -> float:
    """A number between one for which something holds and one for which it does not, by ratios."""
    for _ in range(halvings):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return float(low)


def largest_without_gain(method: Integrator, a: float, b: float) -> float:
    """Largest share of a below which no rebound is faster than the approach, but for `GAIN`.

    Args:
        method: As for `rebound`.
        a: As for `rebound`.
        b: Damping, for all shares of a.
    """

    def gains(share: float) -> bool:
        return not rebound(method, share * a, b) <= 1.0 + GAIN

    first = next((i for i, share in enumerate(_SHARES) if gains(share)), len(_SHARES))
    if first in (0, len(_SHARES)):
        return 1.0 if first else 0.0
    return bisected(
        lambda share: not gains(share),
        _SHARES[first - 1],
        _SHARES[first],
        _SPRING_REBOUND_HALVINGS,
    )


def longest(motion: ContactMotion, method: Integrator, share: float) -> float:
    """Return the longest step for a multiple of the stiffness of contacts [s], inf without any."""
    linear = motion.linear(share)
    if not method.is_explicit or not linear.rate:
        return math.inf
    return longest_step(method, linear, _LONGER * method.stable / linear.rate)


class Window(NamedTuple):
    """The window of the stiffness of one contact, in units of its stiffness.

    Attributes:
        features: How many of its features touch.
        load: Largest normal force of one of them that it is made for [N].
        lower: Stiffness that keeps that as deep as it may be, 0 where no depth is known.
        upper: Largest stiffness that steps follow, inf without any end.
        impacts: Largest one at which no impact gains speed, NaN where it is not known.
        longest: Longest step for its stiffness [s], inf where none is too long.
        opening: Longest step for the lower end [s].
    """

    part: Any
    features: int
    load: float
    lower: float
    upper: float
    impacts: float
    longest: float
    opening: float


class Ends(NamedTuple):
    """How stiff contacts may be, and how long a step, that move one another.

    Attributes:
        share: Largest multiple of their stiffness that steps follow; 0 where friction and
            dampers alone are too much, inf without any end.
        impacts: The same of impacts that gain no speed, NaN where it is not known.
        longest: Longest step for their stiffness [s].
    """

    share: float
    impacts: float
    longest: float


def touching_motion(
    system: System, parts: Sequence[Any], x: State, u: Array | None = None
) -> ContactMotion:
    """Return the motion of all contacts at a state, as if each touched with its nearest features.

    A feature counts with the load that it would carry at rest: the least loads that keep all of
    them from going deeper, as springs of one stiffness share them; or with the `max_force` of its
    contact. Stops, drives and rigid contacts that push at the state hold.

    Args:
        parts: Contacts that give way.
        x: State of all joints.
    """
    k, still = system.k, x._replace(v=np.zeros_like(x.v))
    now = system.evaluate(still, u)
    k.refresh(x.q, still.v, Reads.JACOBIAN)
    given = system.loads.inputs(still, u)
    pushed = sum(part.force(k, still, given) for part in parts)
    slots = list[tuple[Any, int]]()
    for part in parts:
        gaps = part.pair.gaps(k)
        near = np.flatnonzero(gaps <= max(float(gaps.min()), 0.0) + part.max_penetration)
        slots += [(part, int(i)) for i in near]
    J = _rows(system, slots)
    answer = _answer(system, still, now, np.column_stack((J.T, pushed)))
    A, free = J.dot(answer[:, :-1]), now.a - answer[:, -1]
    loads = _at_rest(A[::3, ::3], J[::3].dot(free))
    features = [
        Feature(part, slot, load if part.max_force is None else part.max_force)
        for (part, slot), load in zip(slots, loads.tolist(), strict=True)
    ]
    return ContactMotion(features, A)


def _rows(system: System, slots: Sequence[tuple[Any, int]]) -> Array:
    """Return rows of features, at the state of k, shape (3 n, nv)."""
    whole = {id(part): part.pair.jacobian(system.k) for part, _ in slots}
    rows: Array = np.concatenate([whole[id(part)][3 * i : 3 * i + 3] for part, i in slots])
    return rows


def _answer(system: System, x: State, now: Evaluation, forces: Array) -> Array:
    """Accelerations that forces add, shape (nv, k) both, rows that push or hold at x kept."""
    added: Array = now.respond(forces)
    solved = () if system.bounded is None else system.bounded.constraints.blocks
    every = [*system.layout.yielding, *(block for block in solved if block.law.is_rigid)]
    held = [_holding(block, now.lam[block.slots]) for block in every]
    if not any(on.any() for on in held):
        return added
    pairs = zip(every, held, strict=True)
    J = np.concatenate([block.part.jacobian(system.k, x)[on] for block, on in pairs if on.any()])
    back = now.respond(J.T)
    lam = np.linalg.lstsq(J.dot(back), J.dot(added), rcond=redundant(len(J)))[0]
    added -= back.dot(lam)
    return added


def _holding(block: RowBlock, lam: Array) -> NDArray[np.bool_]:
    """Return which rows a block holds with its multipliers; friction in joints counts as none."""
    on: NDArray[np.bool_] = np.full(len(lam), block.law.is_rigid)
    if block.law.kind is Kind.CONE:
        normal, x, y = lam.reshape(-1, 3).T
        on[::3] = normal > 0.0
        on[1::3] = on[2::3] = np.hypot(x, y) < _INSIDE * np.asarray(block.law.mu) * normal
    elif block.law.kind in (Kind.UNILATERAL, Kind.DRIVE):
        on |= lam != 0.0
    return on


def _at_rest(A: Array, approach: Array) -> Array:
    """Return the least loads >= 0 that end an approach [m/s^2], shape (n,)."""
    loads, pushing = np.zeros(len(A)), np.arange(len(A))
    while len(pushing):
        block = A[np.ix_(pushing, pushing)]
        pressures = np.linalg.lstsq(block, -approach[pushing], rcond=redundant(len(A)))[0]
        if (pressures >= 0.0).all():
            loads[pushing] = pressures
            break
        pushing = pushing[pressures > 0.0]
    return loads


def pressed_motion(
    system: System, parts: Sequence[Any], x: State, u: Array | None = None
) -> ContactMotion | None:
    """The motion of all contacts that push at a state, with their forces there; None without any.

    Arguments are those of `touching_motion`.
    """
    k, now = system.k, system.evaluate(x, u)
    k.refresh(x.q, x.v, Reads.JACOBIAN)
    loads = [(part, part.multipliers(k, x)[::3].tolist()) for part in parts]
    features = [Feature(part, i, f) for part, of in loads for i, f in enumerate(of) if f > 0.0]
    if not features:
        return None
    J = _rows(system, [feature[:2] for feature in features])
    return ContactMotion(features, J.dot(_answer(system, x, now, J.T)))


class Feature(NamedTuple):
    """A feature that touches.

    Attributes:
        slot: Its place among the features of that.
        load: Normal force that it carries [N].
    """

    part: Any
    slot: int
    load: float


class ContactMotion:
    """The motion of all compliant contacts together, linear around a state.

    The speeds of the contact points are w = J v, and forces lam on them change w' by A lam with
    the inverse effective mass of all contacts together,

        A = J M^-1 J' = L L',   w = L y,   y'' = -L' (K L y + C L y'),

    constraints and couplings kept. The coordinates y of the motion are as many as A has rank, and
    its matrices are symmetric. Bristles stick: their deflections are internal states, z' = L_t y'.

    Args:
        features: Those that touch.
        A: Inverse effective mass, normal and tangents of each, shape (3 n, 3 n).
    """

    def __init__(self, features: Sequence[Feature], A: Array) -> None:
        self.features, self.A = tuple(features), A

    def linear(self, share: float = 1.0) -> SpringMotion:
        """Return the motion with a multiple of the stiffness of all contacts."""
        k, c, kt, ct = self._slopes(share)
        normal, sides = self._normal, self._sides
        bent = np.flatnonzero(np.repeat(kt, 2))
        dampers = (normal.T * c).dot(normal) + (sides.T * np.repeat(ct, 2)).dot(sides)
        springs = (normal.T * k).dot(normal)
        return SpringMotion(springs, dampers, sides[bent], np.repeat(kt, 2)[bent])

    def stiffest(self) -> tuple[float, float]:
        """Stiffness and damping over mass of the fastest motion along normals [1/s^2, 1/s]."""
        k, c, *_ = self._slopes(1.0)
        sizes, ways = np.linalg.eigh((self._normal.T * k).dot(self._normal))
        way = self._normal.dot(ways[:, -1])
        return float(sizes[-1]), float(way.dot(c * way))

    def parted(self) -> list[ContactMotion]:
        """Return the motions of contacts that do not move one another."""
        size = np.sqrt(np.maximum(np.diag(self.A), 0.0))
        n = len(self.features)
        joined = np.abs(self.A) > _APART * np.outer(size, size)
        parts = [feature.part for feature in self.features]
        same = np.array([[a is b for a in parts] for b in parts])
        linked: Linked = np.logical_or(joined.reshape(n, 3, n, 3).any(axis=(1, 3)), same)
        while True:
            further: Linked = linked.dot(linked)
            if (further == linked).all():
                break
            linked = further
        groups = dict.fromkeys(tuple(np.flatnonzero(row).tolist()) for row in linked)
        return [self._of(list(group)) for group in groups]

    def _of(self, some: list[int]) -> ContactMotion:
        rows = (3 * np.array(some)[:, None] + np.arange(3)).reshape(-1)
        return ContactMotion([self.features[i] for i in some], self.A[np.ix_(rows, rows)])

    def _slopes(self, share: float) -> Array:
        """Return the stiffness and damping along normals, then tangents, shape (4, n)."""
        slopes: Array = np.array([f.part.slopes(f.slot, f.load, share) for f in self.features]).T
        return slopes

    @cached_property
    def _normal(self) -> Array:
        """The rows of L along normals, shape (n, rank)."""
        return self._factor[::3]

    @cached_property
    def _sides(self) -> Array:
        """The rows of L along tangents, shape (2 n, rank)."""
        sides: Array = np.delete(self._factor, slice(None, None, 3), axis=0)
        return sides

    @cached_property
    def _factor(self) -> Array:
        """The L, shape (3 n, rank); rows without any force are 0."""
        k, c, kt, ct = np.abs(self._slopes(1.0))
        acts = np.column_stack((k + c, kt + ct, kt + ct)).reshape(-1) > 0.0
        block = self.A[np.ix_(acts, acts)]
        sizes, ways = np.linalg.eigh(0.5 * (block + block.T))
        kept = sizes > redundant(len(sizes)) * sizes.max(initial=0.0)
        factor: Array = np.zeros((len(acts), int(kept.sum())))
        factor[acts] = ways[:, kept] * np.sqrt(sizes[kept])
        return factor


def rebound(method: Integrator, a: float, b: float) -> float:
    """Largest speed after an impact over that before, whenever in a step it begins; inf unbounded.

    Args:
        method: An explicit method of fixed steps.
        a: Stiffness k dt^2/m.
        b: Damping c dt/m.
    """
    n = _PHASES if method.order == 1 else _STAGED
    x = State(0.0, _BEFORE + (np.arange(n) + 0.5) / n, np.full(n, -1.0))
    stepper = method.prepare(Bouncer(a, b, n), 1.0)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_BEFORE + _STEPS):
                x = stepper.step(x, None)
                if ((x.q > 0.0) & (x.v >= 0.0)).all():
                    break
    except DivergedError:
        return math.inf
    fastest = float(x.v.max())
    return fastest if math.isfinite(fastest) else math.inf


class Bouncer:
    """Unit masses that fall on springs and dampers of one side, without gravity; dt is 1.

    It has what steppers ask of a system.

    Args:
        a: Stiffness k dt^2/m.
        b: Damping c dt/m.
        n: How many masses.
    """

    is_flat, sizes = True, 1.0

    def __init__(self, a: float, b: float, n: int) -> None:
        self._a, self._b = a, b
        self.nq = self.nv = n
        self.chart, self.model = self, SimpleNamespace(nv=n, nq=n)

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return q + dq."""
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return the q1 - q0."""
        return q1 - q0

    def rate(self, dq: Array, v: Array) -> Array:
        """Return the v."""
        return v

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return forces of the springs that are pressed."""

        def write(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            out[:] = np.where(q < 0.0, np.maximum(-self._a * q - self._b * v, 0.0), 0.0)

        return write
