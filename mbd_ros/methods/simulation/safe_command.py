"""The command in force: the last one, or the safe one when no other comes.

    u = (1 - weight) held + weight safe
    safe torque of the actuated joints   tau = -(1/gain + h S A S')^-1 v

`CommandWatch` holds the last command and hands over to the safe one; `SafeCommand` is what can be
trusted without a command.
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
    """Holds the last command and hands over to the safe one after `timeout`, within `ramp`.

        u = (1 - weight) held + weight safe

    The weight never jumps, so that neither the hand-over nor the return is a bump. All times are
    those of the simulation: while it stands, nothing times out. The safe command acts before the
    first one; a first command within `timeout` acts at once.

    Args:
        timeout: How long a command is held without a successor [s], > 0.
        ramp: Duration of the hand-over [s], >= 0.

    Attributes:
        timeout: See above; may change at any time.
        ramp: See above; may change at any time.
        held: The last command, shape (nu,); None before the first.
        weight: Share of the safe command, 0 .. 1.
        age: Time since the last command, or since the start [s].
        superseded: Those of them that another one replaced before a tick used them.
    """

    def __init__(self, timeout: float, ramp: float) -> None:
        self.timeout = timeout
        self.ramp = ramp
        self.received = self.superseded = 0
        self.restart()

    def restart(self) -> None:
        """Forget the commands; the counts stay."""
        self.held: Array | None = None
        self.weight, self.age = 0.0, 0.0
        self._is_new = False

    def take(self, u: Array) -> None:
        """A new command, shape (nu,), not to be changed by the caller any more."""
        self.received += 1
        self.superseded += self._is_new
        self.held, self.age, self._is_new = u, 0.0, True

    def begin(self, period: float) -> None:
        """A tick of that length [s] begins: the weight of the safe command for it."""
        self._is_new = False
        step = period / self.ramp if self.ramp > 0.0 else math.inf
        late = self.age >= self.timeout - _ROUNDING
        self.weight = min(max(self.weight + (step if late else -step), 0.0), 1.0)
        self.age += period

    def value(self, safe: Callable[[], Array]) -> Array:
        """The command of the tick that began: the held one, the safe one, or a mixture.

        Args:
            safe: Gives the safe command, shape (nu,); is asked only where it takes part.
        """
        if self.held is None:
            return safe()
        if self.weight == 0.0:
            return self.held
        return (1.0 - self.weight) * self.held + self.weight * safe()

    @property
    def is_safe(self) -> bool:
        """Whether the safe command takes part."""
        return self.held is None or self.weight > 0.0


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
