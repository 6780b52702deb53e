"""Where numbers of contacts with friction stand in vectors and matrices of their rows."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class ConePlaces(NamedTuple):
    """Places of n contacts.

    Attributes:
        tangents: Their rows, shape (2, n).
        friction: Entries of a matrix, counted row by row: the columns of a contact in the row of
            its first tangent, shape (3, n).
        turns: The same: columns of both tangents in the row of the second one, shape (2, n).
    """

    tangents: NDArray[np.intp]
    friction: NDArray[np.intp]
    turns: NDArray[np.intp]


@lru_cache(64)
def cone_places(m: int, normals: tuple[int, ...]) -> ConePlaces:
    """Places of contacts whose normals, with two tangents behind each, stand among m rows."""
    normal = np.array(normals, dtype=np.intp)
    first, second = normal + 1, normal + 2
    friction = np.stack((first * m + normal, first * (m + 1), first * m + second))
    turns = np.stack((second * m + first, second * (m + 1)))
    return ConePlaces(np.stack((first, second)), friction, turns)
