"""The mass matrix of a configuration as an operator."""

from functools import cached_property
from typing import Any

import eigenpy
import numpy as np

from mbd_ros.core.state import Array


class Mass:
    """M of what is integrated; a value, factorised when `solve` is first asked.

    Who needs no entries asks for products and solutions, which cost less than M where bodies move
    apart from one another.

    Args:
        dense: The matrix, symmetric, shape (nv, nv); it is copied.

    Attributes:
        dense: The matrix, not to be written to.
    """

    def __init__(self, dense: Array) -> None:
        self.dense: Array = np.array(dense)

    def dot(self, v: Array) -> Array:
        """M v, shape as v."""
        product: Array = self.dense.dot(v)
        return product

    def diagonal(self) -> Array:
        """Entries of the diagonal, shape (nv,)."""
        return self.dense.diagonal()

    def solve(self, force: Array) -> Array:
        """M^-1 force, shape as `force`, (nv,) or (nv, k)."""
        a: Array = self._factor.solve(force).reshape(force.shape)  # eigenpy flattens one column
        return a

    @cached_property
    def _factor(self) -> Any:
        return eigenpy.LLT(self.dense)
