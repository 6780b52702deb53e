"""Rotations between links, applied by their sines and cosines so that zeros cost nothing.

CasADi drops zeros and ones too, but asking it takes as long as a product that is kept: what is
`ZERO` or `ONE` itself is not asked.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca

Vector = tuple[Any, Any, Any]  # of SX scalars
Matrix = tuple[Vector, Vector, Vector]

ZERO, ONE = ca.SX(0.0), ca.SX(1.0)
NO_VECTOR: Vector = (ZERO, ZERO, ZERO)
EYE: Matrix = ((ONE, ZERO, ZERO), (ZERO, ONE, ZERO), (ZERO, ZERO, ONE))


class PlaneTurn(NamedTuple):
    """A rotation about one axis of coordinates.

    Attributes:
        axis: 0, 1 or 2.
        c: Cosine of the angle.
    """

    axis: int
    c: Any
    s: Any

    @property
    def back(self) -> "PlaneTurn":
        """The inverse."""
        return self._replace(s=less(ZERO, self.s))

    def vector(self, v: Vector) -> Vector:
        """R v."""
        k, (i, j) = self.axis, self._plane
        x, y = v[i], v[j]
        c, s = self.c, self.s
        turned = {k: v[k], i: less(by(c, x), by(s, y)), j: more(by(s, x), by(c, y))}
        return turned[0], turned[1], turned[2]

    def tensor(self, A: Matrix) -> Matrix:
        """R A R'.

        In the plane a' = b + c w, b' = a - c w, f' = f + s w, g' = g + s w with
        w = c (a - b) - s (f + g), for A = (a f; g b).
        """
        k, (i, j) = self.axis, self._plane
        a, f, g, b = A[i][i], A[i][j], A[j][i], A[j][j]
        rows = {row: dict(enumerate(A[row])) for row in range(3)}
        if self.c.is_zero():  # s is 1 or -1
            rows[i][i], rows[j][j], rows[i][j], rows[j][i] = b, a, -g, -f
        else:
            w = less(by(self.c, less(a, b)), by(self.s, more(f, g)))
            cw, sw = by(self.c, w), by(self.s, w)
            rows[i][i], rows[j][j], rows[i][j], rows[j][i] = (
                *(more(b, cw), less(a, cw)),
                *(more(f, sw), more(g, sw)),
            )
        rows[i][k] = less(by(self.c, A[i][k]), by(self.s, A[j][k]))
        rows[j][k] = more(by(self.s, A[i][k]), by(self.c, A[j][k]))
        rows[k][i] = less(by(self.c, A[k][i]), by(self.s, A[k][j]))
        rows[k][j] = more(by(self.s, A[k][i]), by(self.c, A[k][j]))
        return _matrix(rows)

    def columns(self, R: Matrix) -> Matrix:
        """R' of this rotation after R: the matrix product R times this rotation."""
        return (self.back.vector(R[0]), self.back.vector(R[1]), self.back.vector(R[2]))

    @property
    def _plane(self) -> tuple[int, int]:
        return (self.axis + 1) % 3, (self.axis + 2) % 3


class MatrixTurn(NamedTuple):
    """Any rotation, by its matrix."""

    R: Matrix

    @property
    def back(self) -> "MatrixTurn":
        """The inverse."""
        return MatrixTurn(transposed(self.R))

    def vector(self, v: Vector) -> Vector:
        """R v."""
        return through(self.R, v)

    def tensor(self, A: Matrix) -> Matrix:
        """R A R', which nobody asks for: nothing is above a free body."""
        raise NotImplementedError

    def columns(self, R: Matrix) -> Matrix:
        """The matrix product R times this rotation."""
        back = self.back
        return back.vector(R[0]), back.vector(R[1]), back.vector(R[2])


Turn = Sequence[PlaneTurn | MatrixTurn]  # the product of all, the last one is applied first


def into(turn: Turn, v: Vector) -> Vector:
    """R' v: from the axes of a parent to those of a child."""
    for one in turn:
        v = one.back.vector(v)
    return v


