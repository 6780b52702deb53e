"""Alarms on numbers that should have mean 0 and deviation 1.

    g+ = max(0, g+ + e - k),   g- = max(0, g- - e - k),   alarm where either exceeds h

Source: E. S. Page, Biometrika 41 (1954) 100.
"""

import numpy as np

from mbd_ros.core.state import Array


class Cusum:
    """Two-sided cumulative sums of several numbers.

    Args:
        names: Of the numbers.
        allowance: k, half of the smallest shift that is looked for, in deviations.
        threshold: h, in deviations.
        jump: A number beyond it is an alarm by itself.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        allowance: float = 1.0,
        threshold: float = 30.0,
        jump: float = 10.0,
    ) -> None:
        self.names, self._k, self._h, self._jump = names, allowance, threshold, jump
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._sums = np.zeros((2, len(self.names)))
        self._newest = np.zeros(len(self.names))

    def add(self, normalized: Array) -> None:
        """Take residuals over their deviations, NaN where there is none, shape (n,)."""
        told = np.nan_to_num(normalized)
        self._newest = told
        both = np.array((told, -told)) - self._k
        raised = np.maximum(0.0, self._sums + np.where(np.isfinite(normalized), both, 0.0))
        self._sums = np.minimum(raised, 2.0 * self._h)  # so that an alarm ends with its cause

    def alarms(self) -> dict[str, str]:
        """Number -> what is wrong with it."""
        found = dict[str, str]()
        for i, name in enumerate(self.names):
            over, under = self._sums[:, i].tolist()
            if abs(self._newest[i]) > self._jump:
                found[name] = f"off by {self._newest[i]:.3g} deviations"
            elif max(over, under) > self._h:
                found[name] = "too large for long" if over > under else "too small for long"
        return found
