"""A control loop: it answers states with commands, between a control law and the drives.

Every command is checked before it is sent: it must be finite and within the limits of the drives.
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

_ROUNDING = 1.0e-9  # of a hand-over, from the sum of its steps


class ControlLoop:
    """A control law with its reference, a guard, and the hand-over from and to the safe command.

        effort = guard((1 - weight) clip(control) + weight safe)

    The weight never jumps. It falls from 1 to 0 within `ramp` after the first state, rises when
    states stop (`lapse`), and falls again from its present value when they return. After a state
    that is more than `longest` later than the last one, or earlier, the loop restarts: the
    reference continues from the measurement, and the weight stays until the next state. If the
    state is earlier, time was reset, and the weight starts at 1.

    Args:
        controller: The control law; a law for the same joints may replace it between updates.
        generator: Generator of the reference.
        guard: Limits of the efforts.
        safe: The safe command, which acts while the control law is not trusted.
        ramp: Duration of a hand-over [s], >= 0.
        longest: Longest time between states that is no gap [s]; a gap counts as this time.
        chatter: Meter of the chatter of the efforts that are sent.
        watch: Monitor that decides whether the loop is lost; None never decides so.

    Attributes:
        ramp: May be changed at any time.
        longest: May be changed at any time.
        weight: Share of the safe command, 0 .. 1.
        is_open: Whether no state was answered since the start, or the last lapse or stop.
        is_frozen: Whether nobody receives the commands. The memory of the control law is then
            constant, as during a hand-over: it must not learn from commands of others.
        control: Latest output of the control law.
        lapses: Number of times that states stopped for so long that the safe command took over.
        failures: Number of successive updates without a usable output of the control law, during
            which its last output is used.
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
        self.is_frozen = False
        self.lapses = 0
        self.weight = 1.0
        self.control: Control | None = None
        self._memory = controller.begin()
        self._none = np.zeros(len(controller.joints))
        self._sent = self._none
        self._v = self._none
        self._t = 0.0
        self._is_lapsed = True
        self.restart()

    def restart(self) -> None:
        """Hold the next state as the reference, and continue from the last command."""
        self.is_open = True
        self._is_restarted = True
        self.failures = 0
        self.generator.kind = "held"
        self.chatter.reset()
        if self.watch is not None:
            self.watch.reset()

    def replace(self, controller: Controller) -> None:
        """Use a new control law from the next update on, with the present memory if that fits."""
        if controller.begin().shape != self._memory.shape:
            self._memory = controller.begin()
        self.controller = controller
        if self.watch is not None:
            self.watch.use(controller)

    def take_over(self, other: ControlLoop) -> None:
        """Continue another loop for the same joints without a jump of the command."""
        self.weight = other.weight
        self.lapses = other.lapses
        self._is_lapsed = other._is_lapsed
        self.is_open = other.is_open
        self._is_restarted = other._is_restarted
        self._t = other._t
        self._v = other._v
        self._sent = other._sent
        self.control = other.control
        self.generator.take_over(other._t, other.generator)
        if other._memory.shape == self._memory.shape:
            self._memory = other._memory

    def update(self, x: State, measured: Array | None = None) -> Command:
        """Return the command for a new state.

        Args:
            x: Consistent state of all joints.
            measured: Efforts that acted until then [N·m or N], NaN if not measured, shape (n,).

        Raises:
            SolveError: The control law has no solution, and never had one.
        """
        joints = self.controller.joints
        q, v = joints.positions(x), joints.velocities(x)
        self._v = v
        dt = 0.0 if self.is_open else min(max(x.t - self._t, 0.0), self.longest)
        if x.t < self._t and not self._is_restarted:
            self.weight = 1.0
        self._is_restarted = False
        is_gap = self.is_open or not 0.0 <= x.t - self._t <= self.longest
        if is_gap:
            self._close(x.t, q, v)
        self._t = x.t
        ref = self.generator.at(x.t)
        if self._is_trusted_again(x.t, dt, q - ref.q, v, measured):
            self._close(x.t, q, v)
            ref = self.generator.at(x.t)
        is_lost = self.watch is not None and bool(self.watch.fault)
        step = 0.0 if is_gap else dt
        self._shift(dt if is_lost else -step)
        box = self.guard.box(self._sent, dt)
        control = self._control(x, ref, box, dt)
        effort = control.effort
        if self.weight > 0.0:
            effort = (1.0 - self.weight) * self.guard.clip(effort) + self.weight * self._safe(dt)
        admitted, is_clipped = self.guard.admit(effort, box)
        self.chatter.update(admitted, dt)
        self._sent = admitted
        if self.watch is not None:
            self.watch.meter.send(x.t, admitted)
        return Command(admitted, q - ref.q, control.s, is_clipped)

    def lapse(self, dt: float) -> Array | None:
        """Return the efforts while no state comes; None once the safe command was sent.

        Without a state there is no velocity to damp, so the safe command is zero effort.

        Args:
            dt: Time since the last command [s].
        """
        if self.weight >= 1.0 and self.is_open and not self._sent.any():
            return None
        self.lapses += not self._is_lapsed
        self.is_open = self._is_lapsed = True
        self._shift(min(dt, self.longest))
        last = self._none if self.control is None else self.guard.clip(self.control.effort)
        box = self.guard.box(self._sent, dt)
        self._sent, _ = self.guard.admit((1.0 - self.weight) * last, box)
        return self._sent

    def stop(self, is_fresh: bool) -> Array:
        """Return the last efforts before commands end: the safe ones at the latest state.

        The model is not evaluated again, since it may have failed.

        Args:
            is_fresh: Whether the velocities of that state are still valid; otherwise the safe
                command is zero effort.
        """
        self.weight = 1.0
        self.is_open = True
        self._is_lapsed = True
        self.control = None
        self._sent = self.guard.clip(self._safe(self.longest) if is_fresh else self._none)
        return self._sent

    def _safe(self, step: float) -> Array:
        """Return the safe efforts at the latest state for a time [s]; zero if not finite."""
        newest = self.controller.joints.newest
        if newest is None:
            return self._none
        late = 0.0 if self.watch is None else self.watch.safe_step
        effort = self.safe.torque(self._v, newest.mobility, step + late)
        return effort if np.isfinite(effort).all() else self._none

    def _close(self, t: float, q: Array, v: Array) -> None:
        """Close the loop when states come; a control law that had ended starts again."""
        self.generator.resume(t, q, v)
        if self.weight >= 1.0:
            self._memory = self.controller.begin()
        self.is_open = self._is_lapsed = False
        self.chatter.reset()
        if self.watch is not None:
            self.watch.begin()

    def _is_trusted_again(
        self, t: float, dt: float, error: Array, v: Array, measured: Array | None
    ) -> bool:
        """Update the monitor, and return whether a lost loop may close again."""
        watch = self.watch
        if watch is None:
            return False
        was_lost = bool(watch.fault)
        watch.update(t, dt, error, v, measured, self.weight == 0.0)
        return was_lost and not watch.fault

    def _shift(self, dt: float) -> None:
        step = dt / self.ramp if self.ramp > 0.0 else np.copysign(np.inf, dt)
        weight = min(max(self.weight + step, 0.0), 1.0)
        self.weight = weight if _ROUNDING < weight < 1.0 - _ROUNDING else round(weight)

    def _control(self, x: State, ref: Reference, box: EffortBox, dt: float) -> Control:
        """Return the output of the control law, or its last one if it has no solution."""
        try:
            control = self.controller.effort(x, ref, self._memory, box)
            total = float(control.effort.sum() + control.s.sum() + control.memory_rate.sum())
            if not total - total == 0.0:
                raise SolveError("the output of the control law is not finite")
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
    """The command that is sent, with the error that it answers.

    Attributes:
        effort: Efforts of the controlled joints within their limits [N·m or N], shape (n,).
        error: Tracking error q - ref.q [rad or m], shape (n,).
        s: Sliding variable [rad/s or m/s], shape (n,).
        is_clipped: Whether the guard clipped the effort of a joint, shape (n,).
    """

    effort: Array
    error: Array
    s: Array
    is_clipped: NDArray[np.bool_]


