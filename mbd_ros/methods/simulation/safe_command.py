"""Command hold and safe command of actuators when commands stop arriving.

    u = (1 - weight) last + weight safe
    safe torque of the actuated joints   tau = -(1/gain + h S A S')^-1 v

`CommandWatch` holds the last command and blends to the safe one after a timeout; `SafeCommand`
computes the safe torque.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_ROUNDING = 1.0e-9  # s
TYPES = ("damping", "zero")


class CommandWatch:
    """Holds the last command, and blends to the safe command after `timeout`, within `ramp`.

        u = (1 - weight) last + weight safe

    The weight is continuous, so that neither the transition nor the return causes a jump. All
    times are simulated time: while the simulation is paused, nothing times out. Before the first
    command the safe command applies; a first command within `timeout` applies at once.

    Args:
        timeout: Time for which a command is held without a new one [s], > 0.
        ramp: Duration of the transition [s], >= 0.

    Attributes:
        timeout: Argument of this name; may change at any time.
        ramp: Argument of this name; may change at any time.
        last: The last command, shape (nu,); None before the first.
        weight: Share of the safe command, 0 .. 1.
        age: Time since the last command, or since the start [s].
        received: Number of received commands.
        superseded: Number of commands that were replaced before a tick used them.
    """

    def __init__(self, timeout: float, ramp: float) -> None:
        self.timeout = timeout
        self.ramp = ramp
        self.received = self.superseded = 0
        self.restart()

    def restart(self) -> None:
        """Discard the commands; the counts stay."""
        self.last: Array | None = None
        self.weight, self.age = 0.0, 0.0
        self._is_new = False

    def take(self, u: Array) -> None:
        """Take a new command, shape (nu,), which the caller must not change afterwards."""
        self.received += 1
        self.superseded += self._is_new
        self.last = u
        self.age = 0.0
        self._is_new = True

    def begin(self, period: float) -> None:
        """Begin a tick of a period [s]: update the weight of the safe command."""
        self._is_new = False
        step = period / self.ramp if self.ramp > 0.0 else math.inf
        late = self.age >= self.timeout - _ROUNDING
        self.weight = min(max(self.weight + (step if late else -step), 0.0), 1.0)
        self.age += period

    def value(self, safe: Callable[[], Array]) -> Array:
        """Return the command of the tick that began: the last one, the safe one, or a blend.

        Args:
            safe: Function that returns the safe command, shape (nu,); called only if needed.
        """
        if self.last is None:
            return safe()
        if self.weight == 0.0:
            return self.last
        return (1.0 - self.weight) * self.last + self.weight * safe()

    @property
    def is_safe(self) -> bool:
        """Whether the safe command contributes to the command."""
        return self.last is None or self.weight > 0.0


@dataclass(frozen=True)
class SafeCommand:
    """Torque of the actuated joints without a command, the `safe` section of a scene.

    `damping` applies tau = -gain v, which is constant over a step h. An explicit damper that is
    too strong for the step would accelerate the joints instead of braking them; the implicit form

        tau = -(1/gain + h S A S')⁻¹ v

    equals -gain v for small steps and at most stops the joints within one. A are the
    accelerations of unit torques, S selects the actuated joints. `zero` applies no torque. It is
    not the default, since a leg in stance would fall.

    Attributes:
        type: damping or zero.
        gain: Damping gain [N·m·s/rad or N·s/m], >= 0, finite.
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
        """Return the torque of the actuated joints [N·m or N], shape (n,).

        Args:
            v: Velocity of the actuated joints [rad/s or m/s], shape (n,).
            response: S A S', their accelerations per unit torque, shape (n, n).
            step: Time for which the torque is constant [s].
        """
        if self.is_zero:
            return np.zeros(len(v))
        compliance: Array = np.eye(len(v)) / self.gain + step * response
        return np.asarray(-np.linalg.solve(compliance, v), dtype=np.float64)

    def __str__(self) -> str:
        return f"damping with gain {self.gain:g}" if not self.is_zero else "no torque"
