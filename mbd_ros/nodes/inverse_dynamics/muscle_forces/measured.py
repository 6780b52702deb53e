"""Activations that arrive on a topic, by the names of muscles."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from msg_adapters.errors import MessageError


class MeasuredActivations:
    """The newest activation of each muscle, as long as it stands.

    Args:
        names: Of the muscles.
        max_age: How long a value stands [s].
        clock: Steady time [s].
    """

    def __init__(self, names: Sequence[str], max_age: float, clock: Callable[[], float]) -> None:
        self._at = {name: i for i, name in enumerate(names)}
        self._max_age, self._clock = max_age, clock
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self._values = np.full(len(self._at), np.nan)
        self._heard = np.full(len(self._at), -np.inf)

    def take(self, msg: Any) -> None:
        """Values of a Float64MultiArray whose layout labels are names of muscles.

        Raises:
            MessageError: Not one label a value, no label of a muscle, or a value outside 0 .. 1.
        """
        labels = [dimension.label for dimension in msg.layout.dim]
        if len(labels) != len(msg.data):
            raise MessageError(
                f"{len(labels)} labels for {len(msg.data)} values; expected one each"
            )
        found = [(self._at[n], v) for n, v in zip(labels, msg.data, strict=True) if n in self._at]
        if not found:
            raise MessageError(f"no label is a muscle; muscles are {', '.join(self._at)}")
        for i, value in found:
            if not 0.0 <= value <= 1.0:
                name = list(self._at)[i]
                raise MessageError(f"activation of {name} is {value:.6g}, accepted: 0 .. 1")
        now = self._clock()
        for i, value in found:
            self._values[i], self._heard[i] = value, now

    def now(self) -> Array:
        """Values that stand, NaN for the others, shape (n,)."""
        fresh = self._clock() - self._heard <= self._max_age
        return np.where(fresh, self._values, np.nan)
