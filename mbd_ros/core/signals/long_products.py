"""Products of long matrices on the core that calls.

BLAS starts threads for a product of more than 2^18 multiplications. They wait busily for each
other, which costs more than products of this size take.
"""

import numpy as np

from mbd_ros.core.state import Array

_MOST = 1 << 18


def product(left: Array, right: Array) -> Array:
    """Matrix product left @ right, of which the inner side or that of `right` is the long one."""
    (rows, inner), columns = left.shape, right.shape[1]
    if columns > inner:
        step = max(_MOST // (rows * inner), 1)
        parts = [left @ right[:, i : i + step] for i in range(0, columns, step)]
        return np.concatenate(parts, axis=1)
    step = max(_MOST // (rows * columns), 1)
    total: Array = np.zeros((rows, columns))
    for i in range(0, inner, step):
        total += left[:, i : i + step] @ right[i : i + step]
    return total
