"""Rows between points of a molecule, solved for side by side.

Arrays are (atoms, 3, lanes), a lane a molecule. A row has one direction in space, so that an entry
of J M^-1 J' is a number that masses give, times the product of two directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, sqrt
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import ASSEMBLED, BRANCH_STEP, LANDED, redundant
from mbd_ros.errors import SolveError


class DistanceRow(NamedTuple):
    """Two points of a molecule at a fixed distance.

        g = (|d|^2 - L^2) / (2 L),  d = x_i - x_j,  dg/dx_i = d / L

    On the row d / L is a unit vector: the multiplier is the force that pushes both apart.

    Attributes:
        name: For columns and messages.
        i: Number of the first point in the molecule.
        j: Number of the second.
    """

    name: str
    i: int
    j: int
    length: float

    @property
    def ends(self) -> tuple[tuple[int, float], ...]:
        """The points, and the sign with which the direction pushes each."""
        return (self.i, 1.0), (self.j, -1.0)

    @property
    def size(self) -> float:
        """Scale to which g is compared."""
        return self.length

    def direction(self, x: Array) -> Array:
        """The derivative by the first point, shape (3, lanes).

        Args:
            x: Positions, shape (atoms, 3, lanes).
        """
        d: Array = x[self.i] - x[self.j]
        d /= self.length
        return d

    def residual(self, x: Array, direction: Array) -> Array:
        """g, shape (lanes,), from the direction at the same positions."""
        g: Array = product(direction, direction)
        g -= 1.0
        g *= 0.5 * self.length
        return g

    def rate(self, v: Array, direction: Array) -> Array:
        """g', shape (lanes,)."""
        rate: Array = product(direction, v[self.i] - v[self.j])
        return rate

    def drift(self, v: Array) -> Array:
        """The part of g'' without the accelerations, shape (lanes,)."""
        d = v[self.i] - v[self.j]
        drift: Array = product(d, d) / self.length
        return drift


class SurfaceRow(NamedTuple):
    """A point of a molecule on a surface of second order.

        g = sum_k a_k (x_k - c_k)^2 + n . (x - c) - level

    Attributes:
        name: For columns and messages.
        i: Number of the point in the molecule.
        squares: a, shape (3,).
        normal: n, shape (3,).
        center: c, shape (3,).
        level: The value that is held.
        size: What g is compared with: a length of the scene times the size of dg/dx.
    """

    name: str
    i: int
    squares: Array
    normal: Array
    center: Array
    level: float
    size: float

    @property
    def ends(self) -> tuple[tuple[int, float], ...]:
        """The point, and the sign with which the direction pushes it."""
        return ((self.i, 1.0),)

    def direction(self, x: Array) -> Array:
        """dg/dx, shape (3, lanes)."""
        a, n, c = (part[:, None] for part in (self.squares, self.normal, self.center))
        direction: Array = 2.0 * a * (x[self.i] - c) + n
        return direction

    def residual(self, x: Array, direction: Array) -> Array:
        """g, shape (lanes,)."""
        a, n, c = (part[:, None] for part in (self.squares, self.normal, self.center))
        d = x[self.i] - c
        g: Array = product(a * d + n, d) - self.level
        return g

    def rate(self, v: Array, direction: Array) -> Array:
        """g', shape (lanes,)."""
        rate: Array = product(direction, v[self.i])
        return rate

    def drift(self, v: Array) -> Array:
        """The part of g'' without the accelerations, shape (lanes,)."""
        drift: Array = 2.0 * product(self.squares[:, None] * v[self.i], v[self.i])
        return drift


PointRow = DistanceRow | SurfaceRow
_LONGEST = 6  # rows up to which a loop over them costs less than a library call a system
_NEWTON = 25
_ASSEMBLY = 200
_FORESEEN = 1.0e-2  # of the tolerance: what a last correction leaves


