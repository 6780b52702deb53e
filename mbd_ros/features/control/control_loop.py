"""A control loop: states in, commands out, between a control law and the drives.

Before a command leaves it is checked: it must be finite, and within the reach of the drives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.features.control.loop_watch import ChatterMeter, LoopWatch
from mbd_ros.features.control.reference import ReferenceGenerator
from mbd_ros.methods.control.contract import Control, Controller, EffortBox, Reference
from mbd_ros.methods.simulation.safe_command import SafeCommand

_ROUNDING = 1.0e-9  # share of a hand-over that comes of adding steps


class ControlLoop:
    """A controller with reference, guard and the hand-over from and to the safe command.

        effort = guard((1 - weight) clip(control) + weight safe)

    The weight never jumps. It falls from 1 to 0 within `ramp` after the first state, rises when
    states stop (`lapse`), and falls again, from its present value, when they come back. A state
    that comes later than `longest` after the last one, or before it, is a new beginning: the
    reference continues from the measurement, and the weight stays until the next one. With a
    state before the last one time began anew, and the weight begins at 1.

    Args:
        controller: The control law; may be replaced between updates by one for the same joints.
        safe: The safe command, which acts while the control is not trusted.
        ramp: Duration of a hand-over [s], >= 0.
        longest: A longer time between states is a gap, and counts as no more than that [s].
        chatter: Measures the efforts that are sent.
        watch: Tells when the loop is lost; None trusts it.

    Attributes:
        ramp: May change at any time.
        longest: May change at any time.
        weight: Share of the safe command, 0 .. 1.
        is_open: Whether no state was answered since the start, or the last lapse or stop.
        is_frozen: Whether nobody hears the commands. The memory of the control law
            then stands still, as while the safe command takes part: it must not learn from
            commands that it did not give.
        control: The newest answer of the control law.
        lapses: How often states stopped for so long that the command had to go safe.
        failures: Updates in a row without a usable answer of the control law; the last one is
            kept.
    """

    def __init__(
        self,
        controller: Controller,
        generator: ReferenceGenerator,
        guard: Guard,
        safe: SafeCommand,
        ramp: float,
        longest: float,
        chatter: ChatterMeter,
        watch: LoopWatch | None = None,
    ) -> None:
        self.controller = controller
        self.generator = generator
        self.guard = guard
        self.safe = safe
        self.ramp = ramp
        self.longest = longest
        self.chatter = chatter
        self.watch = watch
        self.is_frozen, self.lapses, self.weight = False, 0, 1.0
        self.control: Control | None = None
        self._memory = controller.begin()
        self._none = np.zeros(len(controller.joints))
        self._sent, self._v, self._t, self._is_lapsed = self._none, self._none, 0.0, True
        self.restart()

    def restart(self) -> None:
        """Hold the next state, whatever was followed, from the last command."""
        self.is_open, self._is_forgotten, self.failures = True, True, 0
        self.generator.kind = "held"
        self.chatter.reset()
        if self.watch is not None:
            self.watch.reset()

    def replace(self, controller: Controller) -> None:
        """Use a new control law from the next update on; its memory is kept where it fits."""
        if controller.begin().shape != self._memory.shape:
            self._memory = controller.begin()
        self.controller = controller
        if self.watch is not None:
            self.watch.use(controller)

    def take_over(self, other: ControlLoop) -> None:
        """Continue without a bump where another loop for the same joints was at work."""
        self.weight, self.lapses, self._is_lapsed = other.weight, other.lapses, other._is_lapsed
        self.is_open, self._is_forgotten = other.is_open, other._is_forgotten
        self._t, self._v = other._t, other._v
        self._sent, self.control = other._sent, other.control
        self.generator.take_over(other._t, other.generator)
        if other._memory.shape == self._memory.shape:
            self._memory = other._memory

    def update(self, x: State, acted: Array | None = None) -> Command:
        """The command for a new state.

        Args:
            x: Consistent state of all joints.
            acted: Efforts that acted until then [N·m or N], NaN where not measured, shape (n,).

        Raises:
            SolveError: The control law has no answer, and had none yet.
        """
        joints = self.controller.joints
        q, v = joints.positions(x), joints.velocities(x)
        self._v = v
        dt = 0.0 if self.is_open else min(max(x.t - self._t, 0.0), self.longest)
        if x.t < self._t and not self._is_forgotten:
            self.weight = 1.0
        self._is_forgotten = False
        begins = self.is_open or not 0.0 <= x.t - self._t <= self.longest
        if begins:
            self._close(x.t, q, v)
        self._t = x.t
        ref = self.generator.at(x.t)
        if self._is_back(x.t, dt, q - ref.q, v, acted):
            self._close(x.t, q, v)
            ref = self.generator.at(x.t)
        is_lost = self.watch is not None and bool(self.watch.fault)
        handed_over = 0.0 if begins else dt
        self._shift(dt if is_lost else -handed_over)
        box = self.guard.box(self._sent, dt)
        control = self._controlled(x, ref, box, dt)
        effort = control.effort
        if self.weight > 0.0:
            effort = (1.0 - self.weight) * self.guard.sized(effort) + self.weight * self._safe(dt)
        admitted, held_back = self.guard.admit(effort, box)
        self.chatter.update(admitted, dt)
        self._sent = admitted
        if self.watch is not None:
            self.watch.meter.send(x.t, admitted)
        return Command(admitted, q - ref.q, control.s, held_back)

    def lapse(self, dt: float) -> Array | None:
        """The efforts while no state comes; None once the safe command was sent.

        Without a state there is no velocity to damp: the safe command is no torque then.

        Args:
            dt: Time since the last command [s].
        """
        if self.weight >= 1.0 and self.is_open and not self._sent.any():
            return None
        self.lapses += not self._is_lapsed
        self.is_open = self._is_lapsed = True
        self._shift(min(dt, self.longest))
        kept = self._none if self.control is None else self.guard.sized(self.control.effort)
        box = self.guard.box(self._sent, dt)
        self._sent, _ = self.guard.admit((1.0 - self.weight) * kept, box)
        return self._sent

    def stop(self, is_fresh: bool) -> Array:
        """The last efforts before commands end: the safe ones at the newest state.

        The model is not asked again: it may have failed.

        Args:
            is_fresh: Whether that state still tells the velocities; without, safe is no torque.
        """
        self.weight, self.is_open, self._is_lapsed, self.control = 1.0, True, True, None
        self._sent = self.guard.sized(self._safe(self.longest) if is_fresh else self._none)
        return self._sent

    def _safe(self, step: float) -> Array:
        """The safe efforts at the newest state, held for a time [s]; none where not finite."""
        newest = self.controller.joints.newest
        if newest is None:
            return self._none
        late = 0.0 if self.watch is None else self.watch.safe_step
        effort = self.safe.torque(self._v, newest.mobility, step + late)
        return effort if np.isfinite(effort).all() else self._none

    def _close(self, t: float, q: Array, v: Array) -> None:
        """States come, for the first time or again; a law that had ended begins anew."""
        self.generator.resume(t, q, v)
        if self.weight >= 1.0:
            self._memory = self.controller.begin()
        self.is_open = self._is_lapsed = False
        self.chatter.reset()
        if self.watch is not None:
            self.watch.begin()

    def _is_back(self, t: float, dt: float, error: Array, v: Array, acted: Array | None) -> bool:
        """Whether a loop that was lost may close again."""
        watch = self.watch
        if watch is None:
            return False
        was_lost = bool(watch.fault)
        watch.update(t, dt, error, v, acted, self.weight == 0.0)
        return was_lost and not watch.fault

    def _shift(self, dt: float) -> None:
        step = dt / self.ramp if self.ramp > 0.0 else np.copysign(np.inf, dt)
        weight = min(max(self.weight + step, 0.0), 1.0)
        self.weight = weight if _ROUNDING < weight < 1.0 - _ROUNDING else round(weight)

    def _controlled(self, x: State, ref: Reference, box: EffortBox, dt: float) -> Control:
        """The answer of the control law, or its last one where it has none."""
        try:
            control = self.controller.effort(x, ref, self._memory, box)
            total = float(control.effort.sum() + control.s.sum() + control.memory_rate.sum())
            if not total - total == 0.0:
                raise SolveError("the answer of the control law is not finite")
        except SolveError:
            self.failures += 1
            if self.control is None:
                raise
            return self.control
        self.failures, self.control = 0, control
        if len(self._memory) and self.weight == 0.0 and not self.is_frozen:
            self._memory = self._memory + dt * control.memory_rate
        return control


class Command(NamedTuple):
    """The command that is sent, and its cause.

    Attributes:
        effort: Of the controlled joints, guarded [N·m or N], shape (n,).
        error: q - ref.q [rad or m], shape (n,).
        s: Sliding variable [rad/s or m/s], shape (n,).
        held_back: Joints whose effort the guard clipped, shape (n,).
    """

    effort: Array
    error: Array
    s: Array
    held_back: NDArray[np.bool_]


class Guard:
    """Keeps efforts within limits of size and of rate.

    Args:
        names: Joints, for messages.
        limit: Largest effort of each joint [N·m or N], shape (n,), inf without a limit.
        rate: Largest change of it [N·m/s or N/s], > 0, one for all joints; inf without a limit.

    Attributes:
        rate: May change at any time.
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
