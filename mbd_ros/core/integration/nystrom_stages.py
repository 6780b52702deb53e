"""Stages of an explicit Runge-Kutta method where q is a vector space with q' = v."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.integration.runge_kutta_stages import Stages
from mbd_ros.core.state import NONE, Array, State

new_state = tuple.__new__  # half the time of the constructor of a NamedTuple


class NystromStages(Stages):
    """The stages of `Stages` at the cost of one small product each.

    With B = [q; v; a_1; a_2; ..] the rows above a_i give q_i and v_i at once:

        q_i = q + c_i h v + h^2 sum_j (A A)_ij a_j,   v_i = v + h sum_j A_ij a_j

    A step writes its result into the head of a second B, from which the next step starts.

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.14.
    """

    def step(self, x: State, u: Array | None, h: float, t: float) -> State:
        """`start` and `advance`, without the way through `start` on a smooth stretch."""
        t0, q, v, _, _ = x
        held = None if u is None else u.tobytes()
        if x is not self._after or self._done != self._end or held != self._held:
            return super().step(x, u, h, t)
        self._switch()
        self._accelerate(t0, q, v, self._u, self._side.first)
        self._x = x
        return self.advance(h, t)

    def advance(self, h: float, t: float) -> State:
        """State after a step of length h [s] from the started one; t is its time [s]."""
        if h != self._h:
            self._h = h
            self._blocks.scale(h)
        accelerate, u, t0 = self._accelerate, self._u, self._x[0]
        side, q, v, pair = self._side, self._q, self._v, self._pair
        for c, product, above, row in side.inner:
            product(above, pair)
            accelerate(t0 + c * h, q, v, u, row)
        side.step(side.above_step, side.result)
        self._done = self._end
        result = t, side.result_q(), side.result_v(), NONE, self._mode
        self._after = after = new_state(State, result)
        return after

    def errors(self) -> Array:
        """Error estimates of [q; v] over the last `advance`, shape (m, 2 nv)."""
        count = self._tableau.errors.shape[1]
        self._complete(count)
        errors: Array = self._errors.dot(self._side.B[: 2 + count]).reshape(-1, 2 * self._nv)
        return errors

    @property
    def first(self) -> Array:
        """Acceleration at the started state, shape (nv,); changes with the next step."""
        a: Array = self._side.first
        return a

    def _allocate(self) -> None:
        a, errors = self._tableau.a, self._tableau.errors
        self._pair = np.empty((2, self._nv))
        self._q, self._v = self._pair
        stages = [np.eye(2, 2 + i) + _increment(a[i, :i], a) for i in range(1, len(a))]
        estimates = [_increment(weights, a) for weights in errors]
        self._blocks = Blocks([*stages, np.reshape(estimates, (-1, 2 + errors.shape[1]))])
        *stages, self._errors = self._blocks.views
        one, two = np.zeros((2, 2 + len(a), self._nv))
        self._side: _Side = _Side(one, two[:2], stages, self._c, self._end)
        self._other: _Side = _Side(two, one[:2], stages, self._c, self._end)

    def _rates_kept(self) -> Any:
        return self._side.B.copy(), self._side.result.copy()

    def _put_rates(self, rates: Any) -> None:
        self._side.B[...], self._side.result[...] = rates
        self._blocks.scale(self._h)

    def _switch(self) -> None:
        self._side, self._other = self._other, self._side

    def _begin(self, x: State, a: Array) -> None:
        if x is self._after:
            self._switch()
        else:
            self._side.q[...], self._side.v[...] = x.q, x.v
        self._side.first[...] = a

    def _end_acceleration(self) -> Array:
        a: Array = self._side.end
        return a

    def _complete(self, count: int) -> None:
        for c, product, above, row in self._side.later[self._done - 1 : count - 1]:
            product(above, self._pair)
            t = self._x.t + c * self._h
            self._accelerate(t, self._q, self._v, self._u, row)
        self._done = max(self._done, count)

    def _blend(self, weights: Array) -> tuple[Array, Array]:
        block = Blocks([np.eye(2, 2 + len(weights)) + _increment(weights, self._tableau.a)])
        block.scale(self._h)
        q, v = block.views[0].dot(self._side.B[: 2 + len(weights)])
        return q, v


class _Side:
    """One B with everything that a step needs of it.

    Args:
        B: [q; v; a_1; ..], shape (2 + n, nv).
        result: Where the step writes its [q; v], shape (2, nv).
        stages: Matrices of the stages after the first one.
        c: Times of all stages, in steps.
        end: Index of the stage that is the step itself.
    """

    def __init__(
        self, B: Array, result: Array, stages: Sequence[Array], c: Sequence[float], end: int
    ) -> None:
        rows = list(B)
        self.B, self.result, self.q, self.v, self.first = B, result, *rows[:3]
        self.end = rows[2 + end]
        self.result_q, self.result_v = (row.copy for row in result)
        self.later = [
            (c[i], stage.dot, B[: 2 + i], rows[2 + i]) for i, stage in enumerate(stages, 1)
        ]
        self.inner = self.later[: end - 1]
        _, self.step, self.above_step, _ = self.later[end - 1]


class Blocks:
    """Matrices for [q; v; a_1; ..] whose entries are multiples of 1, h or h^2, in one array.

    Args:
        units: The multiples; rows for q and v alternate.

    Attributes:
        views: The matrices, for the step length of the last `scale`.
    """

    def __init__(self, units: Sequence[Array]) -> None:
        self._units = np.concatenate([unit.ravel() for unit in units])
        self._exponents = np.concatenate([_exponents(*unit.shape).ravel() for unit in units])
        self._values = np.zeros_like(self._units)
        pieces = np.split(self._values, np.cumsum([unit.size for unit in units])[:-1])
        self.views = [piece.reshape(u.shape) for piece, u in zip(pieces, units, strict=True)]

    def scale(self, h: float) -> None:
        """Fill the matrices for steps of length h [s]."""
        np.multiply(self._units, np.array([1.0, h, h * h])[self._exponents], out=self._values)


def _increment(weights: Array, a: Array) -> Array:
    """Change of q and v that weights of the rates (v_i, a_i) make, as multiples of 1, h, h^2."""
    count = len(weights)
    return np.array([[0.0, weights.sum(), *weights.dot(a[:count, :count])], [0.0, 0.0, *weights]])


def _exponents(rows: int, columns: int) -> Array:
    """Power of h of every entry."""
    row = np.array([[0, 1, *[2] * (columns - 2)], [0, 0, *[1] * (columns - 2)]])
    return np.resize(row, (rows, columns))
