"""Stages of an explicit Runge-Kutta method on any configuration space."""

from typing import Any

import numpy as np

from mbd_ros.core.integration.tableau import Tableau
from mbd_ros.core.memory import Memory, copied, recognised
from mbd_ros.core.state import Array, Mode, State


class Stages:
    """One step at work, in the chart of the configuration that it starts from.

        q(t) = q0 (+) dq(t),   dq' = chart.rate(dq, v),   v' = a(t, q, v, u)

    The acceleration at the end of a step is the first one of the next step, if the state and the
    command are still the same then.

    Source: Iserles, Munthe-Kaas, Nørsett, Zanna, Lie-group methods, Acta Numerica 9, 2000, 4.2.

    Args:
        system: The system.
        tableau: The method.
    """

    def __init__(self, system: Any, tableau: Tableau) -> None:
        self._chart, self._accelerate = system.chart, system.accelerator()
        self._a = np.zeros(int(system.nv))
        self._tableau, self._nv, self._end = tableau, int(system.nv), tableau.stages
        self._c = tableau.a.sum(axis=1).tolist()
        self._h, self._done = 0.0, 0
        self._x = self._after = State(0.0, np.zeros(0), np.zeros(0))
        self._u: Array | None = None
        self._held: bytes | None = None
        self._mode: Mode = ()
        self._allocate()

    def start(self, x: State, u: Array | None) -> None:
        """Begin a step at x: the first rate."""
        held = None if u is None else u.tobytes()
        is_known = self._done > self._end and x is self._after and held == self._held
        if held != self._held:  # by value, since a controller may reuse its array
            self._u, self._held = None if u is None else u.copy(), held
        if is_known:
            a = self._end_acceleration()
        else:
            a = self._a
            self._accelerate(x.t, x.q, x.v, self._u, a)
        self._begin(x, a)
        self._x, self._done = x, 1

    def step(self, x: State, u: Array | None, h: float, t: float) -> State:
        """`start` and `advance`."""
        self.start(x, u)
        return self.advance(h, t)

    def advance(self, h: float, t: float) -> State:
        """State after a step of length h [s] from the started one; t is its time [s]."""
        self._h, self._done = h, 1
        self._complete(self._end)
        self._after = State(t, *self._stage(self._end), mode=self._mode)
        return self._after

    def memory(self) -> Memory:
        """What the next step and the dense output of this one depend on."""
        kept = (self._h, self._done, self._x, self._after, self._u, self._held)
        return {"step": copied(kept), "rates": self._rates_kept()}

    def recall(self, memory: Memory, x: State) -> None:
        """Continue from a memory; x is the state from which the next step starts."""
        step = recognised(copied(memory["step"]), x)
        self._h, self._done, self._x, self._after, self._u, self._held = step
        self._put_rates(memory["rates"])

    def rename(self, after: State) -> None:
        """Take a state with the numbers of the last result for that result."""
        self._after = after

    def follow(self, accelerate: Any, mode: Mode) -> None:
        """Other accelerations for the next step, and the mode that its states have."""
        self._accelerate, self._mode = accelerate, mode
        self.forget()

    def forget(self) -> None:
        """Nothing of this step may serve the next one."""
        self._done = 0

    def errors(self) -> Array:
        """Error estimates of [dq; v] over the last `advance`, shape (m, 2 nv)."""
        count = self._tableau.errors.shape[1]
        self._complete(count)
        errors: Array = self._h * self._tableau.errors.dot(self._flat_rates[:count])
        return errors

    def at(self, t: float) -> State:
        """State inside the last step, by the dense output."""
        if t == self._after.t:
            return self._after
        self._complete(len(self._c))
        weights = self._tableau.weights((t - self._x.t) / self._h)
        return State(t, *self._blend(weights), mode=self._mode)

    @property
    def first(self) -> Array:
        """Acceleration at the started state, shape (nv,); changes with the next step."""
        a: Array = self._rates[0, 1]
        return a

    @property
    def before(self) -> State:
        """State that the last step started from."""
        return self._x

    @property
    def span(self) -> tuple[float, float]:
        """Times at the start and at the end of the last step [s]."""
        return self._x.t, self._after.t

    def _allocate(self) -> None:
        self._rates: Array = np.zeros((len(self._c), 2, self._nv))
        self._flat_rates = self._rates.reshape(len(self._c), -1)

    def _rates_kept(self) -> Any:
        return self._rates.copy()

    def _put_rates(self, rates: Any) -> None:
        self._rates[...] = rates

    def _begin(self, x: State, a: Array) -> None:
        self._rates[0, 0], self._rates[0, 1] = x.v, a

    def _end_acceleration(self) -> Array:
        a: Array = self._rates[self._end, 1]
        return a

    def _stage(self, i: int) -> tuple[Array, Array]:
        """Configuration and velocity of a stage whose predecessors are known."""
        return self._blend(self._tableau.a[i, :i])

    def _blend(self, weights: Array) -> tuple[Array, Array]:
        dq, dv = (self._h * weights).dot(self._flat_rates[: len(weights)]).reshape(2, -1)
        return self._chart.integrate(self._x.q, dq), self._x.v + dv

    def _complete(self, count: int) -> None:
        """Evaluate the rates up to `count`, which may be beyond those of the step."""
        t0, h, v0 = self._x.t, self._h, self._x.v
        for i in range(self._done, count):
            dq, dv = (h * self._tableau.a[i, :i]).dot(self._flat_rates[:i]).reshape(2, -1)
            q, v = self._chart.integrate(self._x.q, dq), v0 + dv
            self._rates[i, 0] = self._chart.rate(dq, v)
            self._accelerate(t0 + h * self._c[i], q, v, self._u, self._rates[i, 1])
        self._done = max(self._done, count)
