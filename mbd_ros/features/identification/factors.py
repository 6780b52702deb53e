"""Least-squares problems of many rows, kept as triangles: memory does not grow with the rows.

R of [A b] = Q R has all that a least-squares problem of any of its columns needs, and loses half
the digits that A'A would.

Source: A. Bjorck, Numerical Methods for Least Squares Problems, 1996, section 2.4.
"""

import numpy as np

from mbd_ros.core.state import Array


def triangle_of(rows: Array) -> Array:
    """R of rows = Q R, shape (min(n, m), m)."""
    R: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    return R


class Triangle:
    """Upper triangle R of rows that come in pieces.

    Args:
        columns: How many a row has.

    Attributes:
        R: Shape (k, columns), k at most `columns`.
        rows: How many rows came.
    """

    def __init__(self, columns: int) -> None:
        self.R, self.rows = np.zeros((0, columns)), 0
        self._pieces: list[Array] = []
        self._waiting = 0

    def add(self, rows: Array) -> None:
        """Take rows, shape (n, columns)."""
        self._pieces.append(rows)
        self._waiting += len(rows)
        self.rows += len(rows)
        if self._waiting > 8 * rows.shape[1]:
            self.close()

    def close(self) -> "Triangle":
        """Fold in rows that wait; returns itself."""
        if self._waiting:
            self.R = triangle_of(np.concatenate([self.R, *self._pieces]))
            self._pieces, self._waiting = [], 0
        return self
