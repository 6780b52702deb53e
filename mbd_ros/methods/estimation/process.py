"""What estimators are and know: a process, its sensors, what is believed of it.

    x_k+1 = f(x_k, u_k) (+) G w_k,   y_k = h(x_k) + n_k

Processes are mechanisms (`mechanism_process`) or matrices (`LinearProcess`). x is whatever the
process takes for a state; steps d of the tangent are vectors.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from mbd_ros.core.contracts import Measures, Now, Sensor
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.state import Array, Evaluation, State
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.estimation.kalman_update import Bools, Innovation, updated
from mbd_ros.methods.estimation.state_tangent import StateTangent
from mbd_ros.methods.inverse_dynamics.reactions import SystemReactions

_ASYMMETRY = 1.0e-12  # of a covariance, relative
_STEP = 1.0e-6  # of differences [m, rad and their rates]


class Process(Protocol):
    """A process in time.

    Attributes:
        n: Size of a step of its tangent.
        nw: Size of a disturbance.
        sizes: Steps of the tangent that count as one where it is linearised, inf where it is
            linear, shape (n,).
    """

    n: int
    nw: int
    sizes: Array

    def advance(self, x: Any, u: Array | None, t: float) -> Transition:
        """From a state to a later time [s], under inputs that are held."""

    def observe(self, x: Any, u: Array | None) -> Observation:
        """What all sensors should see."""

    def plus(self, x: Any, d: Array) -> Any:
        """The state x (+) d."""

    def minus(self, x1: Any, x0: Any) -> Array:
        """The d with x0 (+) d = x1, shape (n,)."""

    def near(self, x: Any, values: Array, P: Array) -> Any:
        """The state that fits a measurement, on the way from x; P says what goes easily."""

    def at_rest(self, x: Any, t: float) -> Any:
        """The configuration at another time [s], at rest: nobody knows how it came there."""

    def unforeseen(self, acceleration: float, dt: float) -> Array:
        """Variance that accelerations nobody foresees bring within a time [s], shape (n,)."""

    def turned(self, x0: Any, x1: Any) -> Array | None:
        """From steps at x0 to the same steps at a state beside it, (n, n); None for unity."""

    def bounded(self, x: Any) -> Bounded:
        """What has bounds at a state."""


class LinearProcess:
    """A process of matrices: x_k+1 = A x_k + B u_k + G w_k, y_k = C x_k + n_k.

    Args:
        A: Shape (n, n).
        C: Shape (m, n).
        Q: Covariance of w, shape (nw, nw).
        R: Covariance of the noise, shape (m, m).
        G: Shape (n, nw); unity by default.
        B: Shape (n, nu); no inputs by default.
        lower: Bounds of x, shape (n,), -inf without; none by default.
        upper: Bounds of x, shape (n,), inf without; none by default.

    Attributes:
        n: Size of x.
        nw: Size of w.
        sizes: Inf: it is linear.

    Raises:
        ModelError: Shapes that do not fit, or a covariance that is none; names the matrix.
    """

    def __init__(
        self,
        A: Array,
        C: Array,
        Q: Array,
        R: Array,
        G: Array | None = None,
        B: Array | None = None,
        lower: Array | None = None,
        upper: Array | None = None,
    ) -> None:
        self.A, self.C, self.Q, self.R = (
            np.atleast_2d(np.asarray(M, float)) for M in (A, C, Q, R)
        )
        self.n = len(self.A)
        self.G = np.eye(self.n) if G is None else np.asarray(G, float).reshape(self.n, -1)
        self.B = None if B is None else np.asarray(B, float).reshape(self.n, -1)
        self.nw, self.sizes = self.G.shape[1], np.full(self.n, np.inf)
        shapes = {
            "A": (self.A, (self.n, self.n)),
            "C": (self.C, (len(self.C), self.n)),
            "Q": (self.Q, (self.nw, self.nw)),
            "R": (self.R, (len(self.C), len(self.C))),
        }
        for name, (matrix, shape) in shapes.items():
            if matrix.shape != shape:
                raise ModelError(f"{name} has shape {matrix.shape}, accepted: {shape}")
        for name in ("Q", "R"):
            refuse_no_covariance(name, shapes[name][0])
        none = np.full(self.n, np.inf)
        low = -none if lower is None else np.asarray(lower, float)
        high = none if upper is None else np.asarray(upper, float)
        self._has_bound = np.isfinite(low) | np.isfinite(high)
        self._selected = np.eye(self.n)[self._has_bound]
        self._bounds = low[self._has_bound], high[self._has_bound]

    def advance(self, x: Array, u: Array | None, t: float) -> Transition:
        """As `Process.advance`; the interval is the one that the matrices were made for."""
        after = self.A.dot(x)
        if self.B is not None and u is not None:
            after += self.B.dot(u)
        return Transition(after, self.A, self.G, self.Q)

    def observe(self, x: Array, u: Array | None) -> Observation:
        """As `Process.observe`."""
        return Observation(self.C.dot(x), self.C, self.R)

    def plus(self, x: Array, d: Array) -> Array:
        """As `Process.plus`."""
        return x + d

    def minus(self, x1: Array, x0: Array) -> Array:
        """As `Process.minus`."""
        return x1 - x0

    def near(self, x: Array, values: Array, P: Array) -> Array:
        """As `Process.near`."""
        return x + updated(P, self.C, self.R, values - self.C.dot(x)).step

    def at_rest(self, x: Array, t: float) -> Array:
        """As `Process.at_rest`."""
        return x

    def unforeseen(self, acceleration: float, dt: float) -> Array:
        """As `Process.unforeseen`: nobody says what an acceleration is here."""
        return np.zeros(self.n)

    def turned(self, x0: Array, x1: Array) -> None:
        """As `Process.turned`: the same everywhere."""

    def bounded(self, x: Array) -> Bounded:
        """As `Process.bounded`."""
        return Bounded(x[self._has_bound], self._selected, *self._bounds)


def refuse_no_covariance(name: str, matrix: Array) -> None:
    """Refuse what is no covariance.

    Raises:
        ModelError: Names the matrix and the condition.
    """
    if not np.isfinite(matrix).all():
        raise ModelError(f"{name} is not finite")
    size = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > _ASYMMETRY * size:
        raise ModelError(f"{name} is not symmetric")
    if len(matrix) and np.linalg.eigvalsh(matrix)[0] < -_ASYMMETRY * size:
        raise ModelError(f"{name} is not positive semidefinite")


class Transition(NamedTuple):
    """One interval of a process.

    Attributes:
        x: State at its end, without disturbance.
        F: Derivative of it by the state at the start, shape (n, n), both in their tangents.
        G: Derivative of it by the disturbance w, shape (n, nw).
        Q: Covariance of w, shape (nw, nw).
    """

    x: Any
    F: Array
    G: Array
    Q: Array

    @property
    def noise(self) -> Array:
        """Covariance that the interval adds, shape (n, n)."""
        return self.G.dot(self.Q).dot(self.G.T)


class Observation(NamedTuple):
    """What should be measured at a state.

    Attributes:
        y: Without noise, shape (m,).
        H: Derivative by a step of the tangent, shape (m, n).
        R: Covariance of the noise, shape (m, m).
    """

    y: Array
    H: Array
    R: Array


class Bounded(NamedTuple):
    """What has bounds at a state.

    Attributes:
        values: Shape (b,).
        by: Derivative by a step of the tangent, shape (b, n).
        lower: Smallest accepted values, shape (b,).
        upper: Largest accepted values, shape (b,).
        may_be_wrong: Which bounds give way to measurements that contradict them beyond doubt,
            shape (b,); None for none.
    """

    values: Array
    by: Array
    lower: Array
    upper: Array
    may_be_wrong: Bools | None = None


class Estimator:
    """Follows a process by measurements: `begin`, then `predict` and `correct` in turn.

    Attributes:
        belief: The newest one.
        is_late: Whether there is no time for more than the least; who asks sets it.
    """

    belief: Belief
    is_late: bool = False

    def __init__(self, process: Process) -> None:
        self.process = process

    def begin(self, x: Any, P: Array, t: float = 0.0) -> Belief:
        """Begin with a prior.

        Args:
            x: State of the process.
            P: Its covariance, shape (n, n).
            t: Time [s].

        Raises:
            ModelError: P is no covariance of that size.
        """
        n = self.process.n
        if np.shape(P) != (n, n):
            raise ModelError(f"P has shape {np.shape(P)}, accepted: {(n, n)}")
        refuse_no_covariance("P", np.asarray(P))
        self.belief = Belief(t, x, np.array(P, dtype=np.float64))
        return self.belief

    def predict(self, u: Array | None, t: float) -> Belief:
        """Go to a later time [s] under inputs that were held since the last one, (nu,) or None."""
        raise NotImplementedError

    def correct(self, measurement: Measurement, seen: Observation | None = None) -> Belief:
        """Take what was measured at the time of the newest belief.

        Args:
            measurement: What was measured.
            seen: What should be seen there, where that is known already.
        """
        raise NotImplementedError

    def checkpoint(self) -> Any:
        """All that later answers depend on, as a value for `restore`."""
        return self.belief

    def restore(self, checkpoint: Any) -> None:
        """Go back to a checkpoint."""
        self.belief = checkpoint


class Belief(NamedTuple):
    """What an estimator believes.

    Attributes:
        t: Time [s].
        x: State of the process.
        P: Covariance of the step of its tangent from x to the true state, shape (n, n).
        innovation: Of the newest measurement; None before the first one.
        is_trusted: Whether the estimator stands by it; why not is in `remark`.
        remark: Empty while it is trusted.
    """

    t: float
    x: Any
    P: Array
    innovation: Innovation | None = None
    is_trusted: bool = True
    remark: str = ""


class Measurement(NamedTuple):
    """What sensors said at one time.

    Attributes:
        t: Time [s].
        values: Of all sensors of the process, NaN where nothing came, shape (m,).
        used: Which of them count, shape (m,); None for all that are finite.
    """

    t: float
    values: Array
    used: Bools | None = None


class SensorSet:
    """Sensors of a mechanism, one below the other.

    Args:
        evaluate: As that of the system, which it is by default; what depends on accelerations
            asks it.

    Attributes:
        m: Numbers in all.
        slices: Where each stands.
        names: `<sensor>`, or `<sensor>.<component>`, in the same order.
    """

    def __init__(
        self,
        sensors: Sequence[Sensor],
        system: System,
        evaluate: Callable[[State, Array | None], Evaluation] | None = None,
    ) -> None:
        self.sensors, self._system = tuple(sensors), system
        self._evaluate = system.evaluate if evaluate is None else evaluate
        ends = np.cumsum([0, *(len(sensor.components) for sensor in sensors)]).tolist()
        self.m = ends[-1]
        self.slices = [slice(a, b) for a, b in itertools.pairwise(ends)]
        self.names = tuple(
            ".".join(filter(None, (sensor.name, one)))
            for sensor in sensors
            for one in sensor.components
        )
        self._reads = max((_asked(sensor) for sensor in sensors), default=Reads.NOTHING)
        self._needs_forces = any(s.level >= Measures.ACCELERATION for s in sensors)
        feels = any(s.level >= Measures.FORCE for s in sensors)
        self._felt = SystemReactions(system) if feels else None
        self._noise_varies = any(s.noise_varies for s in sensors)
        self._R: Array | None = None
        nv = int(system.robot.model.nv)
        self._by_q, self._by_v = np.zeros((2, self.m, nv))
        each = zip(self.sensors, self.slices, strict=True)
        self._turning = [(s, mine) for s, mine in each if not s.is_linear]
        self._is_filled, nz = False, system.internals.nz
        self._same: Array | None = None  # the derivative, where it is the same everywhere
        self._by_z, self._is_offset = np.zeros((self.m, nz)), False
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            slope = sensor.by_internal(nz)
            if slope is not None:
                self._by_z[mine], self._is_offset = slope, True
        each = zip(self.sensors, self.slices, strict=True)
        self._winding = [(s, mine) for s, mine in each if type(s).near is not Sensor.near]

    def near(self, values: Array, expected: Array) -> Array:
        """What was measured, written as near to what is expected as it can be, shape (m,)."""
        if not self._winding:
            return values
        found = values.copy()
        for sensor, mine in self._winding:
            found[mine] = sensor.near(values[mine], expected[mine])
        return found

    def values(self, y: State, u: Array | None) -> Array:
        """What they should see, shape (m,)."""
        return self._measured(y, u)[1]

    def covariance(self, y: State) -> Array:
        """Of the noise, shape (m, m), not to be written to.

        Raises:
            ModelError: A sensor without noise; names it.
            SolveError: A state at which it is not finite.
        """
        if self._R is not None and not self._noise_varies:
            return self._R
        x, k = self._system.expand(y), self._system.k
        k.refresh(x.q, x.v, self._reads)
        R = np.zeros((self.m, self.m))
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            R[mine, mine] = sensor.covariance(k, x)
            if not np.isfinite(R[mine, mine]).all():
                raise SolveError(f"sensor {sensor.name}: the estimated state is not finite")
            if not (R[mine, mine].diagonal() > 0.0).all():
                raise ModelError(
                    f"sensor {sensor.name}: an estimator needs its noise, accepted: > 0"
                )
        self._R = R
        return R

    def observe(self, y: State, u: Array | None, tangent: StateTangent) -> Observation:
        """What they should see, and its derivative by steps of the tangent."""
        R = self.covariance(y)
        x, here = self._measured(y, u)
        if self._same is not None:
            return Observation(here, self._same, R)
        if not self._is_filled:
            self._fill(x)
        k, differ = self._system.k, list[int]()
        for sensor, mine in self._turning:
            if sensor.level is Measures.POSITION:
                self._by_q[mine] = sensor.jacobian(k, x)
                continue
            by_q = sensor.by_position(k, x) if sensor.level is Measures.VELOCITY else None
            if by_q is None:
                differ.extend(range(mine.start, mine.stop))
            else:
                self._by_q[mine], self._by_v[mine] = by_q, sensor.jacobian(k, x)
        nv, lift = self._by_q.shape[1], tangent.of_all_joints(y)
        H = self._by_q.dot(lift[:nv]) + self._by_v.dot(lift[nv:])
        if self._is_offset:
            H[:, tangent.n - self._by_z.shape[1] :] += self._by_z
        if differ:
            H[differ] = self._differences(y, u, here, tangent)[differ]
        if tangent.is_whole and tangent.n == 2 * nv + self._by_z.shape[1] and not self._turning:
            self._same = H
        return Observation(here, H, R)

    def _fill(self, x: State) -> None:
        """The rows that never change."""
        self._is_filled = True
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            if sensor.is_linear and sensor.level is Measures.POSITION:
                self._by_q[mine] = sensor.jacobian(self._system.k, x)
            elif sensor.is_linear:
                by_q = sensor.by_position(self._system.k, x)
                self._by_q[mine] = 0.0 if by_q is None else by_q
                self._by_v[mine] = sensor.jacobian(self._system.k, x)

    def _differences(self, y: State, u: Array | None, here: Array, tangent: StateTangent) -> Array:
        found, step = np.zeros((self.m, tangent.n)), np.zeros(tangent.n)
        for i in range(tangent.n):
            step[i] = _STEP
            found[:, i] = (self.values(tangent.plus(y, step), u) - here) / _STEP
            step[i] = 0.0
        return found

    def _measured(self, y: State, u: Array | None) -> tuple[State, Array]:
        """State of all joints, and what the sensors should see there."""
        system, now = self._system, None
        x, k = system.expand(y), system.k
        if self._needs_forces:
            found = self._evaluate(x, u)
            felt = self._felt
            reactions = None if felt is None else felt.at(x, u, found.a, found.lam)
            now = Now(found.a, found.lam, reactions)
        k.refresh(x.q, x.v, self._reads)
        every = [np.asarray(s.measure(k, x, now), dtype=np.float64) for s in self.sensors]
        return x, np.concatenate([np.zeros(0), *every])


def _asked(sensor: Sensor) -> Reads:
    """What a sensor and its Jacobian read of k."""
    return Reads(max(sensor.reads, Reads.JACOBIAN)) if sensor.reads else Reads.NOTHING


def moved(process: Process, P: Array, x0: Any, x1: Any) -> Array:
    """A covariance in the tangent of x1 that was found in that of a state x0 beside it."""
    turn = process.turned(x0, x1)
    return P if turn is None else turn.dot(P).dot(turn.T)
