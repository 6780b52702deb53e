"""Sharing with the dynamics of activations and tendons, over a whole motion at once.

The motion is known at points of a mesh; excitations that explain it at least cost are the solution
of `trial_program`. Where activations between points are off by more than a tolerance, intervals
are halved and solved again, with those beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.muscles.contraction import Contraction, Fiber
from mbd_ros.core.muscles.curves import ArrayNumbers
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError, SolveError
from mbd_ros.features.muscles.muscle_frames import Frames
from mbd_ros.features.muscles.muscle_trial import (
    Excited,
    MuscleDynamics,
    Optimal,
    Trial,
    muscles_with,
)
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization, sizes_of
from mbd_ros.jobs.progress import announce
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations
from mbd_ros.optimal_control.mesh import MOST_INTERVALS, RADAU, Collocation, collocation

_NEAR = 1.0  # longest intervals beside one that is cut: muscles forget over some 0.02 s
_HALVINGS = 4  # of intervals, at either end: activations change fastest there
_LEAST_SIZE = 1.0e-3  # of the largest force: what a coordinate that needs hardly anything counts
_BISECTIONS = 30  # to the length at which fibres and tendons are in balance
_ACCURACY = 1.0e-6  # of the conditions of the optimum
_FLAT_ACCURACY = 0.1  # of that, where costs are flat at small excitations
_MOST_ITERATIONS = 500
_REFINEMENTS = 2  # of the mesh, at most
_NAMED = 3  # worst places of a trial that cannot be produced


def shared_trial(
    solver: StaticOptimization,
    asked: MuscleDynamics,
    samples: Observations,
    wrenches: Sequence[Array],
    static: Shares,
    measured: Callable[[Array], Array | None],
) -> Shared:
    """The excitations that explain a motion at least cost.

    Args:
        solver: Of the frames one by one.
        wrenches: External loads at its samples.
        static: What static optimisation says of them.
        measured: Measured activations at some stamps [ns].

    Raises:
        DataError: The motion is too short.
        SolveError: Muscles and reserves cannot produce it; names where.
    """
    from mbd_ros.features.muscles.trial_program import MuscleProgram  # the extra compiled

    times = (samples.stamps - samples.stamps[0]) * NANOSECOND
    if len(times) < 4:
        raise DataError(f"{len(times)} frames: dynamics of muscles need at least 4")
    muscles, p = muscles_with(asked, solver.muscles), solver.sharing.criterion.exponent
    count = max(1, math.ceil(times[-1] / asked.interval - 1.0e-6))
    if count > MOST_INTERVALS:
        raise DataError(
            f"{times[-1]:g} s in intervals of {asked.interval:g} s: {count}, accepted are "
            f"{MOST_INTERVALS}; choose a longer interval"
        )
    points = Points(graded(times[-1], count), collocation(RADAU, asked.degree))

    def solved(points: Points, guess: Excited, part: Any = None) -> Optimal:
        trial = known_at(points, solver, muscles, samples, wrenches, measured)
        program = MuscleProgram(muscles, trial, points.scheme, p, part)
        accuracy = _ACCURACY if p == 2.0 else _FLAT_ACCURACY * _ACCURACY
        return program.solve(guess, accuracy, _MOST_ITERATIONS, part is not None)

    announce(f"excitations on {len(points.knots) - 1} intervals")
    guess = first_guess(muscles, points.whole, times, static)
    found = solved(points, guess)
    if not found.is_good:
        begin = float(samples.stamps[0] * NANOSECOND)
        raise SolveError(_why(solver, found, begin + points.times))
    points, found, off = _refined(muscles, points, found, asked.tolerance, solved)
    return _at_samples(solver, muscles, points, found, static, times, off)


class Shared(NamedTuple):
    """A trial at the samples of its motion.

    Attributes:
        shares: As static optimisation gives them.
        excitation: Shape (samples, n).
        fiber_length: Of fibres beside elastic tendons [m], by muscle.
        remarks: What was found, a line each.
    """

    shares: Shares
    excitation: Array
    fiber_length: dict[str, Array]
    remarks: tuple[str, ...]


class Points(NamedTuple):
    """Where a trial is looked at.

    Attributes:
        knots: Ends of the intervals [s], shape (intervals + 1,).
        scheme: The collocation on each.
    """

    knots: Array
    scheme: Collocation

    @property
    def times(self) -> Array:
        """Of the points [s]."""
        h = np.diff(self.knots)[:, None]
        found: Array = (self.knots[:-1, None] + h * self.scheme.c).ravel()
        return found

    @property
    def whole(self) -> Array:
        """The start, then the times of the points [s]."""
        return np.concatenate(([0.0], self.times))

    def states(self, values: Array, t: Array) -> Array:
        """What is continuous, at some times: polynomials through the points and the end before.

        Args:
            values: At the start and at the points.
            t: The times [s].
        """
        stacked = self._stacked(values)
        starts = np.concatenate((values[:1], stacked[:-1, -1]))[:, None]
        interval, s = self._find(t)
        whole = np.concatenate((starts, stacked), axis=1)[interval]
        powers, ends = np.arange(self.scheme.degree + 1), np.concatenate(([0.0], self.scheme.c))
        weights = s[:, None] ** powers @ np.linalg.inv(ends[:, None] ** powers)
        return np.einsum("tk,tki->ti", weights, whole)

    def inputs(self, values: Array, t: Array) -> Array:
        """What jumps from interval to interval, at some times; arguments as `states`."""
        interval, s = self._find(t)
        return np.einsum("tk,tki->ti", self.scheme.values(s), self._stacked(values)[interval])

    def split(self, which: NDArray[np.bool_]) -> tuple[Points, NDArray[np.bool_]]:
        """With some intervals cut in two, and which of the new ones are near a cut."""
        middle = 0.5 * (self.knots[:-1] + self.knots[1:])[which]
        knots = np.sort(np.concatenate((self.knots, middle)))
        inner, reach = 0.5 * (knots[:-1] + knots[1:])[:, None], _NEAR * np.diff(self.knots).max()
        begins, ends = self.knots[:-1][which] - reach, self.knots[1:][which] + reach
        return Points(knots, self.scheme), ((inner > begins) & (inner < ends)).any(axis=1)

    def at_starts(self, values: Array, finer: Points) -> Array:
        """What is given at starts of intervals, at those of finer ones."""
        columns = [np.interp(finer.knots[:-1], self.knots[:-1], one) for one in values.T]
        return np.stack(columns, axis=1)

    def _stacked(self, values: Array) -> Array:
        return values[1:].reshape(len(self.knots) - 1, self.scheme.degree, values.shape[1])

    def _find(self, t: Array) -> tuple[Any, Array]:
        interval = np.clip(np.searchsorted(self.knots, t, "right") - 1, 0, len(self.knots) - 2)
        h = np.diff(self.knots)[interval]
        return interval, (t - self.knots[interval]) / h


def graded(duration: float, count: int) -> Array:
    """Ends of equal intervals, of which the first and the last are halved towards the ends."""
    knots = np.linspace(0.0, duration, count + 1)
    short = knots[1] * 0.5 ** np.arange(_HALVINGS, 0, -1)
    found: Array = np.unique(np.concatenate((knots, short, duration - short)))
    return found


def known_at(
    points: Points,
    solver: StaticOptimization,
    muscles: Sequence[Muscle],
    samples: Observations,
    wrenches: Sequence[Array],
    activations: Callable[[Array], Array | None],
) -> Trial:
    """The motion at the points, by cubic splines through its samples."""
    from scipy.interpolate import CubicSpline

    times = (samples.stamps - samples.stamps[0]) * NANOSECOND
    at = points.whole
    measured = activations(samples.stamps[0] + np.round(at / NANOSECOND).astype(np.int64))
    motion = [CubicSpline(times, values)(at) for values in samples[1:4]]
    for body in IndependentCoordinates(solver.robot, solver.known.couplings).body_y:
        turn = motion[0][:, body[3:7]]
        motion[0][:, body[3:7]] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    loads = [CubicSpline(times, wrench)(at) for wrench in wrenches]
    frames, needed = solver.demand(*motion, loads)
    n = len(muscles)
    columns = frames.columns.copy()
    columns[:, :, n:] *= [reserve.optimal for reserve in solver.reserves]
    prices = solver.sharing.criterion.prices(sizes_of(muscles), frames.active, frames.fiber_speed)
    least = np.tile([float(muscle.dynamics.least) for muscle in muscles], (len(at), 1))
    stiffness, target = np.zeros_like(least), np.zeros_like(least)
    if measured is not None:
        given = np.isfinite(measured)
        target[given] = measured[given]
        if solver.sharing.measured_is_least:
            least = np.where(given, np.clip(target, least, 1.0), least)
        stiffness[given] = solver.sharing.tracking
    largest = np.abs(needed).max(axis=0, initial=0.0)
    sizes = np.maximum(largest, _LEAST_SIZE * largest.max(initial=0.0))
    return Trial(
        *(np.diff(points.knots), frames.length, *rigid_tensions(muscles, frames), columns, needed),
        *(np.where(sizes > 0.0, sizes, 1.0), np.array(prices), stiffness, target, least),
        np.array([reserve.limits for reserve in solver.reserves]).reshape(-1, 2).T,
    )


def rigid_tensions(muscles: Sequence[Muscle], frames: Frames) -> tuple[Array, Array]:
    """Tensions beside rigid tendons at full activation less those without, and these [N]."""
    k, none = ArrayNumbers, np.zeros_like(frames.length)
    strength, offset = none, none.copy()
    for i, muscle in enumerate(muscles):
        law, length, speed = muscle.contraction, frames.length[:, i], frames.speed[:, i]
        if not muscle.is_elastic:
            fiber = law.beside_rigid_tendon(k, length, speed)
            taut = (length - law.slack > law.pennation.reach) * fiber.cosine
            strength[:, i] = law.active(k, 1.0, fiber) * taut
            offset[:, i] = (law.passive(k, fiber) + law.damping(fiber)) * taut
    return strength, offset


def first_guess(muscles: Sequence[Muscle], at: Array, times: Array, static: Shares) -> Excited:
    """Excitations as activations of frames one by one, fibres at rest beside their tendons."""
    every = static.activation, static.frames.length
    activation, length = (
        np.stack([np.interp(at, times, column) for column in values.T], axis=1) for values in every
    )
    elastic = [i for i, muscle in enumerate(muscles) if muscle.is_elastic]
    fibers, speeds = np.zeros((2, len(at), len(elastic)))
    for column, i in enumerate(elastic):
        law = muscles[i].contraction
        fibers[:, column] = _at_rest(law, activation[:, i], length[:, i])
        speeds[:, column] = np.gradient(fibers[:, column], at) / law.fastest
    efforts = np.zeros((len(at), static.reserve.shape[1]))
    return Excited(activation, activation, efforts, fibers, speeds)


def _at_rest(law: Contraction, activation: Array, length: Array) -> Array:
    """Lengths at which fibres and tendons are in balance [m], by bisection."""
    k, short = ArrayNumbers, np.full_like(length, max(law.pennation.shortest, 0.1 * law.optimal))
    long = np.maximum(law.pennation.fiber(k, length - law.slack), 1.01 * short)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (short + long)
        fiber = Fiber(middle, law.cosine(k, middle), 0.0 * middle)
        along = law.active(k, activation, fiber) + law.passive(k, fiber)
        pulls = law.tendon(k, length, middle) > along * fiber.cosine
        short, long = np.where(pulls, middle, short), np.where(pulls, long, middle)
    return 0.5 * (short + long)


def _why(solver: StaticOptimization, found: Optimal, at: Array) -> str:
    """What could not be produced, and where."""
    names = solver.known.couplings.independent
    worst = np.argsort(found.lacking, axis=None)[::-1][:_NAMED]
    places = [np.unravel_index(one, found.lacking.shape) for one in worst]
    said = ", ".join(
        f"{names[j] if j < len(names) else f'coordinate {j}'} at {at[i]:.3f} s "
        f"({100.0 * found.lacking[i, j]:.2g} % of its largest force)"
        for i, j in places
        if found.lacking[i, j] > _ACCURACY
    )
    return (
        f"dynamics of muscles: no solution after {found.iterations} iterations "
        f"({found.status}); " + (f"what lacks most: {said}; give reserves" if said else "")
    )


def _refined(
    muscles: Sequence[Muscle],
    points: Points,
    found: Optimal,
    tolerance: float,
    solved: Callable[..., Optimal],
) -> tuple[Points, Optimal, float]:
    """Solved again on halves of intervals and beside them, where errors are larger than that."""
    from mbd_ros.features.muscles.trial_program import Part

    off = between(muscles, points, found.excited)
    for _ in range(_REFINEMENTS):
        if off.max() <= tolerance:
            break
        finer, is_near = points.split(off > tolerance)
        announce(f"excitations again on {is_near.sum()} of {len(is_near)} intervals")
        part = Part(is_near, points.at_starts(found.slopes, finer))
        guess = moved(points, found.excited, finer.whole)
        better = solved(finer, guess, part)
        if not better.is_good:
            break
        largest = max(found.residual, better.residual)
        points, found = finer, better._replace(residual=largest)
        off = between(muscles, points, found.excited)
    return points, found, float(off.max())


def between(muscles: Sequence[Muscle], points: Points, found: Excited) -> Array:
    """Largest error of the activations over each interval, by their defect between the points.

    Args:
        points: Where they are looked at.
        found: What they do there.
    """
    ends = np.concatenate(([0.0], points.scheme.c))
    inner, h = 0.5 * (ends[1:] + ends[:-1]), np.diff(points.knots)[:, None]
    t, short = (points.knots[:-1, None] + h * inner).ravel(), 1.0e-4 * h.min()
    before, after = (points.states(found.activation, t + way * short) for way in (-1.0, 1.0))
    a, e = 0.5 * (before + after), points.inputs(found.excitation, t)
    rates = [m.dynamics.rate(ArrayNumbers, e[:, i], a[:, i]) for i, m in enumerate(muscles)]
    defect = np.abs((after - before) / (2.0 * short) - np.stack(rates, axis=1)).max(axis=1)
    widest = h[:, 0] * np.diff(ends).max()
    found_: Array = defect.reshape(len(h), -1).max(axis=1) * widest
    return found_


def moved(points: Points, found: Excited, at: Array) -> Excited:
    """What was found, at other times."""
    states = (points.states(values, at) for values in (found.activation, found.fiber_length))
    activation, fibers = states
    inputs = found.excitation, found.effort, found.fiber_speed
    excitation, effort, speed = (points.inputs(values, at) for values in inputs)
    return Excited(activation, excitation, effort, fibers, speed)


def _at_samples(
    solver: StaticOptimization,
    muscles: Sequence[Muscle],
    points: Points,
    found: Optimal,
    static: Shares,
    times: Array,
    off: float,
) -> Shared:
    least = [float(muscle.dynamics.least) for muscle in muscles]
    activation = np.clip(points.states(found.excited.activation, times), least, 1.0)
    lengths = points.states(found.excited.fiber_length, times)
    elastic = [muscle.name for muscle in muscles if muscle.is_elastic]
    fibers = dict(zip(elastic, lengths.T, strict=True))
    frames = static.frames
    strength, offset = rigid_tensions(muscles, frames)
    force = np.maximum(strength * activation + offset, 0.0)
    for i, muscle in enumerate(muscles):
        if muscle.is_elastic:
            law = muscle.contraction
            force[:, i] = law.tendon(ArrayNumbers, frames.length[:, i], fibers[muscle.name])
    reserve, lacking = _reserved(static, force)
    excitation = points.inputs(found.excited.excitation, times)
    count = len(times)
    shares = replace(
        static,
        activation=activation,
        force=force,
        reserve=reserve,
        lacking=lacking,
        objective=np.full(count, found.cost),
        residual=np.full(count, found.residual),
        is_feasible=np.ones(count, dtype=bool),
        movable=((),) * count,
    )
    remarks = (
        f"dynamics: {len(points.knots) - 1} intervals, {found.iterations} iterations on the last "
        f"mesh, cost {found.cost:.6g}, residual {found.residual:.1e}; between points activations "
        f"are off by at most {off:.1e}",
    )
    return Shared(shares, excitation, fibers, remarks)


def _reserved(static: Shares, force: Array) -> tuple[Array, Array]:
    """What reserves add to muscles, shape (samples, reserves), and what is lacking then."""
    columns, n = static.frames.columns, force.shape[1]
    lacking = static.needed - np.einsum("tji,ti->tj", columns[:, :, :n], force)
    reserve = np.einsum("tij,tj->ti", np.linalg.pinv(columns[:, :, n:]), lacking)
    lacking -= np.einsum("tji,ti->tj", columns[:, :, n:], reserve)
    return reserve, lacking
