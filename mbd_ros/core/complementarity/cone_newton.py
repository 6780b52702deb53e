"""Newton's method for contacts with friction and rows between bounds, all at once.

    w = A p + b
    rows between bounds:  p = [p - w] kept within lower .. upper
    normal of a contact:  p_n = max(p_n - w_n, least)
    its tangents:         p_t = [p_t - w_t] kept within a disc of radius mu max(p_n - w_n, least)

Roots of this natural map are the answers of the laws of Signorini and Coulomb, with round cones.
A has a diagonal of about one. It may be singular: every step is the shortest one. Source:
P. Alart, A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant

Slots = NDArray[np.intp]
_EXACT = 4.0e-16  # of the impulses: nothing is left of the map
_SMALL = 2.0e-15  # the same: rounding, once a step no longer halves it
_ENOUGH = 1.0e-4  # of the decrease that a step promises


class ConeNewton:
    """Solves problems of one A.

    Args:
        A: Rates that impulses add, with a diagonal of about one, shape (m, m).

    Attributes:
        depends: Whether the rows that held in the last step depended on one another, as far as is
            known.
        seen: The map at the last answer.
    """

    seen: Seen

    def __init__(self, A: Array, contacts: Contacts) -> None:
        self.A = A
        self.contacts = contacts
        self.depends = True
        self._places = cone_places(len(A), tuple(contacts.normal.tolist()))

    def damped(self, by: float) -> ConeNewton:
        """Return the same with a part of the identity added to A."""
        return ConeNewton(self.A + by * np.eye(len(self.A)), self.contacts)

    def solve(
        self,
        b: Array,
        bounds: Bounds,
        p: Array,
        steps: int,
        halvings: int = 0,
        enough: float = _EXACT,
    ) -> tuple[Array, float]:
        """Return the best impulses on the way from some, and what is left of the map there.

        Args:
            b: Rates without impulses, shape (m,).
            bounds: What impulses may be.
            p: Where it begins, shape (m,).
            steps: How many there may be.
            halvings: How often a step is halved that does not bring the map nearer to 0.
            enough: What may be left of the map, per size of the impulses.
        """
        seen = self.seen = self.see(b, bounds, p)
        best, smallest = p, math.inf
        for _ in range(steps + 1):
            left, size = largest(seen.left), 1.0 + largest(p)
            ends = left > 0.5 * smallest and left <= _SMALL * size
            if left < smallest:
                best, smallest, self.seen = p, left, seen
            if ends or left <= enough * size or not left < math.inf:
                break
            step = self._step(seen, bounds, p)
            if not math.isfinite(step.dot(step)):
                break
            p, seen = self._along(b, bounds, p, step, seen, halvings)
        return best, smallest

    def see(self, b: Array, bounds: Bounds, p: Array) -> Seen:
        """Return the map at some impulses."""
        others, normal, *_, mu = self.contacts
        w, tangents = self.A.dot(p) + b, self._places.tangents
        z, left, holds = p - w, np.empty(len(p)), np.empty(len(p), dtype=np.bool_)
        if len(others):
            own = z[others]
            inside = np.minimum(np.maximum(own, bounds.lower), bounds.upper)
            left[others], holds[others] = p[others] - inside, inside == own
        push, along = z[normal], z[tangents]
        pushes, push = push > bounds.least, np.maximum(push, bounds.least)
        left[normal], holds[normal] = p[normal] - push, pushes
        length, radius = np.hypot(along[0], along[1]), mu * push
        slips = length > radius
        sticks = ~slips
        length[sticks] = 1.0
        share = radius / length
        share[sticks] = 1.0
        left[tangents], holds[tangents] = p[tangents] - share * along, sticks
        along = along / length
        return Seen(left, w, holds, slips, pushes, along[0], along[1], radius, share)

    def _along(
        self, b: Array, bounds: Bounds, p: Array, step: Array, seen: Seen, halvings: int
    ) -> tuple[Array, Seen]:
        """Return impulses after a step or a part of it, and the map there."""
        after = p + step
        residual = self.see(b, bounds, after)
        if not halvings:
            return after, residual
        size, share = float(seen.left.dot(seen.left)), 1.0
        best, smallest = (after, residual), float(residual.left.dot(residual.left))
        for _ in range(halvings):
            if smallest <= (1.0 - _ENOUGH) * size:
                break
            share *= 0.5
            after = p + share * step
            residual = self.see(b, bounds, after)
            now = float(residual.left.dot(residual.left))
            if not now >= smallest:
                best, smallest = (after, residual), now
        return best

    def _step(self, seen: Seen, bounds: Bounds, p: Array) -> Array:
        """Return the shortest step that Newton's method asks for, shape (m,)."""
        K, r, holds = self.A, seen.w, seen.holds
        if not holds.all():
            K, r = holds[:, None] * K, np.where(holds, r, seen.left)
            K.ravel()[:: len(r) + 1] += ~holds
            at = seen.slips.nonzero()[0]
            if len(at):
                self._slide(K, r, seen, bounds, p, at)
        step, rank = shortest(K, r)
        self.depends = rank < len(r)
        return -step

    def _slide(self, K: Array, r: Array, seen: Seen, bounds: Bounds, p: Array, at: Slots) -> None:
        """Rows of contacts that slip: along their friction, then across it."""
        _, n, first, second, mu = self.contacts
        x, y, share, pushes, least = seen.x, seen.y, seen.share, seen.pushes, bounds.least
        along, across, A = self._places.friction, self._places.turns, self.A
        if len(at) < len(mu):
            n, first, second = n[at], first[at], second[at]
            along, across = along[:, at], across[:, at]
            mu, least, x, y, share, pushes = mu[at], least[at], x[at], y[at], share[at], pushes[at]
        entries = K.ravel()
        entries[along] = (np.where(pushes, -mu, 0.0), x, y)
        r[first] = x * p[first] + y * p[second] - mu * np.where(pushes, p[n], least)
        stays = 1.0 - share
        K[second] = (share * x)[:, None] * A[second] - (share * y)[:, None] * A[first]
        entries[across] += (-stays * y, stays * x)
        r[second] = x * p[second] - y * p[first]