class Cluster:
    """Rows of a molecule that are solved for together.

    Args:
        masses: Of all points of the molecule, shape (atoms,).
        at: Positions of the template, shape (atoms, 3).

    Attributes:
        sizes: Of the rows, shape (m,): residuals are compared with multiples of them.
        rank: Rows that are independent at the template.
    """

    def __init__(self, rows: Sequence[PointRow], masses: Array, at: Array) -> None:
        self.rows = tuple(rows)
        self.sizes: Array = np.array([row.size for row in rows])
        self._pushes = [[(i, sign / masses[i]) for i, sign in row.ends] for row in rows]
        self._shares = _shares(rows, masses)
        D = self.directions(at[:, :, None])
        values = np.linalg.eigvalsh(self._metric(D, D)[:, :, 0])
        self.rank = int(np.count_nonzero(values > redundant(len(rows)) * values[-1]))
        self._solve = solved if self.rank == len(rows) else least_solved

    def directions(self, x: Array) -> list[Array]:
        """The direction of each row, shape (3, lanes) each."""
        return [row.direction(x) for row in self.rows]

    def residual(self, x: Array) -> Array:
        """g, shape (m, lanes)."""
        return np.array([row.residual(x, row.direction(x)) for row in self.rows])

    def rate(self, x: Array, v: Array) -> Array:
        """g', shape (m, lanes)."""
        return np.array([row.rate(v, row.direction(x)) for row in self.rows])

    def metric(self, x: Array) -> Array:
        """J M^-1 J', shape (m, m, lanes)."""
        D = self.directions(x)
        return self._metric(D, D)

    def pushed(self, x: Array, lam: Array) -> Array:
        """J' lam, shape (atoms, 3, lanes), of multipliers of shape (m, lanes)."""
        force = np.zeros_like(x)
        for row, D, each in zip(self.rows, self.directions(x), lam, strict=True):
            for i, sign in row.ends:
                force[i] += sign * each * D
        return force

    def multipliers(self, x: Array, v: Array, a: Array) -> Array:
        """The lam with J (a + M^-1 J' lam) + drift = 0, shape (m, lanes).

        Args:
            a: Accelerations without the rows.
        """
        D = self.directions(x)
        pairs = zip(self.rows, D, strict=True)
        right = np.array([row.rate(a, each) + row.drift(v) for row, each in pairs])
        return self._solve(self._metric(D, D), -right)

    def project(self, x: Array, v: Array) -> None:
        """The nearest velocities, in the mass metric, with g' = 0; v is written."""
        D = self.directions(x)
        rate = np.array([row.rate(v, each) for row, each in zip(self.rows, D, strict=True)])
        self._push(v, D, self._solve(self._metric(D, D), -rate))

    def close(self, x: Array, moved: Array, w: Array, h: float, tolerance: float) -> None:
        """Positions moved + M^-1 J(x)' mu with g = 0; `moved`, and w by the change over h, change.

        Newton's method in all lanes at once; a lane that is done stays as it is.

        Args:
            x: Positions whose rows push.
            moved: Positions without multipliers.
            w: Velocities that led there.
            tolerance: |g| in sizes of the rows that may be left. Corrections square |g|, so that
                the last one is known before it is made.

        Raises:
            SolveError: Some rows stay open; names the worst row and its lane.
        """
        before = self.directions(x)
        nearly = sqrt(_FORESEEN * tolerance) if self.rank == len(self.rows) else tolerance
        total, last = np.zeros((len(self.rows), x.shape[2])), np.full(x.shape[2], np.inf)
        is_open = np.ones(x.shape[2], dtype=np.bool_)
        for _ in range(_NEWTON):
            D = self.directions(moved)
            pairs = zip(self.rows, D, strict=True)
            g = np.array([row.residual(moved, each) for row, each in pairs])
            worst = (np.abs(g) / self.sizes[:, None]).max(axis=0)
            if not isfinite(worst.sum()):
                break
            step = is_open * self._solve(self._metric(D, before), -g)
            total += step
            self._push(moved, before, step)
            is_open &= ~((worst <= nearly) | ((worst <= ASSEMBLED) & (worst >= 0.5 * last)))
            if not is_open.any():
                self._push(w, before, total / h)
                return
            last = worst
        self._refuse(g)

    def assemble(self, x: Array) -> None:
        """Moves positions onto the rows, each correction the least one in the mass metric.

        Raises:
            SolveError: The rows cannot all hold near these positions; names the worst one.
        """
        limit, last = BRANCH_STEP * float(self.sizes.min()), np.inf
        for _ in range(_ASSEMBLY):
            D = self.directions(x)
            g = np.array([row.residual(x, each) for row, each in zip(self.rows, D, strict=True)])
            worst = float((np.abs(g).max(axis=1) / self.sizes).max())
            if worst == 0.0 or (worst <= LANDED and worst >= 0.5 * last):
                return
            if not isfinite(worst):
                break
            before, last = x.copy(), worst
            self._push(x, D, self._solve(self._metric(D, D), -g))
            longest = float(np.abs(x - before).max())
            if longest > limit:
                x += (limit / longest - 1.0) * (x - before)
        if not worst <= ASSEMBLED:
            self._refuse(g)

    def _refuse(self, g: Array) -> None:
        row, lane = np.unravel_index(int(np.argmax(np.abs(g))), g.shape)
        raise SolveError(
            f"row {self.rows[row].name}, molecule {lane + 1}: {g[row, lane]:.3g} open"
        )

    def _push(self, out: Array, D: Sequence[Array], amount: Array) -> None:
        """Adds M^-1 J' amount."""
        for pushes, direction, each in zip(self._pushes, D, amount, strict=True):
            along = direction * each
            for i, share in pushes:
                out[i] += share * along

    def _metric(self, D: Sequence[Array], E: Sequence[Array]) -> Array:
        """J M^-1 K' of directions D and E, shape (m, m, lanes)."""
        m = len(self.rows)
        A = np.zeros((m, m, D[0].shape[1]))
        for a, b, share in self._shares:
            np.multiply(product(D[a], E[b]), share, out=A[a, b])
        return A


