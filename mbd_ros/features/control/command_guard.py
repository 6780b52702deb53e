"""The last check before a command leaves: finite, and within the reach of the drives."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.control.contract import EffortBox
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError


class Guard:
    """Keeps efforts within limits of size and of rate.

    Args:
        names: Joints, for messages.
        limit: Largest effort of each joint [N·m or N], shape (n,), inf without a limit.
        rate: Largest change of it [N·m/s or N/s], > 0, one for all joints; inf without a limit.

    Attributes:
        limit: As given.
        rate: As given; may change at any time.
    """

    def __init__(self, names: Sequence[str], limit: Array, rate: float = math.inf) -> None:
        self._names, self.limit, self.rate = tuple(names), limit, rate

    @property
    def powerless(self) -> tuple[str, ...]:
        """Joints whose limit is 0: commands to them have no effect."""
        return tuple(n for n, limit in zip(self._names, self.limit, strict=True) if limit == 0.0)

    def sized(self, effort: Array) -> Array:
        """Efforts clipped to the limits of size, fresh, shape (n,)."""
        return np.minimum(np.maximum(effort, -self.limit), self.limit)

    def box(self, last: Array, dt: float) -> EffortBox:
        """Efforts that may be sent now.

        Args:
            last: The efforts sent last [N·m or N], shape (n,).
            dt: Time since then [s], >= 0.
        """
        if self.rate == math.inf:
            return EffortBox(-self.limit, self.limit)
        step = self.rate * dt
        lower = np.minimum(np.maximum(last - step, -self.limit), self.limit)
        return EffortBox(lower, np.maximum(np.minimum(last + step, self.limit), lower))

    def admit(self, effort: Array, box: EffortBox) -> tuple[Array, NDArray[np.bool_]]:
        """The efforts that may leave, fresh, and which joints were held back, each (n,).

        Raises:
            SolveError: An effort is not finite.
        """
        if not np.isfinite(effort).all():
            lost = [n for n, value in zip(self._names, effort, strict=True) if value - value != 0]
            raise SolveError(f"effort of {', '.join(lost)} is not finite")
        admitted = np.minimum(np.maximum(effort, box.lower), box.upper)
        return admitted, admitted != effort
