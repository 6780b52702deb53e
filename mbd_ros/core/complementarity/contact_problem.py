"""Impulses of contacts with friction beside those of rows between bounds, exactly.

    w = A p + b
    contacts:             p_n >= least,   w_n >= 0,   (p_n - least) w_n = 0,   |p_t| <= mu p_n
                          w_t = -alpha p_t,   alpha >= 0,   alpha = 0 where |p_t| < mu p_n
    rows between bounds:  lower <= p <= upper, w = 0 inside, w >= 0 at lower, w <= 0 at upper

The laws are those of Signorini and Coulomb, the cones are round. p may be impulses and w
velocities, or forces and accelerations. A may be singular, as four feet of one box make it: p is
then of least norm. It is not symmetric where rows push along other directions than they hold.
Every answer is checked by what it leaves of the laws.

`ContactProblem` solves one contact by itself, `ScaledContacts` several: it gives every row the
unit of its own rate, so that A has a diagonal of about one (the coefficients of friction change
with the units), and `searched` tries several ways, from the fastest to the one that finds most.
Newton's method begins with the impulses of an earlier step, or none. Where it does not end, it
follows the answers of A + s I from s = 1 to 0. Then sweeps over the contacts, each solved exactly
by itself, and then random impulses give it a start. Source: V. Acary, M. Brémond, O. Huber, On
solving contact problems with Coulomb friction: formulations and numerical comparisons, 2017.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.complementarity.cone_newton import (
    Bounds,
    ConeNewton,
    Contacts,
    Seen,
    active_set,
    shortest,
)
from mbd_ros.core.complementarity.contact_cone import cone_contact, cone_residuals
from mbd_ros.core.rows.constraint_rows import Cone
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, HELD_BY_ROWS, TINY, redundant
from mbd_ros.errors import SolveError

_NONE = 1.0e-11  # of the impulses: a rate that is none
_BEYOND = 1.0e-12  # of the impulses: how far beyond a cone counts as within
_SAME = 1.0e-13  # of the impulses: what may be left of A p = A p_0
_NEAREST_STEPS = 40
_NEAREST_HALVINGS = 20
_NEAREST_ENOUGH = 1.0e-4  # of the decrease that a step promises
_STEPS = 20  # of Newton's method from one start
_MANY = 200  # the same from the best impulses
_HALVINGS = 4  # of a step that does not bring the map nearer to 0
_FALLS = 0.5  # of the damping of A along a path
_LEAST = 1.0e-11  # damping at which a path ends
_NEAR = 1.0e-13  # left of the map on a path: less than what rows contradict one another
_SWEEPS = 5, 50
_STARTS = 40  # random ones
_PATHS = 20  # from random impulses
_SIZES = -1.0, 2.0  # of random impulses, as powers of ten
_LARGE = 1.0e4  # impulses in units of the rates that they end
_USUAL = 4  # starts, before those that find answers to hard problems alone
_SEED = 0  # the same problem has the same answer
_ENOUGH = 1.0e-14  # of the impulses: what an answer may leave of the natural map
EXACT = 1.0e-11  # the same of the best one that any way finds, unless more is accepted
_POLISH = 3  # steps, where impulses of least norm are not as exact
_ROUNDING = 1.0e-14  # of a rate, relative to those that the velocity can mean
_NOTHING = 1.0e-15  # the same of rates that no impulse has to end
_SLACK = 1.0e-11  # of a rate of one contact, relative to those that the velocity can mean


class ContactProblem:
    """Solves the problem above for one configuration.

    Args:
        A: Rates that impulses add, shape (m, m).
        loose: Diagonal of A while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
        cones: The contacts among them, by their slots; the other rows have bounds.
    """

    def __init__(
        self, A: Array, loose: Array, names: Sequence[str], cones: Sequence[Cone]
    ) -> None:
        self._A = A
        self._loose = loose
        self._names = names
        self._cones = cones
        is_one = len(A) == 3 and len(cones) == 1
        self._is_one = is_one and float(A[0, 0]) > HELD_BY_ROWS * float(loose[0])
        self._problem: ScaledContacts | None = None
        self._answered: tuple[Array, ...] = ()

    def solve(
        self,
        b: Array,
        lower: Array,
        upper: Array,
        speed: float,
        late: Array | None = None,
        warm: Array | None = None,
        *,
        shared: bool = True,
        accepted: float = EXACT,
    ) -> Array:
        """Return the impulses, shape (m,), fresh.

        Args:
            b: Rates without them, shape (m,).
            lower: Smallest impulses, those of normals among them, shape (m,).
            upper: Largest ones of rows between bounds, shape (m,).
            speed: Velocity in the mass metric, which no rate exceeds by much.
            late: What rates have more in the laws than in b, shape (m,): 0 but at tangents, where
                friction is against the slip of another time.
            warm: Impulses to begin with, shape (m,); none by default.
            shared: Whether impulses that depend on one another are those of least norm, which
                takes as long as the answer; else they are any that do the same.
            accepted: What the best impulses may leave of the laws where none are found that leave
                rounding alone, of the largest rate without them.

        Raises:
            SolveError: Nothing keeps a row from moving as it must not, or no impulses are found.
        """
        if late is not None:
            b = b + late
        if self._is_one:
            rounding = _SLACK * speed * math.sqrt(self._loose[0])
            p = cone_contact(self._A, b, self._cones[0].mu, float(lower[0]), rounding)
        elif self._opens(b, lower):
            p = np.zeros(len(b))
        else:
            p = self._scaled().solve(b, lower, upper, speed, warm, accepted, shared=shared)
        self._answered = p, b, lower, upper
        return p

    def pushing(self, b: Array, speed: float, least: Array | None = None) -> Array:
        """Return the impulses of contacts and of rows that only push.

        Args:
            b: As for `solve`.
            speed: As for `solve`.
            least: What they push at least, shape (m,); 0 by default.

        Raises:
            SolveError: As for `solve`.
        """
        none = np.zeros(len(b))
        return self.solve(b, none if least is None else least, none + np.inf, speed)

    @property
    def residuals(self) -> Residuals:
        """Return the residuals of the laws in the last solution, 0 for rows that nothing moves."""
        p, b, lower, upper = self._answered
        if self._is_one:
            return Residuals(*cone_residuals(self._A, b, p, self._cones[0].mu, float(lower[0])))
        beyond, over = np.maximum(lower - p, p - upper), 0.0
        for cone in self._cones:
            normal, first, second = p[cone.slots].tolist()
            beyond[cone.slots.start + 1 : cone.slots.stop] = 0.0
            over = max(over, math.hypot(first, second) - cone.mu * normal)
        primal, correction = self._scaled().left(p, b, lower, upper)
        return Residuals(primal, max(float(beyond.max(initial=0.0)), 0.0), over, correction)

    def _opens(self, b: Array, lower: Array) -> bool:
        """Whether contacts alone are left without impulses."""
        if len(b) != 3 * len(self._cones) or lower.any():
            return False
        rates: list[float] = b.tolist()
        return all(rates[cone.slots.start] >= 0.0 for cone in self._cones)

    def _scaled(self) -> ScaledContacts:
        if self._problem is None:
            given = self._A, self._loose, self._names, self._cones
            self._problem = ScaledContacts(*given)
        return self._problem


class Residuals(NamedTuple):
    """How far impulses are from the laws, recomputed from them.

    Attributes:
        primal: Largest rate that the laws of normals and of rows between bounds forbid [m/s].
        dual: Largest impulse beyond its bounds [N·s].
        cone: Largest friction beyond its cone [N·s].
        correction: Largest slip that is not against its friction, or that friction inside of its
            cone leaves [m/s].
    """

    primal: float
    dual: float
    cone: float
    correction: float


class ScaledContacts:
    """Several contacts and bounded rows, each in the unit of its own rate.

    Rows that nothing moves exert what their bounds say and change nothing, and where nothing moves
    a normal there is no friction.

    Args:
        A: Rates that impulses add, shape (m, m).
        loose: Diagonal of A while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
        cones: The contacts among them.
    """

    def __init__(
        self, A: Array, loose: Array, names: Sequence[str], cones: Sequence[Cone]
    ) -> None:
        self._loose = loose
        self._names = names
        mobile = A.diagonal() > HELD_BY_ROWS * loose
        self._moves = moves = mobile.copy()
        self._pulls_nothing = np.zeros(len(A), dtype=np.bool_)
        for cone in cones:
            moves[cone.slots] = mobile[cone.slots.start]
            self._pulls_nothing[cone.slots.start + 1 : cone.slots.stop] = True
        self._at = moves.nonzero()[0]
        place = moves.cumsum() - 1
        at = self._at
        moved = [cone for cone in cones if moves[cone.slots.start]]
        normal = place[[cone.slots.start for cone in moved]].astype(np.intp)
        first, second = normal + 1, normal + 2
        size = np.where(mobile, A.diagonal(), 0.0)[at]
        tangent = np.maximum(size[first], size[second])
        is_free = tangent == 0.0  # nothing moves it along its plane
        size[first] = size[second] = np.where(is_free, 1.0, tangent)
        self._unit = unit = 1.0 / np.sqrt(size)
        mu = np.array([cone.mu for cone in moved]) * unit[normal] / unit[first]
        is_other = np.ones(len(at), dtype=np.bool_)
        is_other[normal] = is_other[first] = is_other[second] = False
        others = is_other.nonzero()[0]
        contacts = Contacts(others, normal, first, second, np.where(is_free, 0.0, mu))
        self._newton = ConeNewton(unit[:, None] * A.take(at, 0).take(at, 1) * unit, contacts)

    def solve(
        self,
        b: Array,
        lower: Array,
        upper: Array,
        speed: float,
        warm: Array | None,
        accepted: float,
        *,
        shared: bool,
    ) -> Array:
        """Return the impulses, shape (m,), fresh.

        Args:
            b: Rates without impulses, shape (m,).
            lower: Smallest impulses, shape (m,).
            upper: Largest ones, shape (m,).
            speed: Velocity in the mass metric.
            warm: Impulses to begin with, shape (m,).
            accepted: What an answer may leave of the laws where none leaves rounding alone.
            shared: Whether those that depend on one another are of least norm.

        Raises:
            SolveError: Nothing keeps a row from closing, or no impulses are found.
        """
        answer = self._unmoved(b, lower, upper, speed)
        if not len(self._at):
            return answer
        at, unit = self._at, self._unit
        b, least = unit * b[at], self._bounds(lower, upper, unit).least
        size = max(float(np.abs(b).max()), float(least.max(initial=0.0)), speed * _NOTHING, TINY)
        unit = size * unit
        b, bounds = b / size, self._bounds(lower, upper, unit)
        start = np.zeros(len(at)) if warm is None else warm[at] / unit
        enough = _ENOUGH + _ROUNDING * speed / size
        p, left = searched(self._newton, b, bounds, start, (enough, accepted))
        if left > enough:
            self._newton.seen = self._newton.see(b, bounds, p)
        if left > max(accepted, enough):
            raise SolveError(self._failed())
        p = active_set(self._newton.contacts, bounds, self._newton.seen, p)
        if shared and self._newton.depends and p.any():
            p = self._shortest(b, bounds, p)
        answer[at] = unit * p
        return answer

    def _unmoved(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """Return impulses of rows that nothing moves; 0 for the others."""
        p = np.zeros(len(b))
        if len(self._at) == len(b):
            return p
        length = np.sqrt(np.where(self._loose > 0.0, self._loose, 1.0))
        none = self._moves | self._pulls_nothing
        none |= np.abs(b) <= CONTRADICTION * length * speed
        p = np.where(none, 0.0, np.where(b < 0.0, upper, lower))
        if not np.isfinite(p).all():
            name = self._names[int(np.isfinite(p).argmin())]
            raise SolveError(f"nothing can keep constraint row {name} from closing")
        return p

    def _shortest(self, b: Array, bounds: Bounds, p: Array) -> Array:
        """Return the impulses of least norm that do what p does."""
        newton = self._newton
        seen = newton.seen
        exact = _ENOUGH * (1.0 + float(np.abs(p).max()))
        most = max(exact, float(np.abs(seen.left).max()))
        impulses = least_impulses(newton, seen, bounds, p, self._unit)
        left = float(np.abs(newton.see(b, bounds, impulses).left).max())
        if left > most:
            impulses, left = newton.solve(b, bounds, impulses, _POLISH)
            impulses = active_set(newton.contacts, bounds, newton.seen, impulses)
        return impulses if left <= most else p

    def left(self, p: Array, b: Array, lower: Array, upper: Array) -> tuple[float, float]:
        """Return the residuals of the laws: of normals and bounded rows, and of slips [m/s]."""
        at, unit, contacts = self._at, self._unit, self._newton.contacts
        if not len(at):
            return 0.0, 0.0
        seen = self._newton.see(unit * b[at], self._bounds(lower, upper, unit), p[at] / unit)
        rates = np.abs(seen.left) / unit
        slips = np.hypot(rates[contacts.first], rates[contacts.second])
        rates[contacts.first] = rates[contacts.second] = 0.0
        return float(rates.max()), float(slips.max(initial=0.0))

    def _bounds(self, lower: Array, upper: Array, unit: Array) -> Bounds:
        at, contacts = self._at, self._newton.contacts
        lower, upper = lower[at] / unit, upper[at] / unit
        return Bounds(lower[contacts.others], upper[contacts.others], lower[contacts.normal])

    def _failed(self) -> str:
        """Return what is wrong with the best impulses."""
        off = np.abs(self._newton.seen.left)
        worst, left = self._names[self._at[int(off.argmax())]], float(off.max())
        return (
            f"no impulses are found for contacts and the rows beside them: the best ones leave "
            f"{left:.1e} of the rates, most at row {worst}"
        )


def searched(
    newton: ConeNewton, b: Array, bounds: Bounds, start: Array, enough: tuple[float, float]
) -> tuple[Array, float]:
    """Return the best impulses of all ways, and what they leave of the natural map.

    What is left counts per size of the impulses, which round it, but impulses without bound, as
    those of contacts that contradict one another, excuse nothing.

    Args:
        b: Rates without impulses, shape (m,), of the order of 1.
        bounds: What impulses may be.
        start: Impulses to begin with, shape (m,).
        enough: What may be left, and what may where neither Newton's method nor sweeps end.
    """
    best, smallest = start, np.inf
    for tried, (near, steps) in enumerate(_starts(newton, b, bounds, start)):
        for halvings in (0, _HALVINGS):
            p, left = newton.solve(b, bounds, best if near is None else near, steps, halvings)
            left /= 1.0 + min(float(np.abs(p).max()), _LARGE)
            if left < smallest:
                best, smallest = p, left
            if smallest <= (max(enough) if tried > _USUAL else enough[0]):
                return best, smallest
    return best, smallest


def _starts(
    newton: ConeNewton, b: Array, bounds: Bounds, start: Array
) -> Iterator[tuple[Array | None, int]]:
    """Where to begin, None for the best impulses so far, and how many steps there may be."""
    none = np.zeros(len(b))
    yield start, _STEPS
    if start.any():
        yield none, _STEPS
    yield _followed(newton, b, bounds, none, 1.0), _STEPS
    swept = none
    for sweeps in _SWEEPS:
        swept = _swept(newton, b, bounds, swept, sweeps)
        yield swept, _STEPS
    yield None, _MANY
    random = np.random.default_rng(_SEED)
    for _ in range(_STARTS):
        yield _random(newton, random), _STEPS
    yield None, _MANY
    for _ in range(_PATHS):
        near = _random(newton, random)
        yield _followed(newton, b, bounds, near, 10.0 ** random.uniform(-3.0, 0.0)), _STEPS
    yield None, _MANY


def _followed(newton: ConeNewton, b: Array, bounds: Bounds, p: Array, damping: float) -> Array:
    """Return impulses at the end of the answers of A + s I, s from a damping to 0."""
    while damping > _LEAST:
        p, _ = newton.damped(damping).solve(b, bounds, p, _STEPS, _HALVINGS, _NEAR)
        damping *= _FALLS
    return p


def _swept(newton: ConeNewton, b: Array, bounds: Bounds, p: Array, sweeps: int) -> Array:
    """Return impulses after some sweeps over the rows, each contact solved by itself."""
    A, contacts, p = newton.A, newton.contacts, p.copy()
    rows = list(zip(contacts.others.tolist(), bounds.lower, bounds.upper, strict=True))
    places = zip(contacts.normal.tolist(), contacts.mu.tolist(), bounds.least, strict=True)
    cones = [(slice(i, i + 3), mu, float(least)) for i, mu, least in places]
    for _ in range(sweeps):
        for i, low, high in rows:
            p[i] = min(max(p[i] - (A[i].dot(p) + b[i]) / A[i, i], low), high)
        for at, mu, least in cones:
            own = A[at, at]
            rate = A[at].dot(p) + b[at] - own.dot(p[at])
            try:
                p[at] = cone_contact(own, rate, mu, least)
            except SolveError:  # it stays, and the others move it out of where it has no answer
                continue
    return p


def _random(newton: ConeNewton, random: np.random.Generator) -> Array:
    """Return impulses of any size, friction within its cones."""
    _, normal, first, second, mu = newton.contacts
    p = np.asarray(random.normal(size=len(newton.A)) * 10.0 ** random.uniform(*_SIZES))
    p[normal] = np.abs(p[normal])
    turn, share = random.uniform(0.0, 2.0 * math.pi, len(mu)), random.uniform(size=len(mu))
    p[first] = share * mu * p[normal] * np.cos(turn)
    p[second] = share * mu * p[normal] * np.sin(turn)
    return p


def least_impulses(newton: ConeNewton, seen: Seen, bounds: Bounds, p: Array, unit: Array) -> Array:
    """Return the impulses of least norm that do what p does; p itself where they are not found.

        min |p|^2   subject to   A p = A p_0,   p within its bounds and cones

    The slips are those of p_0, so that friction of a contact that slips goes with its normal.
    Where the shortest p of all that do the same is beyond a bound or a cone, Newton's method
    solves the dual problem: p is then the projection onto bounds and cones of a vector that A p
    sees. Source: H. Qi, D. Sun, SIAM J. Matrix Anal. Appl. 28 (2006) 360.

    Args:
        seen: The natural map of the problem at p.
        bounds: What impulses may be.
        p: An answer, shape (m,).
        unit: Of the impulses, shape (m,): the norm is that of unit p.
    """
    shares = _shares(newton, seen, bounds, p, unit)
    columns, impulses = _columns(shares, len(p)), unit * p
    count, does = columns.shape[1], newton.A.dot(columns / unit[:, None])
    if not count:
        return p
    sought = columns.T.dot(impulses)
    shares_of_all, rank = shortest(does, does.dot(sought))
    if rank == count:
        return p
    size = float(np.abs(impulses).max())
    target = impulses + columns.dot(shares_of_all - sought)
    within = _nearest(shares, impulses, target)
    if np.abs(within - target).max() > _BEYOND * size:
        basis = np.linalg.qr(columns.dot(_null(does)))[0]
        found = _projected(shares, basis, impulses / size, target / size)
        if found is None:
            return p
        within = size * found
    return within / unit


def _shares(newton: ConeNewton, seen: Seen, bounds: Bounds, p: Array, unit: Array) -> _Shares:
    contacts, none = newton.contacts, _NONE * (1.0 + float(np.abs(p).max()))
    w, units = seen.w.tolist(), unit.tolist()
    rows = [
        (i, units[i] * low, units[i] * high)
        for i, low, high in zip(
            contacts.others.tolist(), bounds.lower.tolist(), bounds.upper.tolist(), strict=True
        )
        if abs(w[i]) <= none
    ]
    sticks, slides = list[tuple[int, float, float]](), list[tuple[int, float, Array]]()
    normal, mus, leasts = (each.tolist() for each in (contacts.normal, contacts.mu, bounds.least))
    for c, (i, mu, least) in enumerate(zip(normal, mus, leasts, strict=True)):
        if abs(w[i]) > none:
            continue
        least, mu = units[i] * least, mu * units[i + 1] / units[i]
        slip = math.hypot(w[i + 1], w[i + 2])
        if slip <= none and mu > 0.0:
            sticks.append((i, least, mu))
            continue
        x, y = float(seen.x[c]), float(seen.y[c])
        if not seen.slips[c]:
            x, y = -w[i + 1] / max(slip, none), -w[i + 2] / max(slip, none)
        length = math.hypot(1.0, mu)
        slides.append((i, least, np.array((1.0 / length, mu * x / length, mu * y / length))))
    return _Shares(rows, sticks, slides)


class _Shares(NamedTuple):
    """Which impulses may change, in units of the norm.

    Attributes:
        rows: Rows between bounds that hold, with their bounds.
        sticks: Contacts that stick: the normal, its least impulse, the coefficient of friction.
        slides: Those that slip: the same, with a direction of length one.
    """

    rows: list[tuple[int, float, float]]
    sticks: list[tuple[int, float, float]]
    slides: list[tuple[int, float, Array]]


def _columns(shares: _Shares, m: int) -> Array:
    """Return impulses that may change, one a column, shape (m, k)."""
    own = [i for i, *_ in shares.rows] + [i + j for i, *_ in shares.sticks for j in range(3)]
    columns = np.zeros((m, len(own) + len(shares.slides)))
    columns[own, range(len(own))] = 1.0
    for column, (i, _, along) in enumerate(shares.slides, start=len(own)):
        columns[i : i + 3, column] = along
    return columns


def _nearest(shares: _Shares, impulses: Array, y: Array) -> Array:
    """The point of all bounds and cones that is nearest to y; impulses that stay are given."""
    p = impulses.copy()
    for i, low, high in shares.rows:
        p[i] = min(max(float(y[i]), low), high)
    for i, least, mu in shares.sticks:
        p[i : i + 3] = nearest_in_cone(y[i : i + 3], mu, least)[0]
    for i, least, along in shares.slides:
        p[i : i + 3] = max(float(along.dot(y[i : i + 3])), least / float(along[0])) * along
    return p


def _null(B: Array) -> Array:
    """Return what B makes nothing of, one a column."""
    _, values, right = np.linalg.svd(B)
    rank = int((values > redundant(len(B)) * values.max(initial=0.0)).sum())
    null: Array = right[rank:].T
    return null


def _projected(shares: _Shares, basis: Array, impulses: Array, y: Array) -> Array | None:
    """Return the shortest impulses within bounds and cones that do the same; None where not found.

    Args:
        shares: Which impulses may change.
        basis: Changes that do nothing, orthonormal, shape (m, k).
        impulses: Impulses, of the order of 1.
        y: Where to begin.
    """
    seen = np.eye(len(y)) - basis.dot(basis.T)

    def height(y: Array, p: Array) -> float:
        return float(0.5 * (y.dot(y) - (y - p).dot(y - p)) - y.dot(impulses))

    p = _nearest(shares, impulses, y)
    for _ in range(_NEAREST_STEPS):
        left = seen.dot(p - impulses)
        if np.abs(left).max() <= _SAME:
            return p
        step = -shortest(seen.dot(_slope(shares, y)).dot(seen), left)[0]
        before, falls, share = height(y, p), float(left.dot(step)), 1.0
        for _ in range(_NEAREST_HALVINGS):
            after = y + share * step
            p = _nearest(shares, impulses, after)
            if height(after, p) <= before + _NEAREST_ENOUGH * share * falls:
                break
            share *= 0.5
        y = after
    return None


def _slope(shares: _Shares, y: Array) -> Array:
    """Return the derivative of `_nearest` by y, shape (m, m)."""
    D = np.zeros((len(y), len(y)))
    for i, low, high in shares.rows:
        D[i, i] = 1.0 if low < y[i] < high else 0.0
    for i, least, mu in shares.sticks:
        D[i : i + 3, i : i + 3] = nearest_in_cone(y[i : i + 3], mu, least)[1]
    for i, least, along in shares.slides:
        if along[0] * along.dot(y[i : i + 3]) > least:
            D[i : i + 3, i : i + 3] = np.outer(along, along)
    return D


def nearest_in_cone(y: Array, mu: float, least: float = 0.0) -> tuple[Array, Array]:
    """Return the nearest p with p_n >= least, |p_t| <= mu p_n, and its derivative by y.

    Args:
        y: A normal and two tangents, shape (3,).
        mu: Coefficient of friction, > 0.
        least: Smallest normal, >= 0.
    """
    n, length = float(y[0]), math.hypot(y[1], y[2])
    share, is_inside = 1.0 / (1.0 + mu * mu), length <= mu * n
    normal = n if is_inside else max((n + mu * length) * share, 0.0)
    if is_inside and normal >= least:
        return y.copy(), np.eye(3)
    slope = np.zeros((3, 3))
    if normal == least == 0.0:
        return np.zeros(3), slope
    d = y[1:] / length if length > 0.0 else np.zeros(2)
    across = np.array((-d[1], d[0]))
    if normal >= least:
        edge = np.array((1.0, *(mu * d)))
        slope = share * np.outer(edge, edge)
        slope[1:, 1:] += mu * normal / length * np.outer(across, across)
        return normal * edge, slope
    most = mu * least
    if length <= most:
        slope[1:, 1:] = np.eye(2)
        return np.array((least, *y[1:])), slope
    slope[1:, 1:] = most / length * np.outer(across, across)
    return np.array((least, *(most * d))), slope
