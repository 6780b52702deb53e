"""Contacts with friction among rows that give way at events: open, sticking or slipping.

Sticking, the normal and the tangents of a contact are three equations. Slipping, friction is mu
times the normal force against the slip velocity: the normal alone is an equation, and pushes along

    D = n - mu d' t,   d = v_t / |v_t|

so that the mobility J M^-1 D' is not symmetric. Modes of the tangents are 0 while a contact
sticks, 1 while it is open, and else two odd numbers along d: they say on which side of v_t = 0 a
slip goes on, so that forces are smooth up to the end of the slip and beyond. A ball that sticks
rolls. Source: F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts, 1996, ch. 5.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.contact_forces import ContactForces, Split, Touch
from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.row_laws import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ON_SURFACE

OPEN: Mode = (1, 1, 1)
STICKS: Mode = (0, 0, 0)
_TURNED = 0.8  # cosine of the angle from which a direction is named anew
_SHARED = 1.0e-9  # of the largest multiplier: what a share at the end of a law may leave
_EASED = 1.0e-6  # of friction: so little less shows how contacts begin to move
_NO_SLIP = 100.0 * ON_SURFACE  # of 1 + the largest velocity: how slow a slip may end


class Solved(NamedTuple):
    """What rows that give way do at one state.

    Attributes:
        lam: Their multipliers, shape (m,).
        force: Of these on all joints, shape (nv,).
        added: Accelerations of all joints by it, shape (nv,).
        left: The w of the rows, shape (m,).
        terms: Size of the terms in w, shape (m,).
    """

    lam: Array
    force: Array
    added: Array
    left: Array
    terms: Array


class ExactContacts:
    """The contacts of a scene among all of its rows that give way.

    Args:
        rows: The rows.
        at: Which of them go from event to event, shape (n,).

    Attributes:
        normals: Where the normals stand among these, their tangents behind them, shape (c,).
        names: Of the contacts.
        forces: What finds their multipliers.
    """

    def __init__(self, rows: ConstraintRows, at: NDArray[np.intp]) -> None:
        starts = [cone.slots.start for cone in rows.cones]
        self.normals: list[int] = np.searchsorted(at, starts).tolist()
        self.names = tuple(cone.name for cone in rows.cones)
        self._rows, self._mu = rows, np.array([cone.mu for cone in rows.cones])
        self._starts = np.array(starts, dtype=np.intp)
        self._tangents = self._starts[:, None] + (1, 2)
        self._parts = [block.part for block in rows.blocks if block.law.kind is Kind.CONE]
        self.forces = ContactForces(rows)
        self._moving: list[Array | None] = []

    def solve(
        self,
        motion: Any,
        q: Array,
        x: State,
        a: Array,
        bounds: tuple[Array, Array],
        mode: Mode,
        free: Collection[int],
    ) -> Solved:
        """Multipliers and accelerations in a mode of the contacts.

        Args:
            motion: The `FreeMotion` without rows that give way.
            q: Integrated configuration.
            x: State of all joints, with k refreshed.
            a: Accelerations of all joints without the rows.
            bounds: Smallest and largest multipliers of all rows.
            mode: One entry each of the rows that go from event to event.
            free: Those whose mode is looked for.

        Raises:
            SolveError: The rows that are on contradict one another, or no forces are found.
        """
        k = motion.mechanism.k
        J, b = self._rows.conditions(k, x)
        touches, along = self._touches(self.slips(k, x), slowest(x), mode, free)
        D = self._pushes(J, along)
        response = motion.respond(q, D.T)
        A, w = J.dot(response), J.dot(a) + b
        lam = self.forces.solve(A, w, bounds, touches)
        left, terms = A.dot(lam) + w, np.abs(A).dot(np.abs(lam)) + np.abs(w)
        force, added = D.T.dot(lam), response.dot(lam)
        for i, d in along.items():
            lam[self._tangents[i]] = -self._mu[i] * lam[self._starts[i]] * d
        return Solved(lam, force, added, left, terms)

    def slips(self, k: Kinematics, x: State) -> Array:
        """The velocities v_t of the points along their planes, shape (c, 2)."""
        rates = [part.jacobian(k, x).dot(x.v) + part.rate(k, x) for part in self._parts]
        return np.concatenate(rates).reshape(-1, 3)[:, 1:]

    def found(self, left: Array, slack: Array) -> list[Mode]:
        """Modes that the last solve found, one a contact.

        Args:
            left: The w of the rows that go from event to event.
            slack: What counts as none of it.
        """
        return [
            self._found(left[i : i + 3], slack[i : i + 3], slip, float(mu))
            for i, slip, mu in zip(self.normals, self._moving, self._mu, strict=True)
        ]

    def _found(self, left: Array, slack: Array, slip: Array | None, mu: float) -> Mode:
        if left[0] > slack[0]:
            return OPEN
        if slip is not None:
            return 0, *side(slip)
        if mu > 0.0 and math.hypot(*left[1:]) <= slack[1:].max():
            return STICKS
        return 0, *side(left[1:])

    @property
    def shares(self) -> bool:
        """Whether equations alone did not split the forces of the last solve."""
        return self.forces.split is not Split.ONE

    @contextmanager
    def eased(self) -> Iterator[None]:
        """Where modes are looked for inside, friction is a little smaller."""
        self.forces.grip = 1.0 - _EASED
        try:
            yield
        finally:
            self.forces.grip = 1.0

    def margins(
        self, k: Kinematics, x: State, lam: Array, mode: Mode
    ) -> dict[tuple[int, int], float]:
        """What is left of a push, of a slip, and of friction to its largest, in a mode.

        Contacts that can share their force otherwise are not at the end of their mode yet.

        Args:
            k: Kinematics at the state.
            x: State of all joints.
            lam: Multipliers of the last solve, of the rows that go from event to event.
            mode: One entry each of these.
        """
        found: dict[tuple[int, int], float] = {}
        slips: Array | None = None
        most = float(np.abs(lam).max())
        for c, i in enumerate(self.normals):
            if mode[i]:
                continue
            normal, named = float(lam[i]), mode[i + 1 : i + 3]
            found[i, 1] = self._left(normal, most)
            if not any(named):
                friction = math.hypot(*lam[i + 1 : i + 3])
                found[i + 1, 1] = self._left(float(self._mu[c]) * normal - friction, most)
            elif self._mu[c] > 0.0:
                slips = self.slips(k, x) if slips is None else slips
                found[i + 1, 0] = float(slips[c].dot(named)) / math.hypot(*named)
        return found

    def _left(self, margin: float, most: float) -> float:
        is_shared = self.forces.split is Split.LAWFUL
        return most if is_shared and margin < _SHARED * most else margin

    def leaving(self, lam: Array, left: Array, slack: Array, mode: Mode) -> dict[int, int]:
        """Modes in which contacts that shared their force go on, where no share is left.

        Args:
            lam: Multipliers by a friction that is a little smaller, of the rows as in `margins`.
            left: The w there.
            slack: What counts as none of it.
            mode: The one that ends.
        """
        ways: dict[int, int] = {}
        most = max(float(lam[i]) for i in self.normals)
        for i, after in zip(self.normals, self.found(left, slack), strict=True):
            if mode[i]:
                continue
            is_idle = not any(mode[i : i + 3]) and lam[i] <= _EASED * most
            ways.update(zip(range(i, i + 3), OPEN if is_idle else after, strict=True))
        return ways

    def left(self, lam: Array, switch: int) -> dict[int, int]:
        """Modes after a contact opens or begins to slip.

        Args:
            lam: Multipliers of the last solve, as in `margins`.
            switch: Row of its normal where it opens, else of its first tangent.
        """
        i = next(i for i in self.normals if i <= switch < i + 3)
        after = OPEN if switch == i else (0, *side(-lam[i + 1 : i + 3]))
        return dict(zip(range(i, i + 3), after, strict=True))

    def turned(self, k: Kinematics, x: State, mode: Mode) -> dict[int, int]:
        """Modes of slips that have turned far, named anew."""
        every = enumerate(self.normals)
        slipping = [(c, i) for c, i in every if not mode[i] and any(mode[i + 1 : i + 3])]
        found: dict[int, int] = {}
        slips = self.slips(k, x) if slipping else None
        for c, i in slipping:
            assert slips is not None
            slip, named = slips[c], mode[i + 1 : i + 3]
            size = math.hypot(*slip)
            if size > slowest(x) and slip.dot(named) < _TURNED * size * math.hypot(*named):
                found.update(zip((i + 1, i + 2), side(slip), strict=True))
        return found

    def _touches(
        self, slips: Array, slow: float, mode: Mode, free: Collection[int]
    ) -> tuple[list[Touch], dict[int, Array]]:
        """How every contact touches, and along which directions which of them slip."""
        touches, along = list[Touch](), dict[int, Array]()
        self._moving = [None] * len(self.normals)
        for c, i in enumerate(self.normals):
            is_free, named = i in free, mode[i + 1 : i + 3]
            if not is_free and mode[i]:
                touches.append(Touch.OPEN)
                continue
            if not is_free and not any(named):
                touches.append(Touch.STICKS)
                continue
            slip, size = slips[c], math.hypot(*slips[c])
            if size > slow:
                self._moving[c] = slip
            if size > slow or self._mu[c] == 0.0:
                turns = size > 0.0 and not is_free and slip.dot(named) < 0.0
                along[c] = slip / (-size if turns else size or 1.0)
                touches.append(Touch.MAY_SLIP if is_free else Touch.SLIPS)
            else:
                touches.append(Touch.MAY)
        return touches, along

    def _pushes(self, J: Array, along: dict[int, Array]) -> Array:
        """D: the normals with friction, shape (m, nv)."""
        if not along:
            return J
        D = J.copy()
        for c, d in along.items():
            D[self._starts[c]] -= self._mu[c] * d.dot(J[self._tangents[c]])
        return D


def side(slip: Sequence[float] | Array) -> tuple[int, int]:
    """Two odd numbers along a slip, which name its direction in a mode."""
    size = math.hypot(*slip)
    if size == 0.0:
        return 1, 1
    first, second = (min(2 * math.floor(2.0 * float(each) / size) + 1, 3) for each in slip)
    return first, second


def slowest(x: State) -> float:
    """Slip velocity that counts as none."""
    return _NO_SLIP * (1.0 + float(np.abs(x.v).max()))
