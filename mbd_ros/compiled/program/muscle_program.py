"""Excitations that cost least while muscles exert what a known motion needs.

Unknown are activations, excitations, efforts of reserves, and beside elastic tendons lengths and
speeds of fibres, at Radau's points of each interval:

    min sum integral (w_i e_i^p + s_i (a_i - measured_i)^2) + sum integral |r_j|^p
        + sum tau_i w_i a_i(0)^p
    a' = rate(e, a),   l' = v,   tendon(L, l) = (active(a, l, v) + passive(l) + damping(v)) cos
    sum_i B_i F_i + sum_j R_j r_j = tau

Lengths L and arms B of the paths and the forces tau are numbers, as are the strengths of muscles
beside rigid tendons, whose tension is affine in the activation: the motion is known. The
last sum is the price of the excitation before the start, over the time constant of falling
activation: without it muscles begin with whatever activation is of use.

Source: F. De Groote et al., Ann. Biomed. Eng. 44, 2016, 2922-2936, doi:10.1007/s10439-016-1591-9.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.program.block import Block, Form, Places
from mbd_ros.compiled.program.ipopt import Solved, solve
from mbd_ros.compiled.program.sparse_program import SparseProgram
from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics
from mbd_ros.compiled.symbols.scalar import Scalar, plain
from mbd_ros.core.inverse.muscle_trial import Excited, Optimal, Trial
from mbd_ros.core.muscles.contraction import Fiber
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.prediction.collocation import Collocation
from mbd_ros.core.state import Array

_FASTEST, _LONGEST = 3.0, 2.0  # bounds of fibres, per largest speed and per optimal length
_SHORTEST = 0.05  # per optimal length, where fibres may be as short as they like


class _Point(NamedTuple):
    """Symbols at one point: the unknowns, then what is known."""

    a: Any
    e: Any
    r: Any
    l: Any  # noqa: E741
    v: Any
    length: Any
    strength: Any
    offset: Any
    columns: Any
    needed: Any
    prices: Any
    stiffness: Any
    target: Any


class MuscleProgram:
    """The nonlinear program of one trial.

    Args:
        muscles: At least one.
        trial: What is known of it at the points.
        scheme: Whose last point is the end of an interval.
        exponent: The p.
    """

    def __init__(
        self, muscles: Sequence[Muscle], trial: Trial, scheme: Collocation, exponent: float
    ) -> None:
        self._muscles, self._trial, self._scheme = tuple(muscles), trial, scheme
        self._elastic = [i for i, muscle in enumerate(muscles) if muscle.is_elastic]
        self._n, self._ne = len(muscles), len(self._elastic)
        self._r = trial.columns.shape[2] - self._n
        self._each = 2 * self._n + self._r + 2 * self._ne  # unknowns at a point
        self._exponent = exponent
        self._first = self._n + self._ne  # unknowns at the start

    def solve(self, guess: Excited, accuracy: float, most: int, is_near: bool) -> Optimal:
        """The optimum.

        Args:
            guess: From where it is looked for.
            accuracy: Of the conditions of the optimum.
            most: Iterations.
            is_near: Whether the guess is nearly the optimum.
        """
        size = self._first + self._each * (len(self._trial.length) - 1)
        program = SparseProgram(self._blocks(), self._sizes(), np.full(size, np.nan))
        lower, upper = self._bounds()
        points = np.hstack(guess)[1:]
        first = guess.activation[0], guess.fiber_length[0]
        start = np.clip(np.concatenate((*first, points.ravel())), lower, upper)
        options: dict[str, Any] = {"accuracy": accuracy, "most": most, "is_near": is_near}
        return self._optimal(solve(program, start, lower, upper, **options), program)

    def _optimal(self, found: Solved, program: SparseProgram) -> Optimal:
        n, r, ne = self._n, self._r, self._ne
        a, lengths = np.split(found.x[: self._first], (n,))
        points = found.x[self._first :].reshape(-1, self._each)
        start = np.concatenate((a, a, np.zeros(r), lengths, np.zeros(ne)))
        every = np.vstack((start, points))
        parts = np.split(every, np.cumsum([n, n, r, ne]), axis=1)
        nv, intervals = self._trial.needed.shape[1], len(self._trial.widths)
        off = np.abs(found.rows / program.row_sizes).reshape(intervals, -1)
        lacking = off[:, -nv * self._scheme.degree :].reshape(-1, nv)
        residual = max(found.violation, found.stationarity)
        how = found.cost, found.iterations, found.is_good, found.status, residual
        return Optimal(Excited(*parts), *how, lacking)

    def _sizes(self) -> Array:
        """Usual sizes: of fibres their optimal length."""
        lengths = [self._muscles[i].contraction.optimal for i in self._elastic]
        point = np.ones(self._each)
        point[2 * self._n + self._r : 2 * self._n + self._r + self._ne] = lengths
        count = len(self._trial.widths) * self._scheme.degree
        return np.concatenate((np.ones(self._n), lengths, np.tile(point, count)))

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
        at_least = np.hstack((trial.least[1:], low)).ravel()
        at_most = np.hstack((np.ones_like(trial.least[1:]), high)).ravel()
        lower = np.concatenate((trial.least[0], shortest, at_least))
        return lower, np.concatenate((np.ones(n), longest, at_most))

    def _tiled(self, parts: Sequence[Any]) -> Array:
        """One row a point."""
        return np.tile(np.concatenate(parts), (len(self._trial.length) - 1, 1))

    def _blocks(self) -> list[Block]:
        """The start, and each interval with the end of the one before."""
        d, trial = self._scheme.degree, self._trial
        form, start = self._interval(), self._beginning()
        intervals = len(trial.widths)
        ends = self._ends(intervals)
        inside = self._first + np.arange(intervals * d * self._each).reshape(intervals, -1)
        places: Places = np.concatenate((ends, inside), axis=1).T.astype(np.intp)
        known = [trial.length, trial.strength, trial.offset]
        known += [trial.columns.reshape(len(trial.length), -1)]
        known += [trial.needed, trial.prices, trial.stiffness, trial.target]
        every = np.concatenate(known, axis=1)
        points = every[1:].reshape(intervals, -1)
        data = np.concatenate((trial.widths[:, None], points), axis=1).T
        sizes = np.ones(form.rows)
        sizes[form.rows - len(trial.sizes) * d :] = np.tile(trial.sizes, d)
        first = np.arange(self._n, dtype=np.intp)[:, None]
        return [
            Block("start", start, first, trial.prices[:1].T),
            Block("trial", form, places, data, 0.0, 0.0, sizes),
        ]

    def _ends(self, intervals: int) -> Array:
        """Numbers of activations and fibre lengths at the start of each interval."""
        d, n = self._scheme.degree, self._n
        last = self._first + self._each * (d * np.arange(1, intervals) - 1)
        lengths = np.arange(2 * n + self._r, 2 * n + self._r + self._ne)
        at = np.concatenate((np.arange(n), lengths))
        return np.concatenate((np.arange(self._n + self._ne)[None], last[:, None] + at))

    @property
    def _known(self) -> list[int]:
        """Sizes of what is known at a point, in the order of `_Point`."""
        n, nv = self._n, self._trial.needed.shape[1]
        return [n, n, n, nv * (n + self._r), nv, n, n, n]

    def _beginning(self) -> Form:
        """The price of the activations at the start."""
        a, prices = ca.SX.sym("a", self._n), ca.SX.sym("w", self._n)
        falling = ca.DM([float(muscle.dynamics.falling) for muscle in self._muscles])
        return Form(a, prices, ca.SX(0, 1), ca.dot(falling, prices * a**self._exponent))

    def _interval(self) -> Form:
        d, n, ne = self._scheme.degree, self._n, self._ne
        start, unknown = ca.SX.sym("start", n + ne), ca.SX.sym("x", self._each, d)
        h, known = ca.SX.sym("h"), ca.SX.sym("k", sum(self._known), d)
        own = ca.vertsplit(unknown, np.cumsum([0, n, n, self._r, ne, ne]).tolist())
        parts = ca.vertsplit(known, np.cumsum([0, *self._known]).tolist())
        points = [
            _Point(*(one[:, j] for one in own), *(one[:, j] for one in parts)) for j in range(d)
        ]
        A, b = self._scheme.A, self._scheme.b
        rates = [self._rates(point) for point in points]
        states = [ca.vertcat(point.a, point.l) for point in points]
        rows = [
            states[j] - start - h * sum(A[j, k] * rates[k] for k in range(d)) for j in range(d)
        ]
        forces = [self._tensions(point) for point in points]
        rows += [balance for _, balance in forces]
        rows += [
            self._exerted(point, tension) - point.needed
            for point, (tension, _) in zip(points, forces, strict=True)
        ]
        cost = h * sum(float(b[j]) * self._price(point) for j, point in enumerate(points))
        x = ca.vertcat(start, ca.vec(unknown))
        return Form(x, ca.vertcat(h, ca.vec(known)), ca.vertcat(*rows), cost)

    def _rates(self, point: _Point) -> Any:
        """Of activations, and of lengths of fibres."""
        k = SymbolicKinematics
        found = [
            plain(muscle.dynamics.rate(k, Scalar(point.e[i]), Scalar(point.a[i])))
            for i, muscle in enumerate(self._muscles)
        ]
        fastest = [self._muscles[i].contraction.fastest for i in self._elastic]
        return ca.vertcat(*found, point.v * ca.DM(np.array(fastest)))

    def _tensions(self, point: _Point) -> tuple[Any, Any]:
        """Tensions [N], and what lacks in the balances of fibres and tendons per peak force."""
        k, tensions, balances = SymbolicKinematics, [], []
        for i, muscle in enumerate(self._muscles):
            law, a = muscle.contraction, Scalar(point.a[i])
            length = Scalar(point.length[i])
            if not muscle.is_elastic:
                pull = point.strength[i] * point.a[i] + point.offset[i]
                tensions.append(ca.fmax(pull, 0.0))
                continue
            at = self._elastic.index(i)
            lf = Scalar(point.l[at])
            fiber = Fiber(lf, law.cosine(k, lf), Scalar(point.v[at]) * law.fastest)
            pull = law.tendon(k, length, lf)
            along = law.active(k, a, fiber) + law.passive(k, fiber) + law.damping(fiber)
            tensions.append(plain(pull))
            balances.append(plain((pull - along * fiber.cosine) / law.peak))
        return ca.vertcat(*tensions), ca.vertcat(ca.SX(0, 1), *balances)

    def _exerted(self, point: _Point, tension: Any) -> Any:
        """On the independent coordinates, by rows of arms as numpy lays them out."""
        count = self._n + self._r
        columns = ca.reshape(point.columns, count, -1).T
        return columns @ ca.vertcat(tension, point.r)

    def _price(self, point: _Point) -> Any:
        effort = ca.sum1(point.prices * point.e**self._exponent)
        effort += ca.sum1(point.stiffness * (point.a - point.target) ** 2)
        p = self._exponent
        return effort + ca.sum1(point.r**2 if p == 2.0 else (point.r**2) ** (0.5 * p))
