"""Expressions as arrays of numbers that parts understand."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.symbols.link_rotations import Matrix, Vector
from mbd_ros.compiled.symbols.scalar import number


def vector(values: Vector) -> Any:
    """Three expressions as an array of numbers, shape (3,)."""
    return objects(values)


def matrix(rows: Matrix) -> Any:
    """Nine expressions as an array of numbers, shape (3, 3)."""
    return np.array([objects(row) for row in rows], dtype=object)


def objects(values: Sequence[Any]) -> Any:
    """Expressions as a vector of numbers."""
    found = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):
        found[i] = number(value)
    return found
