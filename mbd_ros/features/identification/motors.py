"""Motors that turn with several joints, as those of a wrist behind bevel gears.

    w = U v,    tau = U' tau_m

with v and tau of joints, w and tau_m of motors, reduced to the joints that bear their names: U has
ones on its diagonal. Friction is a function of w, so that rows of motors, U^-T times those of the
joints, have a friction of their own each.

Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, section 9.7
(coupled transmissions).
"""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array


class Motors(NamedTuple):
    """Motors of the rows of an identification.

    Attributes:
        ratios: U, shape (m, m).
        are_measured: Whether efforts are those of motors, not of joints.
    """

    ratios: Array
    are_measured: bool = False

    @classmethod
    def of_joints(cls, count: int) -> "Motors":
        """One motor a joint."""
        return cls(np.eye(count))

    @property
    def are_coupled(self) -> bool:
        """Whether any turns with several joints."""
        return bool(np.any(self.ratios != np.eye(len(self.ratios))))

    @property
    def others(self) -> list[dict[int, float]]:
        """Of each motor the other joints that turn it, and their ratios."""
        m = len(self.ratios)
        return [
            {j: float(row[j]) for j in range(m) if j != i and row[j] != 0.0}
            for i, row in enumerate(self.ratios)
        ]

    @property
    def alone(self) -> Array:
        """Motors of one joint that turns no other motor, shape (m,) of truth."""
        apart = self.ratios != np.eye(len(self.ratios))
        return np.asarray(~(apart.any(axis=0) | apart.any(axis=1)))

    def speeds(self, v: Array) -> Array:
        """Of motors, of those of joints, shape (.., m)."""
        return v @ self.ratios.T

    def torques(self, tau: Array) -> Array:
        """Of motors, of those of joints, shape (.., m)."""
        return tau @ np.linalg.inv(self.ratios)

    def measured(self, tau: Array) -> Array:
        """What is measured of torques of joints, shape (.., m)."""
        return self.torques(tau) if self.are_measured else tau

    def from_measured(self, effort: Array) -> Array:
        """Torques of motors of what is measured, shape (.., m)."""
        return effort if self.are_measured else self.torques(effort)

    def as_measured(self, torque: Array) -> Array:
        """Inverse of `from_measured`."""
        return torque if self.are_measured else torque @ self.ratios
