"""Muscle forces with the dynamics of activations and tendons, over a whole motion at once.

The motion is known at the points of a mesh; `trial_program` finds the excitations of least cost
that explain it. Intervals in which activations between points have an error above a tolerance are
halved, and solved again with their neighbours.
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

_NEAR = 1.0  # longest intervals beside a halved one: muscles forget within some 0.02 s
_HALVINGS = 4  # of intervals, at either end: activations change fastest there
_LEAST_SIZE = 1.0e-3  # of the largest force: characteristic size of a coordinate without load
_BISECTIONS = 30  # to the length at which fibre and tendon are in equilibrium
_ACCURACY = 1.0e-6  # of the optimality conditions
_FLAT_ACCURACY = 0.1  # factor for costs that are flat at small excitations
_MOST_ITERATIONS = 500
_REFINEMENTS = 2  # of the mesh, at most
_MOST_NAMED = 3  # residual forces that an error names


def shared_trial(
    solver: StaticOptimization,
    dynamics: MuscleDynamics,
    samples: Observations,
    wrenches: Sequence[Array],
    static: Shares,
    measured: Callable[[Array], Array | None],
) -> Shared:
    """Find the excitations of least cost that explain a motion.

    Args:
        solver: Solver of frames one by one.
        dynamics: Dynamics of the muscles, and the mesh.
        samples: The motion.
        wrenches: External loads at its samples.
        static: Solution of static optimisation, from which the search starts.
        measured: Function that gives measured activations at stamps [ns].

    Raises:
        DataError: The motion is too short, or has too many intervals.
        SolveError: Muscles and reserves cannot produce the motion; the message names where.
    """
    from mbd_ros.features.muscles.trial_program import MuscleProgram  # the extra compiled

    times = (samples.stamps - samples.stamps[0]) * NANOSECOND
    if len(times) < 4:
        raise DataError(
            f"dynamics: the motion has {len(times)} frames, dynamics of muscles need at least 4"
        )
    muscles, p = muscles_with(dynamics, solver.muscles), solver.sharing.criterion.exponent
    count = max(1, math.ceil(times[-1] / dynamics.interval - 1.0e-6))
    if count > MOST_INTERVALS:
        raise DataError(
            f"interval: {dynamics.interval:g} s splits {times[-1]:g} s into {count} intervals, "
            f"accepted are at most {MOST_INTERVALS}; choose a longer interval"
        )
    points = Points(graded(times[-1], count), collocation(RADAU, dynamics.degree))

    def solve(points: Points, guess: Excited, part: Any = None) -> Optimal:
        trial = trial_at(points, solver, muscles, samples, wrenches, measured)
        program = MuscleProgram(muscles, trial, points.scheme, p, part)
        accuracy = _ACCURACY if p == 2.0 else _FLAT_ACCURACY * _ACCURACY
        return program.solve(guess, accuracy, _MOST_ITERATIONS, part is not None)

    announce(f"excitations on {len(points.knots) - 1} intervals")
    guess = first_guess(muscles, points.times_with_start, times, static)
    solution = solve(points, guess)
    if not solution.is_good:
        begin = float(samples.stamps[0] * NANOSECOND)
        raise SolveError(_failure(solver, solution, begin + points.times))
    points, solution, error = _refine(muscles, points, solution, dynamics.tolerance, solve)
    return _at_samples(muscles, points, solution, static, times, error)


class Shared(NamedTuple):
    """Solution of a trial at the samples of its motion.

    Attributes:
        shares: Shares of muscles and reserves.
        excitation: Excitations, shape (samples, n).
        fiber_length: Fibre lengths beside elastic tendons [m], by muscle.
        remarks: Lines for people.
    """

    shares: Shares
    excitation: Array
    fiber_length: dict[str, Array]
    remarks: tuple[str, ...]


class Points(NamedTuple):
    """Mesh of a trial.

    Attributes:
        knots: Ends of the intervals [s], shape (intervals + 1,).
        scheme: Collocation on each interval.
    """

    knots: Array
    scheme: Collocation

    @property
    def times(self) -> Array:
        """Times of the points [s]."""
        h = np.diff(self.knots)[:, None]
        times: Array = (self.knots[:-1, None] + h * self.scheme.c).ravel()
        return times

    @property
    def times_with_start(self) -> Array:
        """Time of the start, then the times of the points [s]."""
        return np.concatenate(([0.0], self.times))

    def states(self, values: Array, t: Array) -> Array:
        """Interpolate states by polynomials through the points and the end of the interval before.

        Args:
            values: Values at the start and at the points.
            t: Times [s].
        """
        stacked = self._stacked(values)
        starts = np.concatenate((values[:1], stacked[:-1, -1]))[:, None]
        interval, s = self._find(t)
        on_interval = np.concatenate((starts, stacked), axis=1)[interval]
        powers, ends = np.arange(self.scheme.degree + 1), np.concatenate(([0.0], self.scheme.c))
        weights = s[:, None] ** powers @ np.linalg.inv(ends[:, None] ** powers)
        return np.einsum("tk,tki->ti", weights, on_interval)

    def inputs(self, values: Array, t: Array) -> Array:
        """Interpolate inputs, which jump between intervals; the arguments are as for states."""
        interval, s = self._find(t)
        return np.einsum("tk,tki->ti", self.scheme.values(s), self._stacked(values)[interval])

    def split(self, which: NDArray[np.bool_]) -> tuple[Points, NDArray[np.bool_]]:
        """Halve some intervals; also return which of the new intervals are near a halved one."""
        middle = 0.5 * (self.knots[:-1] + self.knots[1:])[which]
        knots = np.sort(np.concatenate((self.knots, middle)))
        inner, reach = 0.5 * (knots[:-1] + knots[1:])[:, None], _NEAR * np.diff(self.knots).max()
        begins, ends = self.knots[:-1][which] - reach, self.knots[1:][which] + reach
        return Points(knots, self.scheme), ((inner > begins) & (inner < ends)).any(axis=1)

    def at_starts(self, values: Array, finer: Points) -> Array:
        """Interpolate values at the starts of intervals to the starts of finer intervals."""
        columns = [np.interp(finer.knots[:-1], self.knots[:-1], row) for row in values.T]
        return np.stack(columns, axis=1)

    def _stacked(self, values: Array) -> Array:
        return values[1:].reshape(len(self.knots) - 1, self.scheme.degree, values.shape[1])

    def _find(self, t: Array) -> tuple[Any, Array]:
        interval = np.clip(np.searchsorted(self.knots, t, "right") - 1, 0, len(self.knots) - 2)
        h = np.diff(self.knots)[interval]
        return interval, (t - self.knots[interval]) / h


def graded(duration: float, count: int) -> Array:
    """Return the ends of equal intervals, halved repeatedly at the start and the end."""
    knots = np.linspace(0.0, duration, count + 1)
    short = knots[1] * 0.5 ** np.arange(_HALVINGS, 0, -1)
    graded_knots: Array = np.unique(np.concatenate((knots, short, duration - short)))
    return graded_knots


def trial_at(
    points: Points,
    solver: StaticOptimization,
    muscles: Sequence[Muscle],
    samples: Observations,
    wrenches: Sequence[Array],
    activations: Callable[[Array], Array | None],
) -> Trial:
    """Evaluate the motion at the points, by cubic splines through its samples."""
    from scipy.interpolate import CubicSpline

    times = (samples.stamps - samples.stamps[0]) * NANOSECOND
    at = points.times_with_start
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
        has_value = np.isfinite(measured)
        target[has_value] = measured[has_value]
        if solver.sharing.measured_is_least:
            least = np.where(has_value, np.clip(target, least, 1.0), least)
        stiffness[has_value] = solver.sharing.tracking
    largest = np.abs(needed).max(axis=0, initial=0.0)
    sizes = np.maximum(largest, _LEAST_SIZE * largest.max(initial=0.0))
    return Trial(
        *(np.diff(points.knots), frames.length, *rigid_tensions(muscles, frames), columns, needed),
        *(np.where(sizes > 0.0, sizes, 1.0), np.array(prices), stiffness, target, least),
        np.array([reserve.limits for reserve in solver.reserves]).reshape(-1, 2).T,
    )


def rigid_tensions(muscles: Sequence[Muscle], frames: Frames) -> tuple[Array, Array]:
    """Return slope and offset of tensions beside rigid tendons over the activation [N]."""
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
    """Guess excitations from static activations, and fibres at rest beside their tendons."""
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
    """Find the fibre lengths at which fibres and tendons are in equilibrium [m], by bisection."""
    k, short = ArrayNumbers, np.full_like(length, max(law.pennation.shortest, 0.1 * law.optimal))
    long = np.maximum(law.pennation.fiber(k, length - law.slack), 1.01 * short)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (short + long)
        fiber = Fiber(middle, law.cosine(k, middle), 0.0 * middle)
        along = law.active(k, activation, fiber) + law.passive(k, fiber)
        pulls = law.tendon(k, length, middle) > along * fiber.cosine
        short, long = np.where(pulls, middle, short), np.where(pulls, long, middle)
    return 0.5 * (short + long)


def _failure(solver: StaticOptimization, solution: Optimal, at: Array) -> str:
    """Return the message of a failed solution, with its largest residual forces."""
    names = solver.known.couplings.independent
    worst = np.argsort(solution.lacking, axis=None)[::-1][:_MOST_NAMED]
    places = [np.unravel_index(index, solution.lacking.shape) for index in worst]
    residuals = ", ".join(
        f"{names[j] if j < len(names) else f'coordinate {j}'} at {at[i]:.3f} s "
        f"({100.0 * solution.lacking[i, j]:.2g} % of its largest force)"
        for i, j in places
        if solution.lacking[i, j] > _ACCURACY
    )
    return (
        f"dynamics of muscles: no solution after {solution.iterations} iterations "
        f"({solution.status})"
        + (f"; largest residual forces: {residuals}; add reserves" if residuals else "")
    )


def _refine(
    muscles: Sequence[Muscle],
    points: Points,
    solution: Optimal,
    tolerance: float,
    solve: Callable[..., Optimal],
) -> tuple[Points, Optimal, float]:
    """Halve the intervals with errors above a tolerance, and solve them and their neighbours."""
    from mbd_ros.features.muscles.trial_program import Part

    errors = interval_errors(muscles, points, solution.excited)
    for _ in range(_REFINEMENTS):
        if errors.max() <= tolerance:
            break
        finer, is_near = points.split(errors > tolerance)
        announce(f"excitations again on {is_near.sum()} of {len(is_near)} intervals")
        part = Part(is_near, points.at_starts(solution.slopes, finer))
        guess = interpolate(points, solution.excited, finer.times_with_start)
        better = solve(finer, guess, part)
        if not better.is_good:
            break
        largest = max(solution.residual, better.residual)
        points, solution = finer, better._replace(residual=largest)
        errors = interval_errors(muscles, points, solution.excited)
    return points, solution, float(errors.max())


def interval_errors(muscles: Sequence[Muscle], points: Points, excited: Excited) -> Array:
    """Estimate the largest error of the activations in each interval from their defects."""
    ends = np.concatenate(([0.0], points.scheme.c))
    inner, h = 0.5 * (ends[1:] + ends[:-1]), np.diff(points.knots)[:, None]
    t, short = (points.knots[:-1, None] + h * inner).ravel(), 1.0e-4 * h.min()
    before, after = (points.states(excited.activation, t + side * short) for side in (-1.0, 1.0))
    a, e = 0.5 * (before + after), points.inputs(excited.excitation, t)
    rates = [m.dynamics.rate(ArrayNumbers, e[:, i], a[:, i]) for i, m in enumerate(muscles)]
    defect = np.abs((after - before) / (2.0 * short) - np.stack(rates, axis=1)).max(axis=1)
    widest = h[:, 0] * np.diff(ends).max()
    errors: Array = defect.reshape(len(h), -1).max(axis=1) * widest
    return errors


def interpolate(points: Points, excited: Excited, at: Array) -> Excited:
    """Return states and inputs at other times [s]."""
    states = (points.states(values, at) for values in (excited.activation, excited.fiber_length))
    activation, fibers = states
    inputs = excited.excitation, excited.effort, excited.fiber_speed
    excitation, effort, speed = (points.inputs(values, at) for values in inputs)
    return Excited(activation, excitation, effort, fibers, speed)


def _at_samples(
    muscles: Sequence[Muscle],
    points: Points,
    solution: Optimal,
    static: Shares,
    times: Array,
    error: float,
) -> Shared:
    least = [float(muscle.dynamics.least) for muscle in muscles]
    activation = np.clip(points.states(solution.excited.activation, times), least, 1.0)
    lengths = points.states(solution.excited.fiber_length, times)
    elastic = [muscle.name for muscle in muscles if muscle.is_elastic]
    fibers = dict(zip(elastic, lengths.T, strict=True))
    frames = static.frames
    strength, offset = rigid_tensions(muscles, frames)
    force = np.maximum(strength * activation + offset, 0.0)
    for i, muscle in enumerate(muscles):
        if muscle.is_elastic:
            law = muscle.contraction
            force[:, i] = law.tendon(ArrayNumbers, frames.length[:, i], fibers[muscle.name])
    reserve, lacking = _reserve_forces(static, force)
    excitation = points.inputs(solution.excited.excitation, times)
    count = len(times)
    shares = replace(
        static,
        activation=activation,
        force=force,
        reserve=reserve,
        lacking=lacking,
        objective=np.full(count, solution.cost),
        residual=np.full(count, solution.residual),
        is_feasible=np.ones(count, dtype=bool),
        movable=((),) * count,
    )
    remarks = (
        f"dynamics: {len(points.knots) - 1} intervals, {solution.iterations} iterations on the "
        f"last mesh, cost {solution.cost:.6g}, residual {solution.residual:.1e}; between points "
        f"activations are off by at most {error:.1e}",
    )
    return Shared(shares, excitation, fibers, remarks)


def _reserve_forces(static: Shares, force: Array) -> tuple[Array, Array]:
    """Return the forces of reserves, shape (samples, r), and the residual forces."""
    columns, n = static.frames.columns, force.shape[1]
    lacking = static.needed - np.einsum("tji,ti->tj", columns[:, :, :n], force)
    reserve = np.einsum("tij,tj->ti", np.linalg.pinv(columns[:, :, n:]), lacking)
    lacking -= np.einsum("tji,ti->tj", columns[:, :, n:], reserve)
    return reserve, lacking
