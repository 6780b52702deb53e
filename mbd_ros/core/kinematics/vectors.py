"""Products of many vectors at once, whose components stand in the last axis.

All functions broadcast and take complex numbers and symbols, too. They cost a fraction of numpy's
own for the few vectors of a mechanism.
"""

import numpy as np

from mbd_ros.core.state import Array


def cross(a: Array, b: Array) -> Array:
    """Vector products a x b, shape (.., 3)."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    first = a1 * b2 - a2 * b1
    product = np.empty((*np.shape(first), 3), np.result_type(a.dtype, b.dtype))
    product[..., 0] = first
    product[..., 1] = a2 * b0 - a0 * b2
    product[..., 2] = a0 * b1 - a1 * b0
    return product


def dot(a: Array, b: Array) -> Array:
    """Scalar products a . b, shape (..)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def lengths(vectors: Array) -> Array:
    """Lengths sqrt(v . v), shape (..)."""
    return np.asarray(np.sqrt(dot(vectors, vectors)))


def unit(vectors: Array) -> Array:
    """Vectors of length 1; zero where they have none."""
    length = lengths(vectors)[..., None]
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))
