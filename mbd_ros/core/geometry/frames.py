"""Cross products and contact frames of many features at once; complex numbers go, too."""

import numpy as np

from mbd_ros.core.state import Array, is_symbol

_OPPOSITE = 1.0e-12  # half the square of a sum of unit vectors that are opposite
_CORNERS = np.stack([np.roll(np.eye(3), -axis, axis=0) for axis in range(3)])
BASES = np.stack((_CORNERS, _CORNERS * np.array(((-1.0,), (1.0,), (-1.0,)))), axis=1)
"""Right-handed bases along the axes, rows: of axis i upwards and downwards, (3, 2, 3, 3)."""


def crossed(a: Array, b: Array) -> Array:
    """Cross product a x b along the last axis, many times faster than numpy's for few of them."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)


def dotted(a: Array, b: Array) -> Array:
    """Scalar products of rows, shape (n,)."""
    product: Array = np.einsum("...j,...j->...", a, b)
    return product


def lengths(vectors: Array) -> Array:
    """Lengths of rows, shape (n,)."""
    length: Array = np.sqrt(dotted(vectors, vectors))
    return length


def directions(vectors: Array, length: Array, otherwise: Array) -> Array:
    """Rows of length 1, shape (n, 3).

    Args:
        vectors: Shape (n, 3).
        length: Their lengths, shape (n,).
        otherwise: Direction of those without length, shape (3,) or (n, 3).
    """
    if is_symbol(length.flat[0]):  # where two points meet, expressions have no direction
        symbolic: Array = vectors / length[:, None]
        return symbolic
    some = length.real > 0.0
    return np.where(some[:, None], vectors / np.where(some, length, 1.0)[:, None], otherwise)


def nearest_bases(normals: Array) -> Array:
    """The bases along axes whose normals are nearest to directions, shape (n, 3, 3), rows.

    Args:
        normals: Any directions, shape (n, 3).
    """
    axis = np.argmax(np.abs(normals.real), axis=1)
    is_down = normals.real[np.arange(len(normals)), axis] < 0.0
    return BASES[axis, is_down.astype(np.intp)]


def framed(normal: Array, basis: Array) -> Array:
    """Normals and tangents, the basis turned by the smallest rotation, shape (n, 3, 3), rows.

    Opposite to the normal of the basis tangents have no direction of their own.

    Args:
        normal: Shape (n, 3).
        basis: Normal and tangents, rows, shape (3, 3), or one each, shape (n, 3, 3).
    """
    total = normal + basis[..., 0, :]
    square = dotted(total, total) / 2.0
    is_traced = is_symbol(square.flat[0])
    is_opposite = np.zeros(len(square), np.bool_) if is_traced else square.real < _OPPOSITE
    share = dotted(basis[..., 1:, :], normal[:, None])
    share = share / np.where(is_opposite, 1.0, square)[:, None]
    axes = np.empty((len(normal), 3, 3), dtype=total.dtype)
    axes[:, 0] = normal
    axes[:, 1:] = basis[..., 1:, :] - share[:, :, None] * total[:, None]
    if is_opposite.any():
        axes[is_opposite, 2] *= -1.0
    return axes
