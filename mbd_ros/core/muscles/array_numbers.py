"""Functions of arrays under the names that kinematics k has for numbers and for symbols."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array


class ArrayNumbers:
    """What a curve asks of k where it gets arrays: one entry a muscle, a sample or both."""

    exp, log, sqrt, tanh = np.exp, np.log, np.sqrt, np.tanh
    maximum, minimum, where = np.maximum, np.minimum, np.where

    @staticmethod
    def piece(x: Array, breaks: Sequence[Any], rows: Sequence[Sequence[Any]]) -> list[Any]:
        """As `Kinematics.piece`, entry by entry."""
        chosen = list(rows[0])
        for left, row in zip(breaks, rows[1:], strict=True):
            after = x >= left
            chosen = [
                new if new is old else np.where(after, new, old)
                for new, old in zip(row, chosen, strict=True)
            ]
        return chosen
