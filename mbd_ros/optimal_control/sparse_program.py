"""Sparse nonlinear programs that are assembled from blocks, with exact derivatives."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

Places = NDArray[np.intp]


class SparseProgram:
    """The program min f(x) subject to lower <= g(x) <= upper, assembled from blocks.

    The solver sees unknowns, rows and cost relative to their sizes. Every form is one function
    that is evaluated at all its places; nothing is unrolled, and derivatives have only the entries
    of the forms.

    Args:
        sizes: Characteristic sizes of the unknowns, shape (n,).
        known: Values of unknowns that are fixed, NaN for the others, shape (n,).
        cost_size: Characteristic size of the cost.

    Attributes:
        open: Indices of the unknowns that are not fixed, which the solver sees.
        row_sizes: Characteristic sizes of the rows, in the order of the blocks, place by place.
        slices: Rows of each block.
    """

    def __init__(
        self, blocks: Sequence[Block], sizes: Array, known: Array, cost_size: float = 1.0
    ) -> None:
        self.blocks = [block for block in blocks if block.count]
        self.sizes = sizes
        self.cost_size = cost_size
        self.open = np.flatnonzero(np.isnan(known))
        fixed = np.flatnonzero(~np.isnan(known))
        self._column = np.full(len(sizes), -1, dtype=np.intp)
        self._column[self.open] = np.arange(len(self.open))
        self._n = len(self.open)
        ends = np.cumsum([0, *(b.form.rows * b.count for b in self.blocks)])
        self.slices = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
        self.row_sizes = self._rows("size")
        self.m = int(ends[-1])
        self._x = ca.MX.sym("x", self._n)
        order = np.argsort(np.concatenate((self.open, fixed)))
        values = ca.vertcat(self._x * ca.DM(sizes[self.open]), ca.DM(known[fixed]))
        self._unknowns = values[order.tolist()]
        self._arguments = [self._gather(block) for block in self.blocks]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the rows, relative to their sizes, shape (m,) each."""
        return self._rows("lower") / self.row_sizes, self._rows("upper") / self.row_sizes

    def functions(self) -> dict[str, Any]:
        """Return the scaled program, and its derivatives `grad_f`, `jac_g` and `hess_lag`."""
        x, p = self._x, ca.MX.sym("p", 0)
        f, g = self._cost(), self._values()
        s, lam = ca.MX.sym("s"), ca.MX.sym("l", self.m)
        return {
            "program": {"x": x, "f": f, "g": g},
            "grad_f": ca.Function("grad_f", [x, p], [f, self._gradient()]),
            "jac_g": ca.Function("jac_g", [x, p], [g, self._jacobian()]),
            "hess_lag": ca.Function("hess_lag", [x, p, s, lam], [self._hessian(s, lam)]),
        }

    def _rows(self, name: str) -> Array:
        parts = [getattr(block, name).T.ravel() for block in self.blocks]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _gather(self, block: Block) -> list[Any]:
        """Return the unknowns and the data of a block, one column per place."""
        at = block.places.T.ravel()
        data = ca.DM(block.data) if block.data.size else ca.DM(0, block.count)
        return [ca.reshape(self._unknowns[at.tolist()], block.form.size, block.count), data]

    def _map(self, i: int, function: Any, more: Sequence[Any] = ()) -> Any:
        """Return a function of a form at all places, as one column."""
        count = self.blocks[i].count
        arguments = [*self._arguments[i], *more]
        return ca.vec((function.map(count) if count > 1 else function)(*arguments))

    def _cost(self) -> Any:
        parts = [
            ca.sum1(self._map(i, block.form.cost))
            for i, block in enumerate(self.blocks)
            if block.form.has_cost
        ]
        return sum(parts, ca.MX(0.0)) / self.cost_size

    def _values(self) -> Any:
        parts = [
            self._map(i, block.form.values)
            for i, block in enumerate(self.blocks)
            if block.form.rows
        ]
        return ca.vertcat(ca.MX(0, 1), *parts) / ca.DM(self.row_sizes)

    def _gradient(self) -> Any:
        values, columns = [ca.MX(0, 1)], list[Places]()
        for i, block in enumerate(self.blocks):
            if block.form.has_cost:
                (_, inside), function = block.form.gradient
                values.append(self._map(i, function))
                columns.append(block.places[inside].T.ravel())
        at = _concatenate(columns)
        is_open = np.flatnonzero(self._column[at] >= 0)
        if not len(is_open):
            return ca.MX.zeros(self._n)
        weights = ca.DM(self.sizes[at[is_open]] / self.cost_size)
        into = self._column[at[is_open]].tolist()
        summing = ca.DM.triplet(into, is_open.tolist(), weights, self._n, len(at))
        return ca.densify(summing @ ca.vertcat(*values))

    def _jacobian(self) -> Any:
        values, rows, columns = [ca.MX(0, 1)], list[Places](), list[Places]()
        for i, block in enumerate(self.blocks):
            if block.form.rows:
                (row, inside), function = block.form.jacobian
                values.append(self._map(i, function))
                first = self.slices[i].start + block.form.rows * np.arange(block.count)
                rows.append((row[:, None] + first).T.ravel())
                columns.append(block.places[inside].T.ravel())
        at = _concatenate(rows), _concatenate(columns)
        weights = self.sizes[at[1]] / self.row_sizes[at[0]]
        of = at[0], self._column[at[1]]
        return _matrix(ca.vertcat(*values), of, weights, (self.m, self._n))

    def _hessian(self, s: Any, lam: Any) -> Any:
        values, rows, columns = [ca.MX(0, 1)], list[Places](), list[Places]()
        for i, block in enumerate(self.blocks):
            inside, function = block.form.hessian
            if not inside.size:
                continue
            more = self._weights(i, block.form, s, lam)
            values.append(self._map(i, function, more))
            pairs = block.places[inside]
            rows.append(pairs.min(axis=0).T.ravel())
            columns.append(pairs.max(axis=0).T.ravel())
        at = _concatenate(rows), _concatenate(columns)
        weights = self.sizes[at[0]] * self.sizes[at[1]]
        of = self._column[at[0]], self._column[at[1]]
        return _matrix(ca.vertcat(*values), of, weights, (self._n, self._n))

    def _weights(self, i: int, form: Form, s: Any, lam: Any) -> list[Any]:
        """Return weights of cost and rows of a block in the Lagrangian, one column per place."""
        rows, count = self.slices[i], self.blocks[i].count
        of_rows = lam[rows] / ca.DM(self.row_sizes[rows]) if form.rows else ca.MX(0, 1)
        of_cost = ca.repmat(s / self.cost_size, 1, count)
        return [of_cost, ca.reshape(of_rows, form.rows, count)]


