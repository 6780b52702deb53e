"""Explicit Adams methods: steps, and the weights of the accelerations in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import cycle, islice
from typing import Any

import numpy as np

from mbd_ros.core.state import NONE, Array, Memory, Mode, State, have_same_bits
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.runge_kutta import RK4, RungeKutta, Tableau
from mbd_ros.methods.integration.stepping import NEAR, Stepper, clip

_new_state = tuple.__new__  # half the time of the constructor of a NamedTuple
_LAST = 1.0e-6  # of dt: a step that ends this near to `end` must end there


class AdamsSteps(Stepper):
    """Adams-Bashforth steps.

    With B = [q; v; a; ..] a step is one product. The accelerations keep their rows and the oldest
    is overwritten, so there is one matrix for every place that the newest may have. [q; v] stands
    before or after them in turn: a step reads the one and writes the other.

    Inside a step the state follows from the polynomial of the method. A step that is taken again
    is one of the starter.

    Args:
        system: The system; its configurations are a vector space.
        order: How many accelerations a step uses.
        dt: Length of a step [s].
    """

    can_stride = True
    checkpoint_fields = ("_known", "_last", "_ready", "_u", "_start")

    def __init__(self, system: Any, order: int, dt: float) -> None:
        self._accelerate, self._needed = system.accelerator(), order - 1
        self._dt, self._near = dt, NEAR * dt
        self._starter = RungeKutta(system, starter(order), dt)
        self._B, self._turns = turns(order, int(system.nv), dt)
        self._slots = cycle(self._turns)
        self._ages = np.arange(order, dtype=np.float64)
        self._row: Array | None = None  # of the newest acceleration
        self._known = 0
        self._last: State | None = None  # what the last step returned while the method starts
        self._ready: State | None = None  # the same, once there are enough accelerations
        self._head = np.zeros((2, int(system.nv)))  # [q; v] from which the next step starts
        self._u: Array | None = None  # commands of the last step
        self._start: State | None = None  # where the last step began
        self._mode: Mode = ()

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        t, q, v, _, _ = x
        if x is not self._ready or t + self._near > end or not have_same_bits(u, self._u):
            return self._slow_step(x, u, end)
        row, product, before, after, after_q, after_v = next(self._slots)
        self._accelerate(t, q, v, u, row)
        product(before, after)
        self._head, self._row, self._start = after, row, x
        after_x = (t + self._dt, after_q.copy(), after_v.copy(), NONE, self._mode)
        self._ready = x = _new_state(State, after_x)
        return x

    def stride(
        self,
        x: State,
        u: Array | None,
        end: float,
        most: int,
        watch: Callable[[Array], bool] | None = None,
    ) -> tuple[State, int]:
        """Advance by several full steps, without the states in between."""
        t, q, v, _, _ = x
        count = min(most, int((end - t) / self._dt - _LAST))
        if x is not self._ready or count < 1 or not have_same_bits(u, self._u):
            after_x = self.step(x, u, end)
            if watch is not None:
                watch(after_x.v)
            return after_x, 1
        accelerate, dt = self._accelerate, self._dt
        self._start = None
        for row, product, before, after, after_q, after_v in islice(self._slots, count):
            accelerate(t, q, v, u, row)
            product(before, after)
            t, q, v = t + dt, after_q, after_v
            if watch is not None and watch(v):
                count = round((t - x.t) / dt)
                break
        self._head, self._row = after, row
        self._ready = x = _new_state(State, (t, q.copy(), v.copy(), NONE, self._mode))
        return x, count

    def restart(self) -> None:
        """Forget the accelerations of earlier steps."""
        self._known, self._last, self._ready, self._u = 0, None, None, None
        self._starter.restart()

    def again(self, h: float, t: float) -> State:
        """Take the last step again by the starter; the method restarts after it."""
        start, starter = self.began(), self._starter
        self._known, self._last, self._ready = 0, None, None
        if starter.before is not start:
            starter.restart()
            starter.start(start, self._u)
        return starter.again(h, t)

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations from the next step on."""
        self._accelerate, self._mode = accelerate, mode
        self._starter.follow(accelerate, mode)
        self.restart()

    def interpolate(self, t: float) -> State:
        """Return the state inside the last step, of the order of the method.

        Raises:
            ModelError: t [s] is outside the last step.
        """
        start = self.began()
        if self._starter.before is start:
            return self._starter.interpolate(t)
        after, dt = self._ready, self._dt
        if after is None or not start.t - _LAST * dt <= t <= after.t + _LAST * dt:
            raise ModelError(f"t = {t:.9g} s is outside the last step, from {start.t:.9g} s")
        if t == after.t:
            return after
        theta = (t - start.t) / dt
        once, twice = integrals(-self._ages, theta)
        a = self._accelerations()
        q = start.q + theta * dt * start.v + dt * dt * twice.dot(a)
        return State(t, q, start.v + dt * once.dot(a), mode=self._mode)

    def checkpoint(self) -> Memory:
        """Return accelerations of earlier steps, and where the next one stands among them."""
        rows = self._B.copy(), self._done()
        return {**super().checkpoint(), "rows": rows, "starter": self._starter.checkpoint()}

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Go on as after the step at which a checkpoint was taken, with the same bits."""
        super().restore({name: checkpoint[name] for name in self.checkpoint_fields}, x)
        self._starter.restore(checkpoint["starter"], x)
        self._B[...], done = checkpoint["rows"]
        self._slots = cycle(self._turns)
        for row, _, _, head, _, _ in islice(self._slots, done):
            self._row, self._head = row, head

    def continue_from(self, x: State) -> None:
        """Continue from the stabilized last state, history kept."""
        if self._ready is not None:
            self._head[0], self._head[1] = x.q, x.v
            self._ready = x
        elif self._last is not None:
            self._last = x

    def _done(self) -> int:
        """Return how many of the turns lie behind, 0 before the first one."""
        heads = ((row, head) for row, _, _, head, _, _ in self._turns)
        turns = [row is self._row and head is self._head for row, head in heads]
        return 1 + turns.index(True) if True in turns else 0

    def began(self) -> State:
        """Return the state from which the last step began, one of several at once too.

        Raises:
            ModelError: No step was taken.
        """
        if self._start is None:
            after, done = self._ready, self._done()
            if after is None or not done:
                raise ModelError("no step was taken yet")
            q, v = self._B[:2] if done % 2 else self._B[-2:]
            self._start = State(after.t - self._dt, q.copy(), v.copy(), mode=self._mode)
        return self._start

    def _accelerations(self) -> Array:
        """Return those of the last step, the newest first, shape (order, nv)."""
        last = self._done() - 1
        rows: Array = np.array([self._turns[last - age][0] for age in range(len(self._ages))])
        return rows

    def _slow_step(self, x: State, u: Array | None, end: float) -> State:
        """Return a step that starts the method, or that ends at `end`."""
        h, t = clip(x.t, self._dt, end)
        if h <= 0.0:
            return x
        # Commands count by value, since a controller may reuse its array.
        is_new = not have_same_bits(u, self._u) or (x is not self._ready and x is not self._last)
        if h == self._dt and not is_new and x is self._ready:
            self._ready = after = self.step(x, u)._replace(t=t)
            return after
        if is_new or h != self._dt:
            self.restart()
            self._u = None if u is None else u.copy()
        self._start, after = x, self._starter.step(x, u, end)
        if h == self._dt:
            self._keep(after)
        return after

    def _keep(self, after: State) -> None:
        """Take over the result of a starting step."""
        row, _, _, head, _, _ = next(self._slots)
        row[...] = self._starter.first
        self._row, self._head = row, head
        self._known += 1
        self._last = after
        if self._known >= self._needed:
            head[0], head[1] = after.q, after.v
            self._last, self._ready = None, after


def adams_weights(order: int, dt: float) -> tuple[Array, Array]:
    """Return weights of the accelerations by age in the changes of q and v.

    Integrals of the Lagrange polynomials over the step.
    """
    velocity, position = integrals(-np.arange(order, dtype=np.float64), 1.0)
    return dt * dt * position, dt * velocity


def starter(order: int) -> Tableau:
    """Return the Runge-Kutta method that takes the first steps.

    Errors of the first steps do not add up: one order less than that of the method will do.
    """
    return RK4 if order <= 5 else DOP853


def turns(order: int, nv: int, dt: float) -> tuple[Array, list[tuple[Any, ...]]]:
    """Return what the steps need in turn, until everything is back in place.

    Returns:
        B with both places of [q; v]. For each turn: row of the newest acceleration, product with
        the matrix of the step, B as it reads it, [q; v] that it writes, these two.
    """
    B, ages = np.zeros((4 + order, nv)), np.arange(order)
    position, velocity = adams_weights(order, dt)
    slots = []
    for step in range(2 * order):
        newest, is_even = step % order, step % 2 == 0
        age = (newest - ages) % order
        parts = [np.array([[1.0, dt], [0.0, 1.0]]), np.array([position[age], velocity[age]])]
        before, after = (B[:-2], B[-2:]) if is_even else (B[2:], B[:2])
        matrix = np.ascontiguousarray(np.hstack(parts if is_even else parts[::-1]))
        row, (q, v) = B[2 + newest], after
        slots.append((row, matrix.dot, before, after, q, v))
    return B, slots


def integrals(places: Sequence[float] | Array, theta: float) -> tuple[Array, Array]:
    """Weights of values f_i in the integrals of the polynomial through them, from 0 to theta.

        int_0^theta f = sum_i once[i] f_i,   int_0^theta int_0^s f = sum_i twice[i] f_i

    Args:
        places: Where the values are, all different, shape (n,).
        theta: Where the integrals end.

    Returns:
        once and twice, shape (n,) each.
    """
    bases = _bases(places)
    once = np.array([np.polyval(np.polyint(basis), theta) for basis in bases])
    twice = np.array([np.polyval(np.polyint(basis, 2), theta) for basis in bases])
    return once, twice


def _bases(places: Sequence[float] | Array) -> list[Array]:
    """Return the polynomials that are 1 at one place and 0 at the others, highest power first."""
    bases = []
    for i, place in enumerate(places):
        basis = np.atleast_1d(np.poly(np.delete(places, i)))
        bases.append(basis / np.polyval(basis, place))
    return bases


def powers(places: Sequence[float] | Array) -> tuple[Array, Array]:
    """Return the same weights as polynomials of theta.

        once[i] = sum_k first[i, k] theta^(k + 1),   twice[i] = sum_k second[i, k] theta^(k + 2)

    Args:
        places: Where the values are, all different, shape (n,).

    Returns:
        first and second, shape (n, n) each.
    """
    bases = _bases(places)
    first = np.array([np.polyint(basis)[-2::-1] for basis in bases])
    second = np.array([np.polyint(basis, 2)[-3::-1] for basis in bases])
    return first, second
