"""Nonlinear program of the excitations of least cost that explain a known motion.

Unknown are activations, excitations, efforts of reserves, and beside elastic tendons lengths and
speeds of fibres, at Radau's points of each interval:

    min sum integral (w_i e_i^p + s_i (a_i - measured_i)^2) + sum integral |r_j|^p
        + sum tau_i w_i a_i(0)^p
    a' = rate(e, a),   l' = v,   tendon(L, l) = (active(a, l, v) + passive(l) + damping(v)) cos
    sum_i B_i F_i + sum_j R_j r_j = tau

The motion is known, so lengths L and moment arms B of the paths and the forces tau are numbers; so
are the strengths of muscles beside rigid tendons, whose tension is affine in the activation. The
last sum is the price of the excitation before the start, over the time constant of falling
activation: without it muscles would start with any activation that is of use.

Source: F. De Groote et al., Ann. Biomed. Eng. 44, 2016, 2922-2936, doi:10.1007/s10439-016-1591-9.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics
from mbd_ros.compiled.symbols.scalar import Scalar, plain
from mbd_ros.core.muscles.contraction import Contraction, Fiber, Pennation
from mbd_ros.core.muscles.muscle import ActivationDynamics, Muscle
from mbd_ros.core.state import Array
from mbd_ros.features.muscles.muscle_trial import Excited, Optimal, Trial
from mbd_ros.optimal_control.ipopt import SolverResult, solve
from mbd_ros.optimal_control.mesh import Collocation
from mbd_ros.optimal_control.sparse_program import Block, Form, Places, SparseProgram

_ROUNDED = 1.0e-3  # smoothing of the kink of a price at 0
_FASTEST = 3.0  # speed of fibres, per largest speed
_LONGEST = 2.0  # fibres, per optimal length
_SHORTEST = 0.05  # per optimal length, where fibres may be as short as they like
_USUAL_EXCITATION = 0.05  # scale of prices
_ROOM = 0.1  # slack of activation bounds beyond those of excitations, to save iterations
_OPTIONS = {  # rows and unknowns are scaled already: more scaling only takes time
    "mu_init": 0.01,
    "min_refinement_steps": 0,
    "mumps_mem_percent": 100,
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
    "mumps_pivot_order": 2,
}
_NEAR_OPTIONS = {  # for a guess that is nearly the optimum
    "mu_strategy": "monotone",
    "mu_init": 1.0e-4,
    "bound_push": 1.0e-5,
    "bound_frac": 1.0e-5,
}


class MuscleProgram:
    """The nonlinear program of one trial.

    Args:
        muscles: At least one muscle.
        trial: Known quantities at the points.
        scheme: Collocation whose last point is the end of an interval.
        exponent: Exponent of the cost.
        part: The intervals that are solved; None for all.
    """

    def __init__(
        self,
        muscles: Sequence[Muscle],
        trial: Trial,
        scheme: Collocation,
        exponent: float,
        part: Part | None = None,
    ) -> None:
        self._muscles, self._trial, self._scheme = tuple(muscles), trial, scheme
        self._elastic = [i for i, muscle in enumerate(muscles) if muscle.is_elastic]
        self._n, self._ne = len(muscles), len(self._elastic)
        self._r = trial.columns.shape[2] - self._n
        self._each = 2 * self._n + self._r + 2 * self._ne  # unknowns at a point
        self._exponent = exponent
        self._first = self._n + self._ne  # unknowns at the start
        self._points = len(trial.length) - 1
        every = np.ones(len(trial.widths), dtype=bool)
        self._part = part or Part(every, np.zeros((len(every), self._first)))
        self._blocks = MuscleBlocks(self._muscles, trial, scheme, exponent, self._part)

    def solve(self, guess: Excited, accuracy: float, most: int, is_near: bool) -> Optimal:
        """Find the optimum.

        Args:
            guess: Start of the search.
            accuracy: Accepted residual of the optimality conditions.
            most: Largest number of iterations.
            is_near: Whether the guess is nearly the optimum.
        """
        lower, upper = self._bounds()
        points = np.hstack(guess)[1:]
        first = guess.activation[0], guess.fiber_length[0]
        start = np.concatenate((*first, points.ravel()))
        is_open = np.repeat(self._part.solved, self._scheme.degree * self._each)
        is_open = np.concatenate((np.full(self._first, self._part.solved[0]), is_open))
        known = np.where(is_open, np.nan, start)
        start = np.where(is_open, np.clip(start, lower, upper), start)
        curvature = self._trial.prices * np.maximum(guess.activation, _USUAL_EXCITATION) ** (
            self._exponent - 2.0
        )
        cost_size = float(self._trial.widths.sum() * curvature.mean()) / self._points
        program = SparseProgram(self._blocks.all(), self._sizes(), known, cost_size)
        settings: dict[str, Any] = {"accuracy": accuracy, "most": most, "is_near": is_near}
        settings["options"] = {**_OPTIONS, **(_NEAR_OPTIONS if is_near else {})}
        return self._optimal(solve(program, start, lower, upper, **settings), program)

    def _optimal(self, solution: SolverResult, program: SparseProgram) -> Optimal:
        n, r, ne = self._n, self._r, self._ne
        a, lengths = np.split(solution.x[: self._first], (n,))
        points = solution.x[self._first :].reshape(-1, self._each)
        start = np.concatenate((a, a, np.zeros(r), lengths, np.zeros(ne)))
        parts = np.split(np.vstack((start, points)), np.cumsum([n, n, r, ne]), axis=1)
        off, forces = np.abs(solution.rows / program.row_sizes), program.slices[-1]
        lacking = np.zeros_like(self._trial.needed[1:])
        at = np.repeat(self._part.solved, self._scheme.degree)
        lacking[at] = off[forces].reshape(-1, lacking.shape[1])
        residual = max(solution.violation, solution.stationarity)
        excited, falling = Excited(*parts), np.array([m.dynamics.falling for m in self._muscles])
        cost = self._trial.cost(excited, self._scheme.b, falling, self._exponent)
        how = cost, solution.iterations, solution.is_good, solution.status, residual
        return Optimal(excited, *how, lacking, self._slopes(solution, program))

    def _slopes(self, solution: SolverResult, program: SparseProgram) -> Array:
        """Return the slopes of `Part`, with new ones for the intervals that were solved."""
        slopes, solved = self._part.slopes.copy(), np.flatnonzero(self._part.solved)
        of_start = start_slopes(self._scheme)
        columns = [*self._blocks.kinds, [*range(self._n, self._first)]]
        named = zip(program.blocks, program.slices, strict=True)
        moving = [rows for block, rows in named if block.name in ("activations", "fibers")]
        for rows, some in zip(moving, columns, strict=False):  # no fibres, no rows
            forces = solution.row_forces[rows].reshape(len(solved), len(some), -1)
            slopes[np.ix_(solved, some)] = forces @ of_start
        return slopes

    def _sizes(self) -> Array:
        """Return the characteristic sizes of the unknowns; for fibres their optimal length."""
        lengths = [self._muscles[i].contraction.optimal for i in self._elastic]
        point = np.ones(self._each)
        point[2 * self._n + self._r :][: self._ne] = lengths
        return np.concatenate((np.ones(self._n), lengths, np.tile(point, self._points)))

    def _bounds(self) -> tuple[Array, Array]:
        n, ne, trial = self._n, self._ne, self._trial
        laws = [self._muscles[i].contraction for i in self._elastic]
        least = np.array([muscle.dynamics.least for muscle in self._muscles], dtype=np.float64)
        shortest = [max(law.pennation.shortest, _SHORTEST * law.optimal) for law in laws]
        longest = [_LONGEST * law.optimal for law in laws]
        fast = np.full(ne, _FASTEST)
        low, high = (
            self._tiled((least, trial.limits[0], shortest, -fast)),
            self._tiled((np.ones(n), trial.limits[1], longest, fast)),
        )
        raised = np.where(trial.least > least, trial.least, least - _ROOM)[1:]
        at_least = np.hstack((raised, low)).ravel()
        at_most = np.hstack((np.full_like(raised, 1.0 + _ROOM), high)).ravel()
        lower = np.concatenate((trial.least[0], shortest, at_least))
        return lower, np.concatenate((np.ones(n), longest, at_most))

    def _tiled(self, parts: Sequence[Any]) -> Array:
        """Return one row per point."""
        return np.tile(np.concatenate(parts), (self._points, 1))


class Part(NamedTuple):
    """The intervals of a trial that are solved.

    Attributes:
        solved: Whether an interval is solved, shape (intervals,); the others stay as they are.
        slopes: Derivatives of the cost from an interval to the end by the activations and fibre
            lengths at its start, shape (intervals, n + ne).
    """

    solved: NDArray[np.bool_]
    slopes: Array


def start_slopes(scheme: Collocation) -> Array:
    """Return the derivative of the rows of an interval by the state at its start, (degree,)."""
    slopes, sizes = _differences(scheme)
    derivative: Array = -slopes.sum(axis=1) / sizes
    return derivative


def _differences(scheme: Collocation) -> tuple[Array, Array]:
    """Return slopes at the points by differences from the start, and the sizes of their rows."""
    slopes: Array = np.linalg.inv(scheme.A)
    return slopes, np.abs(slopes).sum(axis=1)


class MuscleBlocks:
    """Blocks of rows and costs of a trial; the arguments are those of `MuscleProgram`."""

    def __init__(
        self,
        muscles: Sequence[Muscle],
        trial: Trial,
        scheme: Collocation,
        exponent: float,
        part: Part,
    ) -> None:
        self._muscles, self._trial, self._scheme = muscles, trial, scheme
        self._exponent, self._part = exponent, part
        self._elastic = [i for i, muscle in enumerate(muscles) if muscle.is_elastic]
        sizes = len(muscles), trial.columns.shape[2] - len(muscles), len(self._elastic)
        self._numbers = MuscleNumbers.of(len(trial.widths), scheme.degree, *sizes)
        self._solved_points = np.repeat(part.solved, scheme.degree)

    @property
    def numbers(self) -> MuscleNumbers:
        """Indices of the unknowns."""
        return self._numbers

    @property
    def kinds(self) -> list[list[int]]:
        """Muscles that share a law of activation, in the order of the blocks."""
        types = [type(muscle.dynamics) for muscle in self._muscles]
        return [
            [i for i, each in enumerate(types) if each is kind] for kind in dict.fromkeys(types)
        ]

    def all(self) -> list[Block]:
        """Return prices at the start and of reserves, then rows of muscles, tendons and forces."""
        return [
            *self._prices(),
            *self._beyond(),
            *self._activations(),
            *self._fibers(),
            *self._tendons(),
            self._forces(),
        ]

    def _prices(self) -> Iterator[Block]:
        trial, price = self._trial, price_form(self._exponent)
        falling = [float(muscle.dynamics.falling) for muscle in self._muscles]
        if self._part.solved[0]:
            weights = trial.prices[0] * falling
            yield Block("start", price, self._numbers.a_start[None], weights[None])
        shares = (trial.widths[:, None] * self._scheme.b).ravel()[self._solved_points]  # of time
        efforts = self._numbers.r[self._solved_points]
        weights = np.repeat(shares, efforts.shape[1])
        yield Block("reserves", price, efforts.reshape(1, -1), weights[None])

    def _beyond(self) -> Iterator[Block]:
        """Yield the value of states before intervals that are not solved."""
        solved, d = self._part.solved, self._scheme.degree
        last = np.flatnonzero(solved[:-1] & ~solved[1:])
        states = np.concatenate((self._numbers.a, self._numbers.fiber), axis=1)
        at, slopes = states[d * last + d - 1], self._part.slopes[last + 1]
        yield Block("beyond", slope_form(), at.reshape(1, -1), slopes.reshape(1, -1))

    def _activations(self) -> Iterator[Block]:
        """Yield rows and prices of muscles, for each law of activation."""
        trial, numbers = self._trial, self._numbers
        laws: list[Any] = [muscle.dynamics for muscle in self._muscles]
        for some in self.kinds:
            form = activation_form(laws[some[0]], self._scheme, self._exponent)
            places = numbers.over_intervals(numbers.a_start, numbers.a, some)
            places = np.concatenate((places, numbers.at_points(numbers.e, some)))
            constants = np.tile(
                np.array([laws[i] for i in some], dtype=np.float64).T, len(trial.widths)
            )
            known = (trial.prices, trial.stiffness, trial.target)
            points = [numbers.at_points(values[1:], some) for values in known]
            widths = np.repeat(trial.widths, len(some))[None]
            data = np.concatenate((widths, constants, *points))
            is_solved = np.repeat(self._part.solved, len(some))
            yield Block("activations", form, places[:, is_solved], data[:, is_solved])

    def _fibers(self) -> Iterator[Block]:
        """Yield the rows of fibre lengths."""
        ne = len(self._elastic)
        if not ne:
            return
        numbers, every, widths = self._numbers, range(ne), self._trial.widths
        places = numbers.over_intervals(numbers.fiber_start, numbers.fiber, every)
        places = np.concatenate((places, numbers.at_points(numbers.speed, every)))
        laws, intervals = [self._muscles[i].contraction for i in self._elastic], len(widths)
        fastest = np.tile([law.fastest for law in laws], intervals)
        data = np.stack((np.repeat(widths, ne), fastest))
        sizes = np.tile([law.optimal for law in laws], (self._scheme.degree, intervals))
        on = np.repeat(self._part.solved, ne)
        form = fiber_form(self._scheme)
        yield Block("fibers", form, places[:, on], data[:, on], 0.0, 0.0, sizes[:, on])

    def _tendons(self) -> Iterator[Block]:
        """Yield the equilibria of tendons with fibres, for each kind of curves."""
        laws = [self._muscles[i].contraction for i in self._elastic]
        numbers, elastic = self._numbers, np.array(self._elastic, dtype=np.intp)
        for curves in dict.fromkeys(law.curves for law in laws):
            some = [at for at, law in enumerate(laws) if law.curves == curves]
            each = numbers.a[:, elastic[some]], numbers.fiber[:, some], numbers.speed[:, some]
            constants = np.array(
                [contraction_numbers(laws[at]) for at in some], dtype=np.float64
            ).T
            lengths = self._trial.length[1:, elastic[some]][self._solved_points].ravel()[None]
            data = np.concatenate((lengths, np.tile(constants, int(self._solved_points.sum()))))
            places = np.stack([index[self._solved_points].ravel() for index in each])
            yield Block("tendons", tendon_form(curves), places, data)

    def _forces(self) -> Block:
        """Return the rows of the balance of forces."""
        trial, numbers = self._trial, self._numbers
        least = [float(muscle.dynamics.least) for muscle in self._muscles]
        slackens = ((trial.strength * least + trial.offset) < 0.0).any(axis=0)
        pulls = [
            Pull(muscle.contraction if muscle.is_elastic else None, bool(may))
            for muscle, may in zip(self._muscles, slackens, strict=True)
        ]
        unknown = numbers.a.copy()
        unknown[:, self._elastic] = numbers.fiber
        is_entry = np.abs(trial.columns).max(axis=0) > 0.0
        columns = trial.columns[:, is_entry]
        known = trial.strength, trial.offset, trial.length, columns, trial.needed
        data = np.concatenate(known, axis=1)[1:][self._solved_points].T
        places = np.concatenate((unknown, numbers.r), axis=1)[self._solved_points].T
        return Block("forces", force_form(pulls, is_entry), places, data, 0.0, 0.0, trial.sizes)


class MuscleNumbers(NamedTuple):
    """Indices of the unknowns: those of the start, then point by point in the order below.

    Attributes:
        degree: Points on an interval.
        a_start: Indices of activations at the start, shape (n,).
        fiber_start: Indices of fibre lengths beside elastic tendons at the start, shape (ne,).
        a: Indices of activations at the points, shape (points, n).
        e: Indices of excitations, shape (points, n).
        r: Indices of efforts of reserves, shape (points, r).
        fiber: Indices of fibre lengths, shape (points, ne).
        speed: Indices of fibre speeds, shape (points, ne).
    """

    degree: int
    a_start: Places
    fiber_start: Places
    a: Places
    e: Places
    r: Places
    fiber: Places
    speed: Places

    @classmethod
    def of(cls, intervals: int, degree: int, n: int, r: int, ne: int) -> MuscleNumbers:
        """Number the unknowns of a trial with n muscles, r reserves and ne elastic tendons."""
        each, first = 2 * n + r + 2 * ne, n + ne
        every = first + np.arange(intervals * degree * each).reshape(-1, each)
        parts = np.split(every, np.cumsum([n, n, r, ne]), axis=1)
        return cls(degree, np.arange(n), np.arange(n, first), *parts)

    def over_intervals(self, start: Places, points: Places, some: Sequence[int]) -> Places:
        """Stack the indices of states at the start of each interval on those at its points.

        Args:
            start: Indices at the start of the motion.
            points: Indices at the points.
            some: The states.

        Returns:
            Indices, shape (1 + degree, intervals * len(some)).
        """
        ends = points[self.degree - 1 : -1 : self.degree]
        begins = np.concatenate((start[None], ends))[:, some]
        return np.concatenate((begins.reshape(1, -1), self.at_points(points, some)))

    def at_points(self, values: Array, some: Sequence[int]) -> Array:
        """Return some columns at the points, shape (degree, intervals * len(some))."""
        stacked = values[:, some].reshape(-1, self.degree, len(some))
        return stacked.transpose(1, 0, 2).reshape(self.degree, -1)


def price_form(exponent: float) -> Form:
    """Return the form of the cost w |x|^p; data: w."""
    x, weight = ca.SX.sym("x"), ca.SX.sym("w")
    return Form(x, weight, ca.SX(0, 1), weight * _power(x, exponent))


def _power(x: Any, p: float) -> Any:
    """Return |x|^p, with its kink at 0 smoothed."""
    if p == 2.0:
        return x**2
    return (x**2) ** (0.5 * p) if p > 2.0 else (x**2 + _ROUNDED**2) ** (0.5 * p) - _ROUNDED**p


def slope_form() -> Form:
    """Return the form of the cost s x; data: s."""
    x, slope = ca.SX.sym("x"), ca.SX.sym("s")
    return Form(x, slope, ca.SX(0, 1), slope * x)


def activation_form(dynamics: ActivationDynamics, scheme: Collocation, exponent: float) -> Form:
    """Return the form of one activation on one interval, with the cost of its excitation.

    Unknown are the activation at the start, activations and excitations at the points; data:
    width of the interval, numbers of the dynamics, then prices, stiffness and target at points.
    """
    kind: Any = type(dynamics)
    d, count = scheme.degree, len(kind._fields)
    a, e = ca.SX.sym("a", d + 1), ca.SX.sym("e", d)
    h, constants, known = ca.SX.sym("h"), ca.SX.sym("n", count), ca.SX.sym("k", d, 3)
    law = kind(*(Scalar(constants[i]) for i in range(count)))
    rates = [plain(law.rate(SymbolicKinematics, Scalar(e[j]), Scalar(a[j + 1]))) for j in range(d)]
    prices, stiffness, target = ca.horzsplit(known)
    costs = prices * _power(e, exponent) + stiffness * (a[1:] - target) ** 2
    rows = _defects(scheme, a, h * ca.vertcat(*rates))
    cost = h * ca.dot(ca.DM(scheme.b), costs)
    return Form(ca.vertcat(a, e), ca.vertcat(h, constants, ca.vec(known)), rows, cost)


def _defects(scheme: Collocation, x: Any, step: Any) -> Any:
    """Return the rows of x' h = step at the points, by differences, which have fewest entries."""
    slopes, sizes = _differences(scheme)
    from_start = ca.DM(slopes / sizes[:, None]) @ (x[1:] - x[0])
    return from_start - step / ca.DM(sizes)


