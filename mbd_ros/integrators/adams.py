"""Explicit Adams methods."""

import math
from itertools import cycle, islice
from typing import Any

import numpy as np

from mbd_ros.core.integration.dop853_tableau import DOP853
from mbd_ros.core.integration.linear_motion import LinearMotion, spectral_radius
from mbd_ros.core.integration.nystrom_stages import new_state
from mbd_ros.core.integration.runge_kutta import RungeKutta
from mbd_ros.core.integration.step_length import NEAR, clip
from mbd_ros.core.integration.stepping import Integrator, Stepper
from mbd_ros.core.integration.tableau import RK4
from mbd_ros.core.memory import Memory
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError

_ORDERS = range(2, 9)
_STABLE = (0.25, 0.25, 0.15, 0.08, 0.043, 0.023, 0.012)  # rate * dt of each order
_LAST = 1.0e-6  # of dt: a step that ends this near to `end` must end there


class Adams(Integrator):
    """Adams-Bashforth: one evaluation a step, from the polynomial through the last accelerations.

        v+ = v + h sum_j b_j a_(n-j),   q+ = q + h v + h^2 sum_j d_j a_(n-j)

    Runge-Kutta steps start it, at first and after every discontinuity, a new command included:
    it pays on smooth stretches. It refuses floating bases. With decay rates or frequencies r [1/s]
    it is stable for r dt up to about 0.15 at order 4 and 0.043 at order 6, where critical
    damping is the worst case; undamped vibrations grow slowly from order 5 on. Hence 4 is the
    default; orders 6 to 8 are for accuracy at small dt.

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, III.1; III.10
    for the position (Störmer).

    Args:
        order: 2 .. 8.
    """

    example = {"order": 4}

    def __init__(self, *, order: int = 4) -> None:
        if order not in _ORDERS:
            raise ModelError(f"order {order} is outside {_ORDERS[0]} .. {_ORDERS[-1]}")
        self.order, self.stable = order, _STABLE[order - _ORDERS[0]]

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Factor by which a step multiplies a linear motion at most, the history included."""
        n, k = len(motion.stiffness), self.order
        unit, position, velocity = np.eye(n), *_weights(k, dt)
        now = np.hstack([motion.stiffness, motion.damping, np.zeros((n, n * (k - 1)))])
        kept = np.eye(n * (k + 1))  # [q, v, older accelerations, newest of them first]
        accelerations = np.vstack([now, kept[2 * n :]])
        after = np.vstack([kept[: 2 * n], accelerations[: n * (k - 1)]])
        after[:n] += dt * kept[n : 2 * n] + np.kron(position, unit).dot(accelerations)
        after[n : 2 * n] += np.kron(velocity, unit).dot(accelerations)
        return spectral_radius(after)

    def prepare(self, system: Any, dt: float) -> "AdamsStepper":
        """The stepper for one system and one step size [s].

        Raises:
            ModelError: The base floats.
        """
        if not system.chart.is_flat:
            raise ModelError("adams takes no floating base, use rk4, dopri5 or dop853")
        return AdamsStepper(system, self.order, dt)


class AdamsStepper(Stepper):
    """Adams-Bashforth steps.

    With B = [q; v; a; ..] a step is one product. The accelerations keep their rows and the oldest
    is overwritten, so there is one matrix for every place that the newest may have. [q; v] stands
    before or after them in turn: a step reads the one and writes the other.

    Args:
        system: The system; its configurations are a vector space.
        order: How many accelerations a step uses.
        dt: Length of a step [s].
    """

    kept = ("_known", "_last", "_ready", "_held")

    def __init__(self, system: Any, order: int, dt: float) -> None:
        self._accelerate, self._needed = system.accelerator(), order - 1
        self._dt, self._near = dt, NEAR * dt
        # Errors of the first steps do not add up: one order less than that of the method will do.
        self._starter = RungeKutta(system, RK4 if order <= 5 else DOP853, dt)
        self._B, self._turns = _slots(order, int(system.nv), dt)
        self._slots = cycle(self._turns)
        self._row: Array | None = None  # of the newest acceleration
        self._known = 0
        self._last: State | None = None  # what the last step returned while the method starts
        self._ready: State | None = None  # the same, once there are enough accelerations
        self._head = np.zeros((2, int(system.nv)))  # [q; v] from which the next step starts
        self._held: bytes | None = None

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        t, q, v, _, _ = x
        held = None if u is None else u.tobytes()
        if x is not self._ready or held != self._held or t + self._near > end:
            return self._slow_step(x, u, end, held)
        row, product, before, after, after_q, after_v = next(self._slots)
        self._accelerate(t, q, v, u, row)
        product(before, after)
        self._head, self._row = after, row
        t += self._dt
        self._ready = x = new_state(State, (t, after_q.copy(), after_v.copy(), NONE, ()))
        return x

    def stride(self, x: State, u: Array | None, end: float, most: int) -> tuple[State, int]:
        """Advance by several full steps, without the states in between.

        Args:
            x: As for `step`.
            u: As for `step`.
            end: As for `step`.
            most: How many steps are taken at most.

        Returns:
            The last state, and how many steps were taken.
        """
        t, q, v, _, _ = x
        count = min(most, int((end - t) / self._dt - _LAST))
        held = None if u is None else u.tobytes()
        if x is not self._ready or held != self._held or count < 1:
            return self.step(x, u, end), 1
        accelerate, dt = self._accelerate, self._dt
        for row, product, before, after, after_q, after_v in islice(self._slots, count):
            accelerate(t, q, v, u, row)
            product(before, after)
            t, q, v = t + dt, after_q, after_v
        self._head, self._row = after, row
        self._ready = x = State(t, q.copy(), v.copy())
        return x, count

    def restart(self) -> None:
        """Forget the accelerations of earlier steps."""
        self._known, self._last, self._ready, self._held = 0, None, None, None
        self._starter.restart()

    def memory(self) -> Memory:
        """Accelerations of earlier steps, and where the next one stands among them."""
        heads = ((row, head) for row, _, _, head, _, _ in self._turns)
        turns = [row is self._row and head is self._head for row, head in heads]
        done = 1 + turns.index(True) if True in turns else 0
        rows = self._B.copy(), done
        return {**super().memory(), "rows": rows, "starter": self._starter.memory()}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        super().recall({name: memory[name] for name in self.kept}, x)
        self._starter.recall(memory["starter"], x)
        self._B[...], done = memory["rows"]
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

    def _slow_step(self, x: State, u: Array | None, end: float, held: bytes | None) -> State:
        """A step that starts the method, or that ends at `end`."""
        h, t = clip(x.t, self._dt, end)
        if h <= 0.0:
            return x
        # Commands count by value, since a controller may reuse its array.
        is_new = held != self._held or (x is not self._ready and x is not self._last)
        if h == self._dt and not is_new and x is self._ready:
            self._ready = after = self.step(x, u)._replace(t=t)
            return after
        if is_new or h != self._dt:
            self.restart()
            self._held = held
        after = self._starter.step(x, u, end)
        if h == self._dt:
            self._keep(after)
        return after

    def _keep(self, after: State) -> None:
        """Take over the result of a starting step."""
        row, _, _, head, _, _ = next(self._slots)
        row[...] = self._starter.stages.first
        self._row, self._head = row, head
        self._known += 1
        self._last = after
        if self._known >= self._needed:
            head[0], head[1] = after.q, after.v
            self._last, self._ready = None, after


def _slots(order: int, nv: int, dt: float) -> tuple[Array, list[tuple[Any, ...]]]:
    """What the steps need in turn, until everything is back in place.

    Returns:
        B with both places of [q; v]. For each turn: row of the newest acceleration, product with
        the matrix of the step, B as it reads it, [q; v] that it writes, these two.
    """
    B, ages = np.zeros((4 + order, nv)), np.arange(order)
    position, velocity = _weights(order, dt)
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


def _weights(order: int, dt: float) -> tuple[Array, Array]:
    """Weights of the accelerations by age in the changes of q and v.

    Integrals of the Lagrange polynomials over the step.
    """
    ages = np.arange(order)
    position, velocity = np.zeros(order), np.zeros(order)
    for age in ages:
        basis = np.poly(-np.delete(ages, age))
        basis = basis / np.polyval(basis, -age)
        velocity[age] = dt * np.polyval(np.polyint(basis), 1.0)
        position[age] = dt * dt * np.polyval(np.polyint(basis, 2), 1.0)
    return position, velocity
