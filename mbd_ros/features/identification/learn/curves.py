"""Curves of friction, and sizes of inertia and energy, that structured networks start from."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.identification.learn.scales import Scales

CURVES = (0.02, 0.1, 0.5)  # of the usual velocity: where curves of dry friction bend
FINE_CURVES = (0.005, 0.01, 0.02, 0.04, 0.1, 0.25, 0.5)  # the same of adapters, which are linear
LEAST_INERTIA = 1.0e-3  # e, of the usual inertia


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
