"""Samples to learn from, sizes of their quantities, and blocks of time that a fit leaves out.

Networks see positions, velocities and accelerations over their sizes and say torques over theirs.
Structured networks start from the size D of the root of inertia and from that of the energy V.

How much of a prediction is trusted is measured on blocks of time. Each member of an ensemble
leaves a block out. What members say of their blocks, put together, is a prediction of all samples
that none of them was fitted to. A joint gets the share of its torque that explains most there, and
none where that does not explain something in nearly all blocks (one-sided t test, 1 %, since there
are several joints).

Source: D. Wolpert, Neural Networks 5, 1992, 241 (predictions of left-out parts as a measure).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array

Tell = Callable[[float], None]
"""Is told the share of the work that is done."""

CURVES = (0.02, 0.1, 0.5)  # of the usual velocity: where curves of dry friction bend
FINE_CURVES = (0.005, 0.01, 0.02, 0.04, 0.1, 0.25, 0.5)  # the same of adapters, which are linear
LEAST_INERTIA = 1.0e-3  # e, of the usual inertia
_SLOW = 0.05  # of the usual velocity: where dry friction changes its sign
_LEAST_SIZE = 1.0e-6  # of the largest size: a joint that rests
_LEAST_GAIN = 0.1  # of the square of what is left: a smaller gain is not worth a network
_STUDENT = {2: 31.8, 3: 6.96, 4: 4.54, 5: 3.75}  # one-sided 1 % points, by number of blocks
_NORMAL = 3.4  # of more blocks


class Samples(NamedTuple):
    """What is learned from, one sample a row, one joint a column.

    Attributes:
        times: [s], shape (n,).
        q: Positions [rad or m], shape (n, m).
        v: Velocities, same shape.
        a: Accelerations, same shape.
        effort: Low-passed efforts [N·m or N], same shape.
        measured: Efforts as measured.
        physics: Torques of the scene.
        y: Independent coordinates of the whole robot, shape (n, ny).
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
        """Some of the rows."""
        return Samples(*(values[rows] for values in self))

    @property
    def count(self) -> int:
        """How many rows."""
        return len(self.times)


class Scales(NamedTuple):
    """Sizes by which a network sees its inputs and says its outputs.

    Attributes:
        centre: Middle of the positions [rad or m], shape (m,).
        q: Half of what they span, same shape.
        v: Root mean square of the velocities.
        slow: Velocity at which dry friction has 76 % of its size.
        a: Root mean square of the accelerations.
        torque: Root mean square of what is to be learned [N·m or N].
    """

    centre: Array
    q: Array
    v: Array
    slow: Array
    a: Array
    torque: Array

    @classmethod
    def of(cls, samples: Samples, wanted: Array) -> "Scales":
        """The scales of samples and of a torque that is to be learned, shape (n, m)."""
        low, high = samples.q.min(axis=0), samples.q.max(axis=0)
        half = _positive(0.5 * (high - low))
        v, a, torque = (_positive(_rms(x)) for x in (samples.v, samples.a, wanted))
        return cls(0.5 * (low + high), half, v, _SLOW * v, a, torque)


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def _positive(sizes: Array) -> Array:
    """Sizes without zeros, by which one can divide."""
    most = float(sizes.max(initial=0.0)) or 1.0
    return np.asarray(np.maximum(sizes, _LEAST_SIZE * most))


def curves_of(v: Array, scales: Scales, bends: Sequence[float] = CURVES) -> Array:
    """Curves of friction of each joint, shape (n, m, curves): dry ones, then the viscous one."""
    ratio = v / scales.v
    return np.stack([*(np.tanh(ratio / bend) for bend in bends), ratio], axis=-1)


def usual_inertia(scales: Scales) -> Array:
    """D: root of torque over acceleration, shape (m,)."""
    return np.asarray(np.sqrt(scales.torque / scales.a))


def usual_energy(scales: Scales) -> float:
    """Size of V [J]."""
    return float(np.mean(scales.torque * scales.q))


def trusted(unseen: Array, wanted: Array, blocks: int, together: bool) -> Array:
    """Share of the torque of each joint that is to be given, 0 .. 1, shape (m,).

    Args:
        unseen: Predictions of samples that were left out, shape (n, m).
        wanted: What they should be, same shape.
        blocks: Pieces of time that were left out, one after another.
        together: One share for all joints.
    """
    u, y, block = unseen, wanted, blocks_of(len(unseen), blocks)

    def sums(values: Array) -> Array:
        of = np.array([values[block == i].sum(axis=0) for i in range(blocks)])
        return np.repeat(of.sum(axis=1)[:, None], u.shape[1], axis=1) if together else of

    share = np.clip(sums(u * y).sum(axis=0) / np.maximum(sums(u * u).sum(axis=0), 1e-300), 0, 1)
    explains = _surely_less(sums(np.square(y - share * u)), sums(np.square(y)))
    return np.asarray(np.where(explains, share, 0.0))


def blocks_of(count: int, members: int) -> Array:
    """Which member leaves each sample out: pieces of time, shape (n,)."""
    return np.asarray(np.minimum(np.arange(count) * members // max(count, 1), members - 1))


def _surely_less(after: Array, before: Array) -> Any:
    """The same of each column of blocks, shape (blocks, ..)."""
    gain = 1.0 - after / np.maximum(before, 1.0e-300)
    error = gain.std(axis=0, ddof=1) / np.sqrt(len(gain))
    is_sure = gain.mean(axis=0) > _STUDENT.get(len(gain), _NORMAL) * error
    return is_sure & (after.sum(axis=0) < (1.0 - _LEAST_GAIN) * before.sum(axis=0))


def is_better(squares: Array, best: Array) -> bool:
    """Whether errors of blocks are surely smaller than others, and by what is worth it.

    Args:
        squares: Sum of the squares of each block, shape (blocks,).
        best: The same of another way.
    """
    return bool(_surely_less(squares, best))
