"""Equations that repeat over many places of a nonlinear program, with exact derivatives."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

Places = NDArray[np.intp]


class Form:
    """Rows and a cost as functions of a few unknowns, and their derivatives.

    Args:
        unknowns: Symbols of the unknowns, a column.
        data: Symbols of numbers that are known at each place, a column.
        rows: The g of lower <= g <= upper, a column.
        cost: What is added to the cost; None for nothing.
    """

    def __init__(self, unknowns: Any, data: Any, rows: Any, cost: Any = None) -> None:
        g, f = ca.cse([ca.densify(ca.SX(rows)), ca.SX(0) if cost is None else ca.SX(cost)])
        self._x, self._d, self._g, self._f = unknowns, data, g, None if cost is None else f
        self.size, self.rows = int(unknowns.numel()), int(self._g.numel())
        self._lam_f, self._lam_g = ca.SX.sym("s"), ca.SX.sym("l", self.rows)

    @property
    def has_cost(self) -> bool:
        """Whether anything is added to the cost."""
        return self._f is not None

    @cached_property
    def values(self) -> Any:
        """(x, d) -> g."""
        return ca.Function("values", [self._x, self._d], [self._g])

    @cached_property
    def cost(self) -> Any:
        """(x, d) -> f."""
        return ca.Function("cost", [self._x, self._d], [ca.densify(self._f)])

    @cached_property
    def jacobian(self) -> tuple[Places, Any]:
        """Row and unknown of each entry of dg/dx, and (x, d) -> the entries."""
        return self._entries("jacobian", ca.jacobian(self._g, self._x), [])

    @cached_property
    def gradient(self) -> tuple[Places, Any]:
        """The same of df/dx."""
        return self._entries("gradient", ca.jacobian(self._f, self._x), [])

    @cached_property
    def hessian(self) -> tuple[Places, Any]:
        """The same of the upper triangle of s d2f/dx2 + l' d2g/dx2, with s and l given too."""
        whole = ca.dot(self._lam_g, self._g) if self.rows else ca.SX(0)
        if self._f is not None:
            whole = whole + self._lam_f * self._f
        H, _ = ca.hessian(whole, self._x)
        return self._entries("hessian", ca.triu(H), [self._lam_f, self._lam_g])

    def _entries(self, name: str, matrix: Any, more: Sequence[Any]) -> tuple[Places, Any]:
        rows, columns = matrix.sparsity().get_triplet()
        values = matrix.nz[:] if len(rows) else ca.SX(0, 1)
        function = ca.Function(name, [self._x, self._d, *more], [values])
        return np.array([rows, columns], dtype=np.intp).reshape(2, -1), function


class Block:
    """A form at its places.

    Args:
        name: For messages.
        form: The form.
        places: Numbers of its unknowns in the program, shape (size, m).
        data: What is known at each place, shape (.., m); None for nothing.
        lower: Of rows, shape (rows,) or (rows, m).
        upper: The same.
        size: Usual sizes of rows, the same.
    """

    def __init__(
        self,
        name: str,
        form: Form,
        places: Places,
        data: Array | None = None,
        lower: Any = 0.0,
        upper: Any = 0.0,
        size: Any = 1.0,
    ) -> None:
        self.name, self.form = name, form
        self.places = np.asarray(places, dtype=np.intp).reshape(form.size, -1)
        self.count = self.places.shape[1]
        self.data = np.zeros((0, self.count)) if data is None else np.asarray(data, dtype=float)
        self.lower, self.upper, self.size = (self._spread(one) for one in (lower, upper, size))

    def _spread(self, given: Any) -> Array:
        one = np.asarray(given, dtype=np.float64)
        one = one[:, None] if one.ndim == 1 else one
        return np.broadcast_to(one, (self.form.rows, self.count)).copy()
