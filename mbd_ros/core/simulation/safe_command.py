"""The safe command: torques of actuators without a command that can be trusted."""

from dataclasses import dataclass

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

TYPES = ("damping", "zero")


@dataclass(frozen=True)
class SafeCommand:
    """The `safe` section: torque of the actuated joints without a command.

    `damping` is tau = -gain v, held for a step of h. A held damper stronger than the step
    allows would drive the joints that it should brake; hence the implicit form

        tau = -(1/gain + h S A S')⁻¹ v

    which is -gain v for small steps and at most stops the joints within one. A are the
    accelerations of unit torques, S picks the actuated joints. `zero` is no torque. It is not the
    default, since a leg in stance would fall.

    Attributes:
        type: damping or zero.
        gain: Of the damping [N·m·s/rad or N·s/m], >= 0, finite.
    """

    type: str = "damping"
    gain: float = 1.0

    def __post_init__(self) -> None:
        if self.type not in TYPES:
            raise ModelError(f"unknown type '{self.type}', accepted: {', '.join(TYPES)}")
        if not 0.0 <= self.gain < np.inf:
            raise ModelError(f"gain {self.gain:g} must be finite and >= 0")

    @property
    def is_zero(self) -> bool:
        """Whether the torque is always zero."""
        return self.type == "zero" or self.gain == 0.0

    def torque(self, v: Array, response: Array, step: float) -> Array:
        """Torque of the actuated joints [N·m or N], shape (n,).

        Args:
            v: Their velocity [rad/s or m/s], shape (n,).
            response: S A S': their accelerations per unit torque, shape (n, n).
            step: How long the torque is held [s].
        """
        if self.is_zero:
            return np.zeros(len(v))
        compliance: Array = np.eye(len(v)) / self.gain + step * response
        return np.asarray(-np.linalg.solve(compliance, v), dtype=np.float64)

    def __str__(self) -> str:
        return f"damping with gain {self.gain:g}" if not self.is_zero else "no torque"
