"""Training samples, scales of their quantities, and the validation of predictions by blocks.

Networks take positions, velocities and accelerations divided by their scales, and return torques
divided by theirs. Structured networks start from scales of the root of inertia, D, and of the
potential energy V.

How far a prediction is trusted is measured on blocks of time. Each member of an ensemble leaves
one block out. The predictions of all members for their blocks together form a prediction of all
samples that none of them was fitted to. Each joint gets the factor of its predicted torque that
explains most of these samples; the factor is 0 unless nearly all blocks improve (one-sided t test
at 1 %, because there are several joints).

Source: D. Wolpert, Neural Networks 5, 1992, 241 (predictions of left-out parts as a measure).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array

ReportProgress = Callable[[float], None]
"""Callback that receives the share of the work that is done."""

CURVES = (0.02, 0.1, 0.5)  # of the RMS velocity: bends of the curves of dry friction
FINE_CURVES = (0.005, 0.01, 0.02, 0.04, 0.1, 0.25, 0.5)  # the same for adapters, which are linear
LEAST_INERTIA = 1.0e-3  # e, of the scale of inertia
_SLOW = 0.05  # of the RMS velocity: where dry friction changes its sign
_LEAST_SIZE = 1.0e-6  # of the largest scale: the scale of a joint at rest
_LEAST_GAIN = 0.1  # of the squared residual: a smaller gain is not worth a network
_STUDENT = {2: 31.8, 3: 6.96, 4: 4.54, 5: 3.75}  # one-sided 1 % points, by number of blocks
_NORMAL = 3.4  # the same for more blocks


class Samples(NamedTuple):
    """Training samples, one sample per row and one joint per column.

    Attributes:
        times: Times [s], shape (n,).
        q: Positions [rad or m], shape (n, m).
        v: Velocities, same shape.
        a: Accelerations, same shape.
        effort: Low-passed efforts [N·m or N], same shape.
        measured: Efforts without the low-pass.
        physics: Torques of the scene.
        y: Independent coordinates of the entire robot, shape (n, ny).
        w: Their velocities, shape (n, nv_y).
        push: Their accelerations, same shape.
    """

    times: Array
    q: Array
    v: Array
    a: Array
    effort: Array
    measured: Array
    physics: Array
    y: Array
    w: Array
    push: Array

    def at(self, rows: Any) -> "Samples":
        """Return some of the rows."""
        return Samples(*(values[rows] for values in self))

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.times)


class Scales(NamedTuple):
    """Scales of the inputs and outputs of a network.

    Attributes:
        centre: Middle of the positions [rad or m], shape (m,).
        q: Half of their range, same shape.
        v: Root mean square of the velocities.
        slow: Velocity at which dry friction has 76 % of its size.
        a: Root mean square of the accelerations.
        torque: Root mean square of the torque to be learned [N·m or N].
    """

    centre: Array
    q: Array
    v: Array
    slow: Array
    a: Array
    torque: Array

    @classmethod
    def of(cls, samples: Samples, target: Array) -> "Scales":
        """Return the scales of samples and of a torque to be learned, shape (n, m)."""
        low, high = samples.q.min(axis=0), samples.q.max(axis=0)
        half = _positive(0.5 * (high - low))
        v, a, torque = (_positive(_rms(x)) for x in (samples.v, samples.a, target))
        return cls(0.5 * (low + high), half, v, _SLOW * v, a, torque)


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def _positive(sizes: Array) -> Array:
    """Return sizes without zeros, by which one can divide."""
    largest = float(sizes.max(initial=0.0)) or 1.0
    return np.asarray(np.maximum(sizes, _LEAST_SIZE * largest))


def friction_curves(v: Array, scales: Scales, bends: Sequence[float] = CURVES) -> Array:
    """Return friction curves of each joint, dry ones, then the viscous one, (n, m, curves)."""
    ratio = v / scales.v
    return np.stack([*(np.tanh(ratio / bend) for bend in bends), ratio], axis=-1)


def inertia_scale(scales: Scales) -> Array:
    """Return D, the root of torque over acceleration, shape (m,)."""
    return np.asarray(np.sqrt(scales.torque / scales.a))


def energy_scale(scales: Scales) -> float:
    """Return the scale of V [J]."""
    return float(np.mean(scales.torque * scales.q))


def trusted_share(predicted: Array, target: Array, blocks: int, together: bool) -> Array:
    """Return the factor of the predicted torque of each joint, 0 .. 1, shape (m,).

    Args:
        predicted: Predictions for samples that were left out, shape (n, m).
        target: Torques of these samples, same shape.
        blocks: Number of blocks of time that were left out, one after another.
        together: Whether all joints share one factor.
    """
    u, y, block = predicted, target, blocks_of(len(predicted), blocks)

    def sums(values: Array) -> Array:
        parts = np.array([values[block == i].sum(axis=0) for i in range(blocks)])
        if together:
            return np.repeat(parts.sum(axis=1)[:, None], u.shape[1], axis=1)
        return parts

    share = np.clip(sums(u * y).sum(axis=0) / np.maximum(sums(u * u).sum(axis=0), 1e-300), 0, 1)
    explains = _surely_less(sums(np.square(y - share * u)), sums(np.square(y)))
    return np.asarray(np.where(explains, share, 0.0))


def blocks_of(count: int, members: int) -> Array:
    """Return the index of the member that leaves each sample out, in blocks of time, (n,)."""
    return np.asarray(np.minimum(np.arange(count) * members // max(count, 1), members - 1))


def _surely_less(after: Array, before: Array) -> Any:
    """Return whether each column of errors of blocks is significantly smaller, (blocks, ..)."""
    gain = 1.0 - after / np.maximum(before, 1.0e-300)
    error = gain.std(axis=0, ddof=1) / np.sqrt(len(gain))
    is_sure = gain.mean(axis=0) > _STUDENT.get(len(gain), _NORMAL) * error
    return is_sure & (after.sum(axis=0) < (1.0 - _LEAST_GAIN) * before.sum(axis=0))


def is_better(squares: Array, best: Array) -> bool:
    """Return whether errors of blocks are smaller, significantly and by a relevant amount.

    Args:
        squares: Sum of squares of each block, shape (blocks,).
        best: The same for the method to compare with.
    """
    return bool(_surely_less(squares, best))
