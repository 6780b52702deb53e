"""Filtered rows of recordings: base parameters, candidates of friction, torques."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.features.identification.band import Filter, grid_step
from mbd_ros.features.identification.base_parameters import BaseParameters
from mbd_ros.features.identification.friction import Column, columns_of
from mbd_ros.features.identification.loop_regressor import LoopRegressor
from mbd_ros.features.identification.motors import Motors
from mbd_ros.features.identification.regressor import Regressor
from mbd_ros.features.identification.samples import Piece

_STILL = 0.01  # of the largest velocity of a joint: below, it rests
_MOVING = 0.5  # of a window of the filter, the least that is kept
_CHUNK = 4000  # samples of the grid that are asked for at once


class Block(NamedTuple):
    """Filtered rows that follow each other.

    Attributes:
        X: Columns of the base parameters, shape (n, m, r).
        F: Candidates of friction of each row, shape (n, k) each.
        Y: Torques with a delay each, shape (n, m, delays).
        kept: Which of the n x m rows count, shape (n, m).
        known: What is known of the torques and taken out of them, shape (n, m).
    """

    X: Array
    F: list[Array]
    Y: Array
    kept: NDArray[np.bool_]
    known: Array


class RowMaker:
    """Makes rows of pieces.

    Args:
        regressor: Of the scene.
        base: Its base parameters.
        rows: Rows of the regressor that are used, shape (m,).
        columns: Candidates of friction of each of them; none of a row without a joint.
        joints: Place of each of these rows among the independent joints, -1 of no effort.
        peak: Largest speed of the motor of each, shape (m,).
        motors: Of these rows.
    """

    def __init__(
        self,
        regressor: Regressor | LoopRegressor,
        base: BaseParameters,
        rows: NDArray[np.intp],
        columns: Sequence[tuple[Column, ...]],
        joints: NDArray[np.intp],
        peak: Array,
        motors: Motors,
    ) -> None:
        self.regressor, self.base, self.rows = regressor, base, rows
        self.coordinates = regressor.coordinates[rows]
        self.columns, self.joints, self.peak = columns, joints, peak
        self.motors = motors
        self.carried: Array | None = None  # inertial numbers that are known, of all bodies

    def blocks(self, piece: Piece, band: float | None, delays: Array) -> Iterator[Block]:
        """Rows of a piece through the filter of its band; without a band all its samples."""
        rate = 1.0 / float(np.median(np.diff(piece.times)))
        step = 1 if band is None else grid_step(rate, band)
        grid = np.arange(0, len(piece.times), step)
        low = None if band is None else Filter.of(rate / step, band)
        if low is None:
            chunks = [grid[i : i + _CHUNK] for i in range(0, len(grid), _CHUNK)]
        else:
            chunks = _overlapping(grid, low)
        for chunk in chunks:
            X, F, Y, moves, known = self._plain(piece, chunk, delays)
            if low is None:
                yield Block(X, F, Y, moves, known)
                continue
            passed = low.passed(moves.astype(np.float64))
            X, F, Y = low.passed(X), [low.passed(f) for f in F], low.passed(Y)
            yield Block(X, F, Y, passed >= _MOVING, low.passed(known))

    def _plain(
        self, piece: Piece, at: NDArray[np.intp], delays: Array
    ) -> tuple[Array, list[Array], Array, NDArray[np.bool_], Array]:
        """Rows of samples before the filter, and which joints move."""
        y, v, a = piece.y[at], piece.v[at], piece.a[at]
        W = self.regressor.rows(y, v, a)
        known = self.regressor.known(W, y, v, a, [load[at] for load in piece.loads])[:, self.rows]
        for carried in (self.carried, piece.carried):
            if carried is not None:
                known = known + W[:, self.rows] @ carried
        X = np.ascontiguousarray(W[:, self.rows][:, :, self.base.chosen])
        effort = np.zeros((len(at), len(self.rows), len(delays)))
        for i, joint in enumerate(self.joints):
            if joint >= 0:
                for k, delay in enumerate(delays):
                    late = piece.times[at] + delay
                    effort[:, i, k] = np.interp(late, piece.times, piece.effort[:, joint])
        weight = self.regressor.weight(y)[:, self.rows]
        v, a = v[:, self.coordinates], a[:, self.coordinates]
        if self.motors.are_coupled:
            X, known, weight, effort, v, a = self._of_motors(X, known, weight, effort, v, a)
        each = zip(self.columns, v.T, a.T, weight.T, strict=True)
        F = [columns_of(own, rate, push, load) for own, rate, push, load in each]
        moves = np.abs(v) > _STILL * self.peak
        moves[:, self.peak == 0.0] = True
        moves[:, self.joints < 0] = True
        Y = effort - known[:, :, None]
        return X, F, Y, moves, known

    def _of_motors(
        self, X: Array, known: Array, weight: Array, effort: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """All of them for motors in place of joints."""
        motors = self.motors
        turned = np.swapaxes(motors.torques(np.swapaxes(X, 1, 2)), 1, 2)
        told = np.swapaxes(motors.from_measured(np.swapaxes(effort, 1, 2)), 1, 2)
        known, weight = motors.torques(known), motors.torques(weight)
        return turned, known, weight, told, motors.speeds(v), motors.speeds(a)


def _overlapping(grid: NDArray[np.intp], low: Filter) -> Iterator[NDArray[np.intp]]:
    """Chunks of a grid whose windows together are those of all of it."""
    starts = low.starts(len(grid))
    count = max(_CHUNK // low.step, 1)
    for first in range(0, len(starts), count):
        some = starts[first : first + count]
        yield grid[some[0] : some[-1] + len(low.taps)]