class Guard:
    """Limits of size and rate for efforts.

    Args:
        names: Joints, for messages.
        limit: Largest effort of each joint [N·m or N], shape (n,), inf without a limit.
        rate: Largest rate of change of all efforts [N·m/s or N/s], > 0; inf without a limit.

    Attributes:
        rate: May be changed at any time.
    """

    def __init__(self, names: Sequence[str], limit: Array, rate: float = math.inf) -> None:
        self._names, self.limit, self.rate = tuple(names), limit, rate

    @property
    def powerless(self) -> tuple[str, ...]:
        """Joints whose limit is 0, so that commands have no effect."""
        return tuple(n for n, limit in zip(self._names, self.limit, strict=True) if limit == 0.0)

    def clip(self, effort: Array) -> Array:
        """Return efforts clipped to the limits of size, shape (n,)."""
        return np.minimum(np.maximum(effort, -self.limit), self.limit)

    def box(self, last: Array, dt: float) -> EffortBox:
        """Return the bounds of the next efforts.

        Args:
            last: Efforts that were sent last [N·m or N], shape (n,).
            dt: Time since then [s], >= 0.
        """
        if self.rate == math.inf:
            return EffortBox(-self.limit, self.limit)
        step = self.rate * dt
        lower = np.minimum(np.maximum(last - step, -self.limit), self.limit)
        return EffortBox(lower, np.maximum(np.minimum(last + step, self.limit), lower))

    def admit(self, effort: Array, box: EffortBox) -> tuple[Array, NDArray[np.bool_]]:
        """Clip efforts to their bounds; also return which were clipped, shapes (n,).

        Raises:
            SolveError: An effort is not finite.
        """
        if not np.isfinite(effort).all():
            lost = [n for n, value in zip(self._names, effort, strict=True) if value - value != 0]
            raise SolveError(f"effort of {', '.join(lost)} is not finite")
        admitted = np.minimum(np.maximum(effort, box.lower), box.upper)
        return admitted, admitted != effort
