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

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.program.block import Block
from mbd_ros.compiled.program.ipopt import Solved, solve
from mbd_ros.compiled.program.muscle_forms import (
    Pull,
    activation_form,
    contraction_numbers,
    fiber_form,
    force_form,
    price_form,
    tendon_form,
)
from mbd_ros.compiled.program.muscle_numbers import MuscleNumbers
from mbd_ros.compiled.program.sparse_program import SparseProgram
from mbd_ros.core.inverse.muscle_trial import Excited, Optimal, Trial
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.prediction.collocation import Collocation
from mbd_ros.core.state import Array

_FASTEST, _LONGEST = 3.0, 2.0  # bounds of fibres, per largest speed and per optimal length
_SHORTEST = 0.05  # per optimal length, where fibres may be as short as they like
_OPTIONS = {  # rows and unknowns are in usual sizes: scaling and refinement take time alone
    "min_refinement_steps": 0,
    "mumps_mem_percent": 100,
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
    "mumps_pivot_order": 2,
}


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
        self._points = len(trial.length) - 1
        sizes = self._n, self._r, self._ne
        self._numbers = MuscleNumbers.of(len(trial.widths), scheme.degree, *sizes)

    def solve(self, guess: Excited, accuracy: float, most: int, is_near: bool) -> Optimal:
        """The optimum.

        Args:
            guess: From where it is looked for.
            accuracy: Of the conditions of the optimum.
            most: Iterations.
            is_near: Whether the guess is nearly the optimum.
        """
        size = self._first + self._each * self._points
        cost_size = float(self._trial.widths.sum()) / self._points
        program = SparseProgram(self._blocks(), self._sizes(), np.full(size, np.nan), cost_size)
        lower, upper = self._bounds()
        points = np.hstack(guess)[1:]
        first = guess.activation[0], guess.fiber_length[0]
        start = np.clip(np.concatenate((*first, points.ravel())), lower, upper)
        options: dict[str, Any] = {"accuracy": accuracy, "most": most, "is_near": is_near}
        options["options"] = _OPTIONS
        return self._optimal(solve(program, start, lower, upper, **options), program)

    def _optimal(self, found: Solved, program: SparseProgram) -> Optimal:
        n, r, ne = self._n, self._r, self._ne
        a, lengths = np.split(found.x[: self._first], (n,))
        points = found.x[self._first :].reshape(-1, self._each)
        start = np.concatenate((a, a, np.zeros(r), lengths, np.zeros(ne)))
        parts = np.split(np.vstack((start, points)), np.cumsum([n, n, r, ne]), axis=1)
        off, forces = np.abs(found.rows / program.row_sizes), program.slices[-1]
        lacking = off[forces].reshape(self._points, -1)
        residual = max(found.violation, found.stationarity)
        how = found.cost, found.iterations, found.is_good, found.status, residual
        return Optimal(Excited(*parts), *how, lacking)

    def _sizes(self) -> Array:
        """Usual sizes: of fibres their optimal length."""
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
        at_least = np.hstack((trial.least[1:], low)).ravel()
        at_most = np.hstack((np.ones_like(trial.least[1:]), high)).ravel()
        lower = np.concatenate((trial.least[0], shortest, at_least))
        return lower, np.concatenate((np.ones(n), longest, at_most))

    def _tiled(self, parts: Sequence[Any]) -> Array:
        """One row a point."""
        return np.tile(np.concatenate(parts), (self._points, 1))

    def _blocks(self) -> list[Block]:
        """Prices at the start and of reserves, rows of muscles and of tendons, then of forces."""
        trial, numbers, p = self._trial, self._numbers, self._exponent
        falling = [float(muscle.dynamics.falling) for muscle in self._muscles]
        shares = (trial.widths[:, None] * self._scheme.b).ravel()  # of time, of each point
        price = price_form(p)
        return [
            Block("start", price, numbers.a_start[None], (trial.prices[0] * falling)[None]),
            Block("reserves", price, numbers.r.T.ravel()[None], np.tile(shares, self._r)[None]),
            *self._activations(),
            *self._fibers(),
            *self._tendons(),
            self._forces(),
        ]

    def _activations(self) -> Iterator[Block]:
        """Rows and prices of muscles, by how their activation moves."""
        trial, numbers = self._trial, self._numbers
        laws: list[Any] = [muscle.dynamics for muscle in self._muscles]
        for kind in dict.fromkeys(type(law) for law in laws):
            some = [i for i, law in enumerate(laws) if type(law) is kind]
            form = activation_form(laws[some[0]], self._scheme, self._exponent)
            places = numbers.over_intervals(numbers.a_start, numbers.a, some)
            places = np.concatenate((places, numbers.at_points(numbers.e, some)))
            own = np.tile(np.array([laws[i] for i in some], dtype=np.float64).T, len(trial.widths))
            known = (trial.prices, trial.stiffness, trial.target)
            points = [numbers.at_points(values[1:], some) for values in known]
            widths = np.repeat(trial.widths, len(some))[None]
            yield Block("activations", form, places, np.concatenate((widths, own, *points)))

    def _fibers(self) -> Iterator[Block]:
        """Rows of lengths of fibres."""
        if not self._ne:
            return
        numbers, every, widths = self._numbers, range(self._ne), self._trial.widths
        places = numbers.over_intervals(numbers.fiber_start, numbers.fiber, every)
        places = np.concatenate((places, numbers.at_points(numbers.speed, every)))
        laws, intervals = [self._muscles[i].contraction for i in self._elastic], len(widths)
        fastest = np.tile([law.fastest for law in laws], intervals)
        data = np.stack((np.repeat(widths, self._ne), fastest))
        sizes = np.tile([law.optimal for law in laws], (self._scheme.degree, intervals))
        yield Block("fibers", fiber_form(self._scheme), places, data, 0.0, 0.0, sizes)

    def _tendons(self) -> Iterator[Block]:
        """Balances of tendons with fibres, by their curves."""
        laws = [self._muscles[i].contraction for i in self._elastic]
        numbers, elastic = self._numbers, np.array(self._elastic, dtype=np.intp)
        for curves in dict.fromkeys(law.curves for law in laws):
            some = [at for at, law in enumerate(laws) if law.curves == curves]
            each = numbers.a[:, elastic[some]], numbers.fiber[:, some], numbers.speed[:, some]
            own = np.array([contraction_numbers(laws[at]) for at in some], dtype=np.float64).T
            lengths = self._trial.length[1:, elastic[some]].ravel()[None]
            data = np.concatenate((lengths, np.tile(own, self._points)))
            places = np.stack([one.ravel() for one in each])
            yield Block("tendons", tendon_form(curves), places, data)

    def _forces(self) -> Block:
        """Rows of what muscles and reserves exert."""
        trial, numbers = self._trial, self._numbers
        least = [float(muscle.dynamics.least) for muscle in self._muscles]
        slackens = ((trial.strength * least + trial.offset) < 0.0).any(axis=0)
        pulls = [
            Pull(muscle.contraction if muscle.is_elastic else None, bool(may))
            for muscle, may in zip(self._muscles, slackens, strict=True)
        ]
        unknown = numbers.a.copy()
        unknown[:, self._elastic] = numbers.fiber
        kept = np.abs(trial.columns).max(axis=0) > 0.0
        known = trial.strength, trial.offset, trial.length, trial.columns[:, kept], trial.needed
        data = np.concatenate(known, axis=1)[1:].T
        places = np.concatenate((unknown, numbers.r), axis=1).T
        return Block("forces", force_form(pulls, kept), places, data, 0.0, 0.0, trial.sizes)