def fiber_form(scheme: Collocation) -> Form:
    """Return the form of a fibre length on an interval, l' = v fastest; data: width, fastest."""
    l, v = ca.SX.sym("l", scheme.degree + 1), ca.SX.sym("v", scheme.degree)  # noqa: E741
    known = ca.SX.sym("k", 2)
    return Form(ca.vertcat(l, v), known, _defects(scheme, l, known[0] * known[1] * v))


def contraction_numbers(law: Contraction) -> list[float]:
    """Return the data of `tendon_form` that follow the length of the path."""
    return [law.peak, law.optimal, law.slack, law.fastest, *law.pennation]


def tendon_form(curves: Any) -> Form:
    """Return the form of the equilibrium of one tendon with its fibres, per peak force.

    Unknown are activation, length and speed of the fibres; data: the length of the path, then the
    numbers of `contraction_numbers`.
    """
    x, known = ca.SX.sym("x", 3), ca.SX.sym("k", 8)
    a, l, v, length = (Scalar(each) for each in (*ca.vertsplit(x), known[0]))  # noqa: E741
    law = _contraction(known[1:], curves)
    fiber = Fiber(l, law.cosine(SymbolicKinematics, l), v * law.fastest)
    k = SymbolicKinematics
    along = law.active(k, a, fiber) + law.passive(k, fiber) + law.damping(fiber)
    residual = (law.tendon(k, length, l) - along * fiber.cosine) / law.peak
    return Form(x, known, plain(residual))


