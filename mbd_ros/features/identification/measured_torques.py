"""Torques as they were measured, beside those that scenes say, and what drives add to them.

The controller of a drive damps what it takes for motion, noise included:

    tau = model(q, v, a) - feedback (v_measured - v)

with v the velocity behind the zero-phase low-pass that the motion asks for. That part of the
torque moves nothing, and no model of bodies has it.

Source: L. Ljung, System Identification, 1999, section 13.4 (noise in a closed loop).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.inertial_parameters import parameters_of
from mbd_ros.core.state import Array
from mbd_ros.features.identification.problem import Problem, regressor_of
from mbd_ros.features.identification.samples import Piece
from mbd_ros.scene.built_scene import Scene

_MOST = 20_000  # samples of a piece that are compared, evenly taken
_ENOUGH = 10_000  # samples that tell a feedback
_OUTLIER = 4.5  # times the median size: such samples, as at a start, tell no feedback
_ROUNDING = 1.0e-9  # of the largest velocity: no noise
_FEWEST = 20  # samples that tell one at all


class Measured(NamedTuple):
    """Samples of the rows of a problem.

    Attributes:
        times: [s], shape (n,).
        effort: Measured [N·m or N], shape (n, m).
        predictions: What each scene says of it, shape (n, m) each.
        noise: Measured velocity less that of the motion [rad/s or m/s], shape (n, m).
    """

    times: Array
    effort: Array
    predictions: list[Array]
    noise: Array


def as_measured(
    problem: Problem, scenes: Sequence[Scene], pieces: Sequence[Piece], delay: float
) -> Measured | None:
    """All samples of pieces, or evenly some; None without any."""
    found = [_of_piece(problem, scenes, piece, delay, _MOST) for piece in pieces]
    return _joined(found) if found else None


def feedback_of(
    problem: Problem, scene: Scene, pieces: Sequence[Piece], delay: float
) -> tuple[Array, Array]:
    """What each row answers to a unit of noise, >= 0, and its standard deviation, shape (m,).

    It counts where it is worth its price by Schwarz's information criterion.

    Args:
        problem: The rows.
        scene: What was found.
        pieces: Those that were learned from.
        delay: Of efforts against motion [s].
    """
    found = _joined([_of_piece(problem, [scene], p, delay, _ENOUGH) for p in pieces])
    left = found.effort - found.predictions[0]
    slopes = [_slope(noise, y) for noise, y in zip(found.noise.T, left.T, strict=True)]
    return np.array([s for s, _ in slopes]), np.array([d for _, d in slopes])


def _slope(noise: Array, left: Array) -> tuple[float, float]:
    """Of - left over noise, and its deviation; 0 where it is none."""
    usual = left - np.median(left)
    kept = np.abs(usual) <= _OUTLIER * np.median(np.abs(usual))
    x, y, n = noise[kept], usual[kept], int(kept.sum())
    power = float(x @ x)
    if n < _FEWEST or power == 0.0:
        return 0.0, 0.0
    slope = float(-(x @ y)) / power
    rest = float(np.sum(np.square(y + slope * x)))
    is_worth = n * np.log(max(float(y @ y), 1e-300) / max(rest, 1e-300)) > np.log(n)
    if slope <= 0.0 or not is_worth:
        return 0.0, 0.0
    return slope, float(np.sqrt(rest / n / power))


def _joined(found: Sequence[Measured]) -> Measured:
    """Samples of several pieces, one after the other."""
    count = len(found[0].predictions)
    return Measured(
        np.concatenate([one.times for one in found]),
        np.concatenate([one.effort for one in found]),
        [np.concatenate([one.predictions[k] for one in found]) for k in range(count)],
        np.concatenate([one.noise for one in found]),
    )


def _of_piece(
    problem: Problem, scenes: Sequence[Scene], piece: Piece, delay: float, most: int
) -> Measured:
    grid = np.arange(0, len(piece.times), max(len(piece.times) // most, 1))
    times, at = piece.times[grid], problem.joints
    motion = piece.y[grid], piece.v[grid], piece.a[grid]
    loads = [load[grid] for load in piece.loads]
    said = [torques(scene, problem, motion, loads, piece.carried) for scene in scenes]
    noise = np.zeros((len(grid), len(problem.rows)))
    own = problem.maker.coordinates
    noise[:, at >= 0] = (piece.rate[grid][:, at] - motion[1][:, own])[:, at >= 0]
    is_rounding = np.abs(noise) < _ROUNDING * np.abs(motion[1][:, own]).max(axis=0)
    noise[~np.isfinite(noise) | is_rounding] = 0.0
    effort = efforts(problem, piece, piece.measured, grid, 0.0)
    predictions = [_later(times, values, delay) for values in said]
    return Measured(times, effort, predictions, _later(times, noise, delay))


def _later(times: Array, values: Array, delay: float) -> Array:
    """What is measured of values that arrive later; efforts keep their noise so."""
    if not delay:
        return values
    return np.transpose([np.interp(times - delay, times, column) for column in values.T])


def torques(
    scene: Scene,
    problem: Problem,
    motion: tuple[Array, Array, Array],
    loads: list[Array],
    carried: Array | None,
) -> Array:
    """What a scene says of the efforts of the rows, shape (n, m)."""
    regressor = regressor_of(scene, problem.learned)
    W = regressor.rows(*motion)
    inertial = parameters_of(scene.robot.model).ravel()
    moved = inertial if carried is None else inertial + carried
    found: Array = (W @ moved + regressor.known(W, *motion, loads))[:, problem.rows]
    return problem.motors.measured(found)


def efforts(
    problem: Problem, piece: Piece, values: Array, grid: NDArray[np.intp], delay: float
) -> Array:
    """Efforts of the rows at the times of the motion, 0 of rows without any, shape (n, m)."""
    found = np.zeros((len(grid), len(problem.rows)))
    for k, joint in enumerate(problem.joints):
        if joint >= 0 and delay:
            found[:, k] = np.interp(piece.times[grid] + delay, piece.times, values[:, joint])
        elif joint >= 0:
            found[:, k] = values[grid, joint]
    return found
