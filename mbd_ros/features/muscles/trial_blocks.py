"""Blocks of the program of a trial of muscles, on all of its intervals or on some."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import Array
from mbd_ros.features.muscles.muscle_trial import Trial
from mbd_ros.features.muscles.trial_forms import (
    Pull,
    activation_form,
    contraction_numbers,
    fiber_form,
    force_form,
    price_form,
    slope_form,
    tendon_form,
)
from mbd_ros.optimal_control.collocation import Collocation
from mbd_ros.optimal_control.program_block import Block, Places

# Where the unknowns of a trial of muscles stand in its program.


class MuscleNumbers(NamedTuple):
    """Numbers of unknowns: those of the start, then point by point in the order below.

    Attributes:
        degree: Points on an interval.
        a_start: Of activations at the start, shape (n,).
        fiber_start: Of lengths of fibres beside elastic tendons, shape (ne,).
        a: At the points, shape (points, n).
        e: Of excitations, same shape.
        r: Of efforts of reserves, shape (points, r).
        fiber: Of lengths of fibres, shape (points, ne).
        speed: Of speeds of fibres, same shape.
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
    def of(cls, intervals: int, degree: int, n: int, r: int, ne: int) -> "MuscleNumbers":
        """Of a trial with so many intervals, muscles, reserves and elastic tendons."""
        each, first = 2 * n + r + 2 * ne, n + ne
        every = first + np.arange(intervals * degree * each).reshape(-1, each)
        parts = np.split(every, np.cumsum([n, n, r, ne]), axis=1)
        return cls(degree, np.arange(n), np.arange(n, first), *parts)

    def over_intervals(self, start: Places, points: Places, some: Sequence[int]) -> Places:
        """Of some states, those at the start of each interval above those at its points.

        Args:
            start: At the start.
            points: At the points.
            some: Which columns.

        Returns:
            Shape (1 + degree, intervals * len(some)).
        """
        ends = points[self.degree - 1 : -1 : self.degree]
        begins = np.concatenate((start[None], ends))[:, some]
        return np.concatenate((begins.reshape(1, -1), self.at_points(points, some)))

    def at_points(self, values: Array, some: Sequence[int]) -> Array:
        """Of some columns those at the points, shape (degree, intervals * len(some))."""
        found = values[:, some].reshape(-1, self.degree, len(some))
        return found.transpose(1, 0, 2).reshape(self.degree, -1)


class Part(NamedTuple):
    """What of a trial is solved.

    Attributes:
        solved: Which intervals, shape (intervals,); the others stay as they are.
        slopes: What the cost of an interval and all after it gains by activations and lengths of
            fibres at its start, shape (intervals, n + ne).
    """

    solved: NDArray[np.bool_]
    slopes: Array


class MuscleBlocks:
    """Blocks of a trial; arguments as for `MuscleProgram`."""

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
        self._kept = np.repeat(part.solved, scheme.degree)  # points

    @property
    def numbers(self) -> MuscleNumbers:
        """Where the unknowns stand."""
        return self._numbers

    @property
    def kinds(self) -> list[list[int]]:
        """Muscles whose activations move by one law each, in the order of the blocks."""
        types = [type(muscle.dynamics) for muscle in self._muscles]
        return [[i for i, one in enumerate(types) if one is kind] for kind in dict.fromkeys(types)]

    def all(self) -> list[Block]:
        """Prices at the start and of reserves, rows of muscles and of tendons, then of forces."""
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
        shares = (trial.widths[:, None] * self._scheme.b).ravel()[self._kept]  # of time
        efforts = self._numbers.r[self._kept]
        weights = np.repeat(shares, efforts.shape[1])
        yield Block("reserves", price, efforts.reshape(1, -1), weights[None])

    def _beyond(self) -> Iterator[Block]:
        """What states are worth where intervals follow that are not solved."""
        solved, d = self._part.solved, self._scheme.degree
        last = np.flatnonzero(solved[:-1] & ~solved[1:])
        states = np.concatenate((self._numbers.a, self._numbers.fiber), axis=1)
        at, slopes = states[d * last + d - 1], self._part.slopes[last + 1]
        yield Block("beyond", slope_form(), at.reshape(1, -1), slopes.reshape(1, -1))

    def _activations(self) -> Iterator[Block]:
        """Rows and prices of muscles, by how their activation moves."""
        trial, numbers = self._trial, self._numbers
        laws: list[Any] = [muscle.dynamics for muscle in self._muscles]
        for some in self.kinds:
            form = activation_form(laws[some[0]], self._scheme, self._exponent)
            places = numbers.over_intervals(numbers.a_start, numbers.a, some)
            places = np.concatenate((places, numbers.at_points(numbers.e, some)))
            own = np.tile(np.array([laws[i] for i in some], dtype=np.float64).T, len(trial.widths))
            known = (trial.prices, trial.stiffness, trial.target)
            points = [numbers.at_points(values[1:], some) for values in known]
            widths = np.repeat(trial.widths, len(some))[None]
            data = np.concatenate((widths, own, *points))
            kept = np.repeat(self._part.solved, len(some))
            yield Block("activations", form, places[:, kept], data[:, kept])

    def _fibers(self) -> Iterator[Block]:
        """Rows of lengths of fibres."""
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
        kept = np.repeat(self._part.solved, ne)
        given = places[:, kept], data[:, kept], 0.0, 0.0, sizes[:, kept]
        yield Block("fibers", fiber_form(self._scheme), *given)

    def _tendons(self) -> Iterator[Block]:
        """Balances of tendons with fibres, by their curves."""
        laws = [self._muscles[i].contraction for i in self._elastic]
        numbers, elastic = self._numbers, np.array(self._elastic, dtype=np.intp)
        for curves in dict.fromkeys(law.curves for law in laws):
            some = [at for at, law in enumerate(laws) if law.curves == curves]
            each = numbers.a[:, elastic[some]], numbers.fiber[:, some], numbers.speed[:, some]
            own = np.array([contraction_numbers(laws[at]) for at in some], dtype=np.float64).T
            lengths = self._trial.length[1:, elastic[some]][self._kept].ravel()[None]
            data = np.concatenate((lengths, np.tile(own, int(self._kept.sum()))))
            places = np.stack([one[self._kept].ravel() for one in each])
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
        data = np.concatenate(known, axis=1)[1:][self._kept].T
        places = np.concatenate((unknown, numbers.r), axis=1)[self._kept].T
        return Block("forces", force_form(pulls, kept), places, data, 0.0, 0.0, trial.sizes)