def _concatenate(parts: Sequence[Places]) -> Places:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)


def _matrix(values: Any, at: tuple[Places, Places], weights: Array, shape: tuple[int, int]) -> Any:
    """Return a sparse matrix of weighted entries, without those of fixed unknowns.

    Entries at the same place are added.
    """
    is_open = np.flatnonzero((at[0] >= 0) & (at[1] >= 0))
    if not len(is_open):
        return ca.MX(*shape)
    rows, columns, weights = at[0][is_open], at[1][is_open], weights[is_open]
    keys, inverse = np.unique(columns * shape[0] + rows, return_inverse=True)
    pattern = ca.Sparsity.triplet(*shape, (keys % shape[0]).tolist(), (keys // shape[0]).tolist())
    if len(keys) == len(is_open):
        order = np.argsort(inverse)
        return ca.MX(pattern, values[is_open[order].tolist()] * ca.DM(weights[order]))
    into = inverse.ravel().tolist()
    summing = ca.DM.triplet(into, is_open.tolist(), ca.DM(weights), len(keys), values.numel())
    return ca.MX(pattern, summing @ values)


class Block:
    """A form with the places at which it is evaluated.

    Args:
        name: Name for messages.
        form: The form.
        places: Indices of its unknowns in the program, shape (size, m).
        data: Data at each place, shape (.., m); None for none.
        lower: Lower bounds of rows, shape (rows,) or (rows, m).
        upper: Upper bounds of rows, same shape.
        size: Characteristic sizes of rows, same shape.
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
        self.name = name
        self.form = form
        self.places = np.asarray(places, dtype=np.intp).reshape(form.size, -1)
        self.count = self.places.shape[1]
        self.data = np.zeros((0, self.count)) if data is None else np.asarray(data, dtype=float)
        self.lower = self._broadcast(lower)
        self.upper = self._broadcast(upper)
        self.size = self._broadcast(size)

    def _broadcast(self, values: Any) -> Array:
        array = np.asarray(values, dtype=np.float64)
        array = array[:, None] if array.ndim == 1 else array
        return np.broadcast_to(array, (self.form.rows, self.count)).copy()


class Form:
    """Rows and a cost as functions of a few unknowns, with their derivatives.

    Args:
        unknowns: Symbols of the unknowns, a column.
        data: Symbols of the data at each place, a column.
        rows: The g of lower <= g <= upper, a column.
        cost: Expression that is added to the cost; None for none.
    """

    def __init__(self, unknowns: Any, data: Any, rows: Any, cost: Any = None) -> None:
        g, f = ca.cse([ca.densify(ca.SX(rows)), ca.SX(0) if cost is None else ca.SX(cost)])
        self._x = unknowns
        self._d = data
        self._g = g
        self._f = None if cost is None else f
        self.size = int(unknowns.numel())
        self.rows = int(self._g.numel())
        self._lam_f = ca.SX.sym("s")
        self._lam_g = ca.SX.sym("l", self.rows)

    @property
    def has_cost(self) -> bool:
        """Whether the form adds to the cost."""
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
        """Row and unknown of each entry of df/dx, and (x, d) -> the entries."""
        return self._entries("gradient", ca.jacobian(self._f, self._x), [])

    @cached_property
    def hessian(self) -> tuple[Places, Any]:
        """Places in the upper triangle of s d2f/dx2 + l' d2g/dx2, and (x, d, s, l) -> entries."""
        lagrangian = ca.dot(self._lam_g, self._g) if self.rows else ca.SX(0)
        if self._f is not None:
            lagrangian = lagrangian + self._lam_f * self._f
        H, _ = ca.hessian(lagrangian, self._x)
        return self._entries("hessian", ca.triu(H), [self._lam_f, self._lam_g])

    def _entries(self, name: str, matrix: Any, more: Sequence[Any]) -> tuple[Places, Any]:
        rows, columns = matrix.sparsity().get_triplet()
        values = matrix.nz[:] if len(rows) else ca.SX(0, 1)
        function = ca.Function(name, [self._x, self._d, *more], [values])
        return np.array([rows, columns], dtype=np.intp).reshape(2, -1), function
