"""The next mesh from the errors of a motion on the last one."""

import math

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.mesh import Mesh, mesh_of

_MOST_PARTS = 4  # of one interval at once: an estimate far from its limit says no more
_SAFE = 0.5  # of the tolerance: what a refined interval aims at
_SHORTEST = 1.0e-7  # of a phase: jumps are not resolved any further


def refined(mesh: Mesh, errors: Array, tolerance: float) -> Mesh:
    """Intervals whose error is too large are split, by the order of their method.

    Args:
        mesh: The mesh.
        errors: Relative error of each interval, shape (n,).
        tolerance: What is accepted.
    """
    degrees, widths = list[int](), list[float]()
    for degree, width, error in zip(mesh.degrees, mesh.widths, errors, strict=True):
        parts = 1
        if error > tolerance and width > _SHORTEST:
            wanted = (error / (_SAFE * tolerance)) ** (1.0 / (degree + 1))
            parts = min(max(2, math.ceil(wanted)), _MOST_PARTS)
        degrees += [int(degree)] * parts
        widths += [width / parts] * parts
    return mesh_of(mesh.scheme, degrees, np.array(widths))
