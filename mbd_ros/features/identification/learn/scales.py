"""Samples to learn from, sizes of their quantities, and curves of friction over those sizes.

Networks see positions, velocities and accelerations over their sizes and say torques over theirs.
Structured networks start from the size D of the root of inertia and from that of the energy V.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array

CURVES = (0.02, 0.1, 0.5)  # of the usual velocity: where curves of dry friction bend
FINE_CURVES = (0.005, 0.01, 0.02, 0.04, 0.1, 0.25, 0.5)  # the same of adapters, which are linear
LEAST_INERTIA = 1.0e-3  # e, of the usual inertia
_SLOW = 0.05  # of the usual velocity: where dry friction changes its sign
_LEAST_SIZE = 1.0e-6  # of the largest size: a joint that rests

Tell = Callable[[float], None]
"""Is told the share of the work that is done."""


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
