"""Projection onto a cone of friction, of which the normal is at least some number."""

import math

import numpy as np

from mbd_ros.core.state import Array


def nearest_in_cone(y: Array, mu: float, least: float = 0.0) -> tuple[Array, Array]:
    """The nearest p with p_n >= least, |p_t| <= mu p_n, and its derivative by y.

    Args:
        y: A normal and two tangents, shape (3,).
        mu: Coefficient of friction, > 0.
        least: Smallest normal, >= 0.
    """
    n, length = float(y[0]), math.hypot(y[1], y[2])
    share, is_inside = 1.0 / (1.0 + mu * mu), length <= mu * n
    normal = n if is_inside else max((n + mu * length) * share, 0.0)
    if is_inside and normal >= least:
        return y.copy(), np.eye(3)
    slope = np.zeros((3, 3))
    if normal == least == 0.0:
        return np.zeros(3), slope
    d = y[1:] / length if length > 0.0 else np.zeros(2)
    across = np.array((-d[1], d[0]))
    if normal >= least:
        edge = np.array((1.0, *(mu * d)))
        slope = share * np.outer(edge, edge)
        slope[1:, 1:] += mu * normal / length * np.outer(across, across)
        return normal * edge, slope
    most = mu * least
    if length <= most:
        slope[1:, 1:] = np.eye(2)
        return np.array((least, *y[1:])), slope
    slope[1:, 1:] = most / length * np.outer(across, across)
    return np.array((least, *(most * d))), slope
