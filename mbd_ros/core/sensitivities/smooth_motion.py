"""Motion of a system in one mode, with steps that somebody else has chosen."""

from functools import partial
from typing import Any, ClassVar

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.events.mode_field import Margin, ModeField
from mbd_ros.core.events.transitions import Transitions
from mbd_ros.core.integration.adaptive_runge_kutta import runge_kutta
from mbd_ros.core.integration.dop853_tableau import DOP853
from mbd_ros.core.integration.stepping import Integrator, Stepper
from mbd_ros.core.projection.assembly import project
from mbd_ros.core.sensitivities.differences import slope
from mbd_ros.core.simulation.stepper_of import happenings, prepared
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SINGULAR

_UNBOUNDED = 1.0e9  # s: steps end where they are told
_ASIDE = 1.0e-4  # rad or m: for the change of rows


class _GivenSteps(Integrator):
    """Steps of order eight whose ends are given."""

    order: int = 8
    dense: ClassVar[bool] = True

    def prepare(self, system: Any, dt: float) -> Stepper:
        return runge_kutta(system, DOP853, dt, None)


class SmoothMotion:
    """A system between events.

    Args:
        system: The system of one phase.
        dt: Interval of the output, for the tolerance of events [s].
    """

    def __init__(self, system: System, dt: float) -> None:
        self.system = system
        self._steps = prepared(_GivenSteps(), system, _UNBOUNDED)
        self._field: ModeField | None = None
        self._transitions: Transitions | None = None
        rows, guards = happenings(system)
        if rows or guards:
            self._field = ModeField(system, with_surfaces=False)
            self._transitions = Transitions(self._field, dt)

    def follow(self, y: State, times: Array) -> State:
        """The end of a motion from a state, moved onto its rows first.

        Args:
            y: State of what is integrated, in its mode.
            times: Ends of steps, the begin first [s], shape (n + 1,).
        """
        return self.onto(self._followed(y, times)[-1])

    def states(self, y: State, times: Array) -> list[State]:
        """The states at the ends of the steps of `follow`."""
        return [self.onto(each) for each in self._followed(y, times)]

    def _followed(self, y: State, times: Array) -> list[State]:
        """States after steps of order eight, whose drift off the rows is rounding in a cycle."""
        y = self.onto(y)
        found = [y]
        self._steps.restart()
        self._steps.follow(self.system.accelerator(y.mode), y.mode)
        late = y.t - float(times[0])
        for t in times[1:].tolist():
            y = self._steps.step(y, None, t + late)
            found.append(y)
        return found

    def basis(self, y: State) -> Array:
        """Orthonormal tangents that keep the rows of its phase, shape (2 nv + nz, d)."""
        system, n = self.system, self.system.nv
        held, nz = system.held, len(y.z)
        if not held.rows:
            return np.eye(2 * n + nz)

        def seen(length: float, direction: Array) -> Array:
            q = system.chart.integrate(y.q, length * direction)
            rate = held.jacobian(y.t, q).dot(y.v) + held.rate(y.t, q)
            return np.concatenate((held.residual(y.t, q), rate))

        # A contact that is held may be anywhere on its ground: rows are no derivatives of gaps
        by_q = np.array([slope(partial(seen, direction=d), _ASIDE) for d in np.eye(n)]).T
        rows = held.jacobian(y.t, y.q)
        by_v = np.vstack((np.zeros_like(rows), rows))
        every = np.hstack((by_q, by_v, np.zeros((len(by_q), nz))))
        _, sizes, right = np.linalg.svd(every, full_matrices=True)
        kept: Array = right[int(np.sum(sizes > SINGULAR * sizes[0])) :].T
        return kept

    def onto(self, y: State) -> State:
        """The state on the rows of its mode."""
        y = project(self.system, y)
        if self._field is None or self._field.rows is None:
            return y
        self._field.mode = y.mode
        return self._field.onto_rows(y)

    def rate(self, y: State) -> Array:
        """Velocities, accelerations and rates of internal states in its mode."""
        a, zdot = np.zeros(self.system.nv), np.zeros(len(y.z))
        accelerate = self.system.accelerator(y.mode)
        if self.system.internals.nz:
            accelerate(y.t, y.q, y.v, y.z, None, a, zdot)
        else:
            accelerate(y.t, y.q, y.v, None, a)
        return np.concatenate((y.v, a, zdot))

    def margin_at(self, names: tuple[str, ...], y: State) -> Margin:
        """Which margin is zero where something of these names happens in this mode."""
        field = self._watched(y)
        numbers = {field.names.index(name) for name in names}
        guards = [i for i in numbers if i >= len(field.mode)]
        if guards:
            return guards[0], 0
        margins = {m: v for m, v in field.margins(y, None).items() if m[0] in numbers}
        return min(margins, key=lambda which: abs(margins[which]))

    def margin(self, y: State, which: Margin) -> float:
        """A margin of the mode; of a guard of a part its value."""
        field, first = self._watched(y), len(y.mode)
        if which[0] >= first:
            return float(field.guards.values(y, None, y.mode)[which[0] - first])
        return field.margin(y, None, which)

    def after(self, y: State, which: Margin) -> State:
        """The state after what happens where a margin is zero."""
        field = self._watched(y)
        if which[0] >= len(y.mode):
            return field.reset(y, None, [which[0]])
        assert self._transitions is not None
        self._transitions.forget()
        return self._transitions.happened(y, None, which)

    def _watched(self, y: State) -> ModeField:
        assert self._field is not None
        self._field.mode = y.mode
        return self._field