def _shares(rows: Sequence[PointRow], masses: Array) -> list[tuple[int, int, float]]:
    """The factor of masses for all pairs of rows that share a point."""
    shares = []
    for a, one in enumerate(rows):
        for b, other in enumerate(rows):
            found = [s * t / masses[i] for i, s in one.ends for j, t in other.ends if i == j]
            if found:
                shares.append((a, b, float(sum(found))))
    return shares


def least_solved(A: Array, b: Array) -> Array:
    """The x of smallest norm with A x nearest to b in every lane, where rows are redundant."""
    inverse = np.linalg.pinv(A.transpose(2, 0, 1), rcond=redundant(len(b)))
    least: Array = np.matmul(inverse, b.T[:, :, None])[:, :, 0].T
    return least


def product(a: Array, b: Array) -> Array:
    """Products a . b of vectors side by side, (3, lanes) each, shape (lanes,).

    Written out, so that a lane has the same bits whatever stands beside it.
    """
    sum_: Array = a[0] * b[0]
    sum_ += a[1] * b[1]
    sum_ += a[2] * b[2]
    return sum_


def blocks_of(rows: Sequence[PointRow]) -> list[list[PointRow]]:
    """Rows in blocks that share no point."""
    groups: list[tuple[set[int], list[PointRow]]] = []
    for row in rows:
        points, mine = {i for i, _ in row.ends}, [row]
        for group in [g for g in groups if g[0] & points]:
            groups.remove(group)
            points |= group[0]
            mine = [*group[1], *mine]
        groups.append((points, mine))
    return [mine for _, mine in groups]


def solved(A: Array, b: Array) -> Array:
    """The x with A x = b in every lane; A is regular and nearly symmetric and definite.

    Args:
        A: Shape (m, m, lanes).
        b: Shape (m, lanes).
    """
    m = len(b)
    if m == 1:
        one: Array = b / A[0]
        return one
    if m > _LONGEST:
        many: Array = np.linalg.solve(A.transpose(2, 0, 1), b.T[:, :, None])[:, :, 0].T
        return many
    rows, right = [[A[i, j] for j in range(m)] for i in range(m)], [b[i] for i in range(m)]
    for k in range(m):
        inverse = 1.0 / rows[k][k]
        for i in range(k + 1, m):
            factor = rows[i][k] * inverse
            right[i] = right[i] - factor * right[k]
            for j in range(k + 1, m):
                rows[i][j] = rows[i][j] - factor * rows[k][j]
        rows[k][k] = inverse
    for k in reversed(range(m)):
        for j in range(k + 1, m):
            right[k] = right[k] - rows[k][j] * right[j]
        right[k] = right[k] * rows[k][k]
    return np.array(right)
