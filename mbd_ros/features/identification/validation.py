"""Test of an identification on what was not learned from, in the band and as measured."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.identification.band import Filter, grid_step
from mbd_ros.features.identification.measured_torques import (
    Measured,
    as_measured,
    efforts,
    feedback_of,
    torques,
)
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import Learned, residual
from mbd_ros.features.identification.samples import Piece
from mbd_ros.files.table import Column, Table
from mbd_ros.scene.built_scene import Scene

_MOST = 200_000  # samples of the test
_LEAST = 1e-300


class Tested(NamedTuple):
    """What a test says.

    Attributes:
        errors: Shares of the torque, see `Identified.errors`; empty without a test.
        table: A joint a row.
        feedback: What drives answer to noise of the measured velocity, and its deviation
            [N·m·s/rad or N·s/m], shape (m,) each.
        residuals: See `Identified`.
    """

    errors: dict[str, float]
    table: Table
    feedback: tuple[Array, Array]
    residuals: tuple[Array, Array, Array, Array] | None


def tested(scene: Scene, new: Scene, problem: Problem, found: Learned) -> Tested:
    """Errors of a new scene and the given one on what is left.

    Args:
        scene: As it was given.
        new: What was found.
        problem: The rows.
        found: Least squares.
    """
    names, delay = Column("joint", np.array(list(problem.labels))), found.delay
    none = np.zeros(len(problem.rows))
    low = [_in_band(scene, new, problem, piece, delay) for piece in problem.tested()]
    kept = [one for one in low if one is not None]
    raw = as_measured(problem, (new, scene), problem.recorded(problem.left), delay)
    if not kept or raw is None:
        return Tested({}, Table([names]), (none, none), None)
    feedback = feedback_of(problem, new, problem.recorded(problem.learned), delay)
    answered = raw._replace(predictions=[p - feedback[0] * raw.noise for p in raw.predictions])
    y, *pair = (np.concatenate([one[k] for one in kept]) for k in range(3))
    errors, columns = _compared(y, pair, "")
    for way, one in ((" as measured", answered), (" without feedback", raw)):
        more, shown = _compared(one.effort, one.predictions, way)
        errors, columns = errors | more, [*columns, *shown]
    price = _least_squares(problem, found)
    errors |= {} if price is None else {"least squares": price}
    return Tested(errors, Table([names, *columns]), feedback, _pictured(answered))


def _pictured(found: Measured) -> tuple[Array, Array, Array, Array]:
    return found.times, found.effort, found.predictions[0], found.predictions[1]


def _compared(
    y: Array, predictions: list[Array], way: str
) -> tuple[dict[str, float], list[Column]]:
    """Shares of all, and of each joint, that the new and the given scene leave."""
    errors, columns = {}, []
    size = np.maximum(np.sqrt(np.mean(np.square(y), axis=0)), _LEAST)
    for who, prediction in zip(("identified", "given"), predictions, strict=True):
        key, off = f"{who}{way}", np.sqrt(np.mean(np.square(prediction - y), axis=0))
        errors[key] = float(np.linalg.norm(prediction - y) / max(np.linalg.norm(y), _LEAST))
        columns.append(Column(f"{key.replace(' ', '_')}.rms", off, "N·m or N"))
        columns.append(Column(f"{key.replace(' ', '_')}.share", 100.0 * off / size, "%"))
    return errors, columns


def _least_squares(problem: Problem, found: Learned) -> float | None:
    """Share of the torque of the test that least squares leave, in the band."""
    left, whole = 0.0, 0.0
    for piece in problem.tested():
        for block in problem.maker.blocks(piece, problem.band, np.array([found.delay])):
            of = problem.motors.as_measured
            left += float(np.sum(np.square(of(residual(block, found.fit)))))
            whole += float(np.sum(np.square(of(block.Y[:, :, 0] + block.known))))
    return float(np.sqrt(left / whole)) if whole > 0.0 else None


def _in_band(
    scene: Scene, new: Scene, problem: Problem, piece: Piece, delay: float
) -> list[Array] | None:
    """Torques measured, identified and given, through the filter; None of too short a piece."""
    band, count = problem.band, len(piece.times)
    rate = 1.0 / float(np.median(np.diff(piece.times)))
    step = 1 if band is None else max(grid_step(rate, band), count // _MOST)
    grid = np.arange(0, count, step)
    loads = [load[grid] for load in piece.loads]
    motion = piece.y[grid], piece.v[grid], piece.a[grid]
    predictions = [torques(one, problem, motion, loads, piece.carried) for one in (new, scene)]
    values = [efforts(problem, piece, piece.effort, grid, delay), *predictions]
    if band is None:
        return values
    low = Filter.of(rate / step, band)
    if not len(low.starts(len(grid))):
        return None
    return [low.passed(one) for one in values]
