"""Sharing with the dynamics of activations and tendons, over a whole motion at once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.inverse_dynamics.torque_estimator import Observations
from mbd_ros.core.muscles.array_numbers import ArrayNumbers
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError, SolveError
from mbd_ros.features.muscles.muscle_dynamics import MuscleDynamics, muscles_with
from mbd_ros.features.muscles.muscle_trial import Excited, Optimal
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization
from mbd_ros.features.muscles.trial_error import between
from mbd_ros.features.muscles.trial_guess import first_guess, moved
from mbd_ros.features.muscles.trial_known import known_at, rigid_tensions
from mbd_ros.features.muscles.trial_points import Points, graded
from mbd_ros.jobs.progress import announce
from mbd_ros.optimal_control.collocation import RADAU, collocation

_ACCURACY, _MOST, _ROUNDS = 1.0e-6, 500, 2
_FINER = 0.1  # accuracy where costs are flat at small excitations
_NAMED = 3  # worst places of a trial that cannot be produced


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
        asked: What dynamics.
        samples: The motion.
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
    muscles, p = muscles_with(asked, solver.muscles), solver.wishes.criterion.exponent
    count = max(1, math.ceil(times[-1] / asked.interval - 1.0e-6))
    points = Points(graded(times[-1], count), collocation(RADAU, asked.degree))

    def solved(points: Points, guess: Excited, part: Any = None) -> Optimal:
        trial = known_at(points, solver, muscles, samples, wrenches, measured)
        program = MuscleProgram(muscles, trial, points.scheme, p, part)
        accuracy = _ACCURACY if p == 2.0 else _FINER * _ACCURACY
        return program.solve(guess, accuracy, _MOST, part is not None)

    announce(f"excitations on {len(points.knots) - 1} intervals")
    guess = first_guess(muscles, points.whole, times, static)
    found = solved(points, guess)
    if not found.is_good:
        begin = float(samples.stamps[0] * NANOSECOND)
        raise SolveError(_why(solver, found, begin + points.times))
    points, found, off = _refined(muscles, points, found, asked.tolerance, solved)
    return _at_samples(solver, muscles, points, found, static, times, off)


def _refined(
    muscles: Sequence[Muscle],
    points: Points,
    found: Optimal,
    tolerance: float,
    solved: Callable[..., Optimal],
) -> tuple[Points, Optimal, float]:
    """Solved again on halves of intervals and beside them, where errors are larger than that."""
    from mbd_ros.features.muscles.trial_blocks import Part

    off = between(muscles, points, found.excited)
    for _ in range(_ROUNDS):
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
