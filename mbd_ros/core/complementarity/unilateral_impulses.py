"""Impulses of rows that only push, as a least-squares problem in the mass metric.

    min 1/2 |c + G p|^2   subject to   p >= 0

c is a velocity in that metric, G what impulses add to it, and G' (c + G p) are the rates of the
rows: at the least kinetic energy they are >= 0, and 0 where a row pushes. The columns may depend
on one another. Source: C. Lawson and R. Hanson, Solving Least Squares Problems, 1974, ch. 23.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, FIXED_BY_OTHERS, HELD_BY_ROWS
from mbd_ros.errors import SolveError

_ROUNDING = 1.0e-14  # a rate that is none, of the velocity
_CLOSED = 1.0e-12  # the same of rows among which impulses are shared
_SAME = 1.0e-10  # by which the rates of dependent rows may differ and count as the same
_GIVES = 1.0e-5  # root of how much rows give way that depend on one another and move apart
_ROUNDS = 10  # of exchanges, per row


class PushImpulses:
    """Solves the problem above for one configuration.

    Args:
        G: Velocities that impulses add, shape (nv, m).
        loose: Their squares while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
    """

    def __init__(self, G: Array, loose: Array, names: Sequence[str]) -> None:
        self._names = names
        square = np.einsum("ij,ij->j", G, G)
        self._mobile = square > HELD_BY_ROWS * loose
        self._unit = 1.0 / np.sqrt(square[self._mobile])
        self._length = np.sqrt(np.where(loose > 0.0, loose, 1.0))
        self._G = G[:, self._mobile] * self._unit

    def solve(self, b: Array, speed: float) -> Array:
        """The impulses, shape (m,), fresh; rows that depend on one another share them.

        Args:
            b: Rates without them, shape (m,).
            speed: Velocity in the mass metric.

        Raises:
            SolveError: Nothing keeps a row from closing; names it.
        """
        left = np.where(self._mobile, 0.0, b) < -CONTRADICTION * self._length * speed
        if left.any():
            self._refuse(int(left.argmax()))
        p, rate = self.nearest(b, speed)
        if rate.min(initial=0.0) < -CONTRADICTION:
            self._refuse(int(rate.argmin()))
        return p

    def nearest(self, b: Array, speed: float) -> tuple[Array, Array]:
        """The impulses, and what they leave of the rates, of the largest one, shape (m,) each.

        Rates of rows that nothing moves count as none. Where rows depend on one another and want
        different things, a small part of their rates is left.

        Args:
            b: As for `solve`.
            speed: As for `solve`.
        """
        p, rate = np.zeros((2, len(b)))
        own = self._unit * b[self._mobile]
        if (own >= 0.0).all():
            return p, rate
        G, size = self._G, max(speed, float(np.abs(own).max()))
        own = own / size  # c is of the order of 1, however slow the motion is
        c = np.asarray(np.linalg.lstsq(G.T, own, rcond=FIXED_BY_OTHERS)[0], dtype=np.float64)
        off = own - G.T.dot(c)
        if np.abs(off).max() <= _SAME:
            p[self._mobile] = size * self._unit * _shared(G, c, _least(G, c))
            return p, rate
        yielding = np.concatenate((G, _GIVES * np.eye(len(own))))
        push = _least(yielding, np.concatenate((c, off / _GIVES)))
        rate[self._mobile] = own + G.T.dot(G.dot(push))
        p[self._mobile] = size * self._unit * push
        return p, rate

    def _refuse(self, row: int) -> None:
        raise SolveError(f"nothing can keep constraint row {self._names[row]} from closing")


def _shared(G: Array, c: Array, p: Array) -> Array:
    """Impulses of least norm that do the same, where they push too."""
    rate = G.T.dot(c + G.dot(p))
    least = _fitted(G, c, (rate <= _CLOSED) | (p > 0.0))
    does_the_same = np.abs(G.T.dot(c + G.dot(least)) - rate).max() <= _CLOSED
    return least if does_the_same and (least >= 0.0).all() else p


def _fitted(G: Array, c: Array, on: NDArray[np.bool_]) -> Array:
    """The p of least norm with c + G p the shortest, 0 where a row is off."""
    p = np.zeros(G.shape[1])
    p[on] = np.linalg.lstsq(G[:, on], -c, rcond=FIXED_BY_OTHERS)[0]
    return p


def _least(G: Array, c: Array) -> Array:
    """Some p of the problem."""
    m = G.shape[1]
    p, pushes = np.zeros(m), np.zeros(m, dtype=np.bool_)
    tried = np.zeros(m, dtype=np.bool_)
    for _ in range(_ROUNDS * m):
        rate = np.where(pushes | tried, 0.0, G.T.dot(c + G.dot(p)))
        new = int(rate.argmin())
        if rate[new] >= -_ROUNDING:
            return p
        pushes[new] = True
        target = _fitted(G, c, pushes)
        if target[new] <= 0.0:  # it depends on the others, and its rate is rounding
            pushes[new], tried[new] = False, True
            continue
        tried[:] = False
        while (pulls := pushes & (target <= 0.0)).any():
            share = p[pulls] / (p[pulls] - target[pulls])
            p = p + share.min() * (target - p)
            pushes &= ~(pulls & (p <= _ROUNDING * np.abs(p).max()))
            pushes[np.flatnonzero(pulls)[share.argmin()]] = False
            p = np.where(pushes, p, 0.0)
            target = _fitted(G, c, pushes)
        p = target
    return p
