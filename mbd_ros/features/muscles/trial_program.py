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
from typing import Any

import numpy as np

from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import Array
from mbd_ros.features.muscles.muscle_trial import Excited, Optimal, Trial
from mbd_ros.features.muscles.trial_blocks import MuscleBlocks, Part
from mbd_ros.features.muscles.trial_forms import start_slopes
from mbd_ros.optimal_control.collocation import Collocation
from mbd_ros.optimal_control.ipopt import Solved, solve
from mbd_ros.optimal_control.sparse_program import SparseProgram

_FASTEST, _LONGEST = 3.0, 2.0  # bounds of fibres, per largest speed and per optimal length
_SHORTEST = 0.05  # per optimal length, where fibres may be as short as they like
_USUAL = 0.05  # excitation: what prices are scaled by
_ROOM = 0.1  # beyond what excitations bound: two bounds at one place take iterations
_OPTIONS = {  # rows and unknowns are in usual sizes: scaling and refinement take time alone
    "mu_init": 0.01,
    "min_refinement_steps": 0,
    "mumps_mem_percent": 100,
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
    "mumps_pivot_order": 2,
}
_NEAR = {"mu_strategy": "monotone", "mu_init": 1.0e-4, "bound_push": 1.0e-5, "bound_frac": 1.0e-5}


class MuscleProgram:
    """The nonlinear program of one trial.

    Args:
        muscles: At least one.
        trial: What is known of it at the points.
        scheme: Whose last point is the end of an interval.
        exponent: The p.
        part: Which intervals are solved; None for all.
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
        """The optimum.

        Args:
            guess: From where it is looked for.
            accuracy: Of the conditions of the optimum.
            most: Iterations.
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
        curvature = self._trial.prices * np.maximum(guess.activation, _USUAL) ** (
            self._exponent - 2.0
        )
        cost_size = float(self._trial.widths.sum() * curvature.mean()) / self._points
        program = SparseProgram(self._blocks.all(), self._sizes(), known, cost_size)
        given: dict[str, Any] = {"accuracy": accuracy, "most": most, "is_near": is_near}
        given["options"] = {**_OPTIONS, **(_NEAR if is_near else {})}
        return self._optimal(solve(program, start, lower, upper, **given), program)

    def _optimal(self, found: Solved, program: SparseProgram) -> Optimal:
        n, r, ne = self._n, self._r, self._ne
        a, lengths = np.split(found.x[: self._first], (n,))
        points = found.x[self._first :].reshape(-1, self._each)
        start = np.concatenate((a, a, np.zeros(r), lengths, np.zeros(ne)))
        parts = np.split(np.vstack((start, points)), np.cumsum([n, n, r, ne]), axis=1)
        off, forces = np.abs(found.rows / program.row_sizes), program.slices[-1]
        lacking = np.zeros_like(self._trial.needed[1:])
        at = np.repeat(self._part.solved, self._scheme.degree)
        lacking[at] = off[forces].reshape(-1, lacking.shape[1])
        residual = max(found.violation, found.stationarity)
        excited, falling = Excited(*parts), np.array([m.dynamics.falling for m in self._muscles])
        cost = self._trial.cost(excited, self._scheme.b, falling, self._exponent)
        how = cost, found.iterations, found.is_good, found.status, residual
        return Optimal(excited, *how, lacking, self._slopes(found, program))

    def _slopes(self, found: Solved, program: SparseProgram) -> Array:
        """See `Part.slopes`: of intervals that were solved the new ones."""
        slopes, solved = self._part.slopes.copy(), np.flatnonzero(self._part.solved)
        of_start = start_slopes(self._scheme)
        columns = [*self._blocks.kinds, [*range(self._n, self._first)]]
        named = zip(program.blocks, program.slices, strict=True)
        moving = [rows for block, rows in named if block.name in ("activations", "fibers")]
        for rows, some in zip(moving, columns, strict=False):  # no fibres, no rows
            forces = found.row_forces[rows].reshape(len(solved), len(some), -1)
            slopes[np.ix_(solved, some)] = forces @ of_start
        return slopes

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
        raised = np.where(trial.least > least, trial.least, least - _ROOM)[1:]
        at_least = np.hstack((raised, low)).ravel()
        at_most = np.hstack((np.full_like(raised, 1.0 + _ROOM), high)).ravel()
        lower = np.concatenate((trial.least[0], shortest, at_least))
        return lower, np.concatenate((np.ones(n), longest, at_most))

    def _tiled(self, parts: Sequence[Any]) -> Array:
        """One row a point."""
        return np.tile(np.concatenate(parts), (self._points, 1))