def out(turn: Turn, v: Vector) -> Vector:
    """R v: from the axes of a child to those of its parent."""
    for one in reversed(turn):
        v = one.vector(v)
    return v


def tensor_out(turn: Turn, A: Matrix) -> Matrix:
    """R A R'."""
    for one in reversed(turn):
        A = one.tensor(A)
    return A


def product(R: Matrix, turn: Turn) -> Matrix:
    """R times a rotation."""
    for one in turn:
        R = one.columns(R)
    return R


def matrix_tensor(R: Matrix, A: Matrix) -> Matrix:
    """R A R' of a symmetric A, for a rotation matrix."""
    half = tuple(tuple(dot(R[i], A[j]) for j in range(3)) for i in range(3))
    upper = {(i, j): dot(half[i], R[j]) for i in range(3) for j in range(i, 3)}
    return _matrix({i: {j: upper[min(i, j), max(i, j)] for j in range(3)} for i in range(3)})


def dot(a: Vector, b: Vector) -> Any:
    """Dot product of two vectors."""
    return more(more(by(a[0], b[0]), by(a[1], b[1])), by(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """Cross product of two vectors."""
    return (
        less(by(a[1], b[2]), by(a[2], b[1])),
        less(by(a[2], b[0]), by(a[0], b[2])),
        less(by(a[0], b[1]), by(a[1], b[0])),
    )


def plus(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors."""
    return more(a[0], b[0]), more(a[1], b[1]), more(a[2], b[2])


def minus(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return less(a[0], b[0]), less(a[1], b[1]), less(a[2], b[2])


def times(factor: Any, a: Vector) -> Vector:
    """A vector times a number."""
    return by(factor, a[0]), by(factor, a[1]), by(factor, a[2])


def through(A: Matrix, v: Vector) -> Vector:
    """A v."""
    return dot(A[0], v), dot(A[1], v), dot(A[2], v)


def transposed(A: Matrix) -> Matrix:
    """A'."""
    return tuple(zip(*A, strict=True))  # type: ignore[return-value]


def combined(A: Matrix, B: Matrix, sign: int = 1) -> Matrix:
    """A + B, or A - B."""
    rule = plus if sign > 0 else minus
    return rule(A[0], B[0]), rule(A[1], B[1]), rule(A[2], B[2])


def bend(w: Vector, b: Vector) -> Matrix:
    """U of an angular velocity and its rate."""
    xx, yy, zz = by(w[0], w[0]), by(w[1], w[1]), by(w[2], w[2])
    xy, xz, yz = by(w[0], w[1]), by(w[0], w[2]), by(w[1], w[2])
    return (
        (less(ZERO, more(yy, zz)), less(xy, b[2]), more(xz, b[1])),
        (more(xy, b[2]), less(ZERO, more(xx, zz)), less(yz, b[0])),
        (less(xz, b[1]), more(yz, b[0]), less(ZERO, more(xx, yy))),
    )


def by(x: Any, y: Any) -> Any:
    """Product of two numbers."""
    if x is ZERO or y is ZERO:
        return ZERO
    if x is ONE:
        return y
    return x if y is ONE else x * y


def more(x: Any, y: Any) -> Any:
    """Sum of two numbers."""
    if x is ZERO:
        return y
    return x if y is ZERO else x + y


def less(x: Any, y: Any) -> Any:
    """Difference of two numbers."""
    if y is ZERO:
        return x
    return -y if x is ZERO else x - y


def known(value: float) -> Any:
    """A number as a symbol."""
    found = {0.0: ZERO, 1.0: ONE}.get(value)
    return ca.SX(value) if found is None else found


def vector(values: Any) -> Vector:
    """Three numbers as symbols."""
    x, y, z = (known(float(value)) for value in values)
    return x, y, z


def matrix(values: Any) -> Matrix:
    """Nine numbers as symbols."""
    return vector(values[0]), vector(values[1]), vector(values[2])


def _matrix(rows: Any) -> Matrix:
    return tuple(tuple(rows[i][j] for j in range(3)) for i in range(3))  # type: ignore[return-value]