def largest(values: Array) -> float:
    """Return the largest size among some numbers, NaN where one is none."""
    return float(np.maximum.reduce(np.abs(values)))  # as `max`, for less time


def shortest(K: Array, r: Array) -> tuple[Array, int]:
    """Return x of smallest norm with K x nearest to r, and the rank of K."""
    factor = eigenpy.CompleteOrthogonalDecomposition(*K.shape)
    factor.setThreshold(redundant(len(r)))
    factor.compute(K)
    return factor.solve(r).reshape(K.shape[1]), int(factor.rank())


class Contacts(NamedTuple):
    """Which rows of a problem are what.

    Attributes:
        others: Rows between bounds.
        normal: Normals, shape (n,).
        first: The first tangents, shape (n,).
        second: The second ones.
        mu: Coefficients of friction, shape (n,).
    """

    others: Slots
    normal: Slots
    first: Slots
    second: Slots
    mu: Array


class Bounds(NamedTuple):
    """Bounds of impulses.

    Attributes:
        lower: Smallest ones of rows between bounds, shape (k,).
        upper: Their largest ones.
        least: Smallest normal ones, >= 0, shape (n,).
    """

    lower: Array
    upper: Array
    least: Array


class Seen(NamedTuple):
    """The natural map at some impulses.

    Attributes:
        left: p less what the map makes of it, shape (m,).
        w: Rates, shape (m,).
        holds: Rows whose w has to be 0, those of the tangents that stick among them.
        slips: Contacts whose friction is the largest.
        pushes: Contacts with p_n - w_n above the least.
        x: First component of the direction of friction of every contact.
        share: Radius over the length of p_t - w_t, at most 1.
    """

    left: Array
    w: Array
    holds: NDArray[np.bool_]
    slips: NDArray[np.bool_]
    pushes: NDArray[np.bool_]
    x: Array
    y: Array
    radius: Array
    share: Array


class ConePlaces(NamedTuple):
    """Places of n contacts.

    Attributes:
        tangents: Their rows, shape (2, n).
        friction: Entries of a matrix, counted row by row: the columns of a contact in the row of
            its first tangent, shape (3, n).
        turns: The same: columns of both tangents in the row of the second one, shape (2, n).
    """

    tangents: NDArray[np.intp]
    friction: NDArray[np.intp]
    turns: NDArray[np.intp]


@lru_cache(64)
def cone_places(m: int, normals: tuple[int, ...]) -> ConePlaces:
    """Places of contacts whose normals, with two tangents behind each, stand among m rows."""
    normal = np.array(normals, dtype=np.intp)
    first, second = normal + 1, normal + 2
    friction = np.stack((first * m + normal, first * (m + 1), first * m + second))
    turns = np.stack((second * m + first, second * (m + 1)))
    return ConePlaces(np.stack((first, second)), friction, turns)


def active_set(contacts: Contacts, bounds: Bounds, seen: Seen, p: Array) -> Array:
    """Impulses within their bounds and cones, fresh; those of rows that do not hold are at one."""
    others, normal, first, second, mu = contacts
    p = p.copy()
    own = np.where(seen.holds[others], p[others], p[others] - seen.w[others])
    p[others] = np.minimum(np.maximum(own, bounds.lower), bounds.upper)
    p[normal] = np.where(seen.pushes, np.maximum(p[normal], bounds.least), bounds.least)
    length, most = np.hypot(p[first], p[second]), mu * p[normal]
    share = np.divide(most, length, out=np.ones(len(mu)), where=length > most)
    p[first], p[second] = share * p[first], share * p[second]
    return p
