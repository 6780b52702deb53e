"""std_msgs/Float64MultiArray with a label a value -> vector in the order of labels."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def read_labelled(msg: Any, labels: Sequence[str]) -> NDArray[np.float64]:
    """Values of one message by the labels of its dimensions, one each.

    Args:
        msg: Float64MultiArray whose layout has a dimension a value, or none.
        labels: Those asked for.

    Returns:
        Shape (len(labels),), NaN where a label is missing.
    """
    data, dimensions = msg.data, msg.layout.dim
    found = (
        {one.label: at for at, one in enumerate(dimensions)}
        if len(dimensions) == len(data)
        else {}
    )
    rows = [found.get(label) for label in labels]
    return np.array([math.nan if row is None else data[row] for row in rows], dtype=np.float64)