def _contraction(numbers: Any, curves: Any) -> Contraction:
    peak, optimal, slack, fastest, *geometry = (Scalar(each) for each in ca.vertsplit(numbers))
    return Contraction(peak, optimal, slack, fastest, Pennation(*geometry), curves)


class Pull(NamedTuple):
    """Dependence of the tension of a muscle on its unknown.

    Attributes:
        law: Law of a muscle with an elastic tendon, whose unknown is the fibre length; None for
            one with a rigid tendon, whose unknown is the activation.
        may_slacken: Whether the formula of a tension beside a rigid tendon may become negative.
    """

    law: Contraction | None
    may_slacken: bool


def force_form(pulls: Sequence[Pull], is_entry: NDArray[np.bool_]) -> Form:
    """Return the form of the forces on the independent coordinates less the needed forces.

    Unknown are the activation or the fibre length of each muscle, then the efforts of reserves.
    Data are strength and offset of each muscle beside a rigid tendon, path lengths, entries of
    the columns, and the needed forces.

    Args:
        pulls: Dependence of the tension of each muscle on its unknown.
        is_entry: Whether an entry of the columns is not always 0, shape (nv_y, n + r).
    """
    (rows, columns), n = np.nonzero(is_entry), len(pulls)
    x, needed = ca.SX.sym("x", is_entry.shape[1]), ca.SX.sym("t", is_entry.shape[0])
    strength, offset, length = (ca.SX.sym(name, n) for name in ("s", "o", "L"))
    entries = ca.SX.sym("c", len(rows))
    exerted = ca.SX.zeros(is_entry.shape[0])
    forces = [
        _tension(pull, x[i], strength[i], offset[i], length[i]) for i, pull in enumerate(pulls)
    ]
    forces += ca.vertsplit(x[n:]) if is_entry.shape[1] > n else []
    for place, (row, column) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        exerted[row] += entries[place] * forces[column]
    return Form(x, ca.vertcat(strength, offset, length, entries, needed), exerted - needed)


def _tension(pull: Pull, x: Any, strength: Any, offset: Any, length: Any) -> Any:
    if pull.law is not None:
        return plain(pull.law.tendon(SymbolicKinematics, Scalar(length), Scalar(x)))
    tension = strength * x + offset
    return ca.fmax(tension, 0.0) if pull.may_slacken else tension
