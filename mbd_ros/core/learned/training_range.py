"""How far a learned force is trusted: wholly where it has learned, less beyond."""

import numpy as np

from mbd_ros.core.state import Array

FADE = 0.25  # width of a fade, over half of what an entry spans, unless a scene says another


class TrainingRange:
    """A box of positions and velocities, and how trust fades beyond its walls.

    With d the largest distance of an entry beyond its wall, over half of what that entry spans:
    share = 1 for d = 0, 0 from d = `fade` on, and (1 + 2 d / fade) (1 - d / fade)^2 between.

    Args:
        low: Smallest values, shape (n,).
        high: Largest ones, same shape.
        fade: Width in which it fades, over half of what an entry spans.
    """

    def __init__(self, low: Array, high: Array, fade: float = FADE) -> None:
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self._fade = fade

    def beyond(self, values: Array) -> Array:
        """Distance beyond the walls, over half of what an entry spans, shape (n,); 0 inside."""
        found: Array = np.abs(values - self._middle) / self._half - 1.0
        return np.maximum(found, 0.0)

    def share(self, values: Array) -> float:
        """Trust in a force at these values, 0 .. 1."""
        far = float(self.beyond(values).max(initial=0.0)) / self._fade
        return (1.0 + 2.0 * far) * (1.0 - far) ** 2 if far < 1.0 else 0.0

    def shares(self, values: Array) -> Array:
        """The same of many values, one set a row: shape (rows,)."""
        far = np.minimum(self.beyond(values).max(axis=1, initial=0.0) / self._fade, 1.0)
        return np.asarray((1.0 + 2.0 * far) * (1.0 - far) ** 2)
