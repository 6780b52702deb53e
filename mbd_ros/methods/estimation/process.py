"""Contracts of estimation: processes, their sensors, estimators and beliefs.

    x_k+1 = f(x_k, u_k) (+) G w_k,   y_k = h(x_k) + n_k

A process is a mechanism (`features.estimation.mechanism_process`) or a set of matrices
(`LinearProcess`). A state x can be of any type that its process defines; tangent steps d are
vectors.
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
from mbd_ros.methods.estimation.kalman_update import Bools, Innovation, compute_update
from mbd_ros.methods.estimation.state_tangent import StateTangent
from mbd_ros.methods.inverse_dynamics.reactions import SystemReactions

_ASYMMETRY = 1.0e-12  # accepted asymmetry of a covariance, relative to its largest entry
_STEP = 1.0e-6  # for finite differences [m, rad and their rates]


class Process(Protocol):
    """Discrete-time process with disturbances and measurements.

    Attributes:
        n: Dimension of a tangent step.
        nw: Dimension of a disturbance.
        sizes: Tangent steps beyond which a linearisation is no longer accurate, inf where the
            process is linear, shape (n,).
    """

    n: int
    nw: int
    sizes: Array

    def advance(self, x: Any, u: Array | None, t: float) -> Transition:
        """Advance a state to a later time [s] under constant inputs."""

    def observe(self, x: Any, u: Array | None) -> Observation:
        """Return the expected values of all sensors at a state."""

    def plus(self, x: Any, d: Array) -> Any:
        """Return the state x (+) d."""

    def minus(self, x1: Any, x0: Any) -> Array:
        """Return the step d with x0 (+) d = x1, shape (n,)."""

    def fit_state(self, x: Any, values: Array, P: Array) -> Any:
        """Return the state nearest to x, in the metric P^-1, that fits measured values."""

    def at_rest(self, x: Any, t: float) -> Any:
        """Return the configuration of a state at another time [s], with zero velocities."""

    def unmodelled_variance(self, acceleration: float, dt: float) -> Array:
        """Return the variance that unknown accelerations cause within a time [s], shape (n,)."""

    def transport(self, x0: Any, x1: Any) -> Array | None:
        """Return the matrix from steps at x0 to steps at x1 nearby, (n, n); None for identity."""

    def bounds(self, x: Any) -> StateBounds:
        """Return the bounded quantities at a state."""


class LinearProcess:
    """Linear process x_k+1 = A x_k + B u_k + G w_k with measurements y_k = C x_k + n_k.

    Args:
        A: State matrix, shape (n, n).
        C: Measurement matrix, shape (m, n).
        Q: Covariance of the disturbance w, shape (nw, nw).
        R: Covariance of the measurement noise, shape (m, m).
        G: Disturbance matrix, shape (n, nw); identity by default.
        B: Input matrix, shape (n, nu); no inputs by default.
        lower: Lower bounds of x, -inf for none, shape (n,); unbounded by default.
        upper: Upper bounds of x, inf for none, shape (n,); unbounded by default.

    Raises:
        ModelError: Shapes do not fit, or Q or R is not a covariance.
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
        self.nw = self.G.shape[1]
        self.sizes = np.full(self.n, np.inf)  # the process is linear
        shapes = {
            "A": (self.A, (self.n, self.n)),
            "C": (self.C, (len(self.C), self.n)),
            "Q": (self.Q, (self.nw, self.nw)),
            "R": (self.R, (len(self.C), len(self.C))),
        }
        for name, (matrix, shape) in shapes.items():
            if matrix.shape != shape:
                raise ModelError(f"{name} has shape {matrix.shape}, but must have shape {shape}")
        for name in ("Q", "R"):
            check_covariance(name, shapes[name][0])
        none = np.full(self.n, np.inf)
        low = -none if lower is None else np.asarray(lower, float)
        high = none if upper is None else np.asarray(upper, float)
        self._has_bound = np.isfinite(low) | np.isfinite(high)
        self._selected = np.eye(self.n)[self._has_bound]
        self._bounds = low[self._has_bound], high[self._has_bound]

    def advance(self, x: Array, u: Array | None, t: float) -> Transition:
        """Return A x + B u; t is ignored, since the matrices belong to a fixed interval."""
        after = self.A.dot(x)
        if self.B is not None and u is not None:
            after += self.B.dot(u)
        return Transition(after, self.A, self.G, self.Q)

    def observe(self, x: Array, u: Array | None) -> Observation:
        """Return C x with its derivative and the noise."""
        return Observation(self.C.dot(x), self.C, self.R)

    def plus(self, x: Array, d: Array) -> Array:
        """Return x + d."""
        return x + d

    def minus(self, x1: Array, x0: Array) -> Array:
        """Return x1 - x0."""
        return x1 - x0

    def fit_state(self, x: Array, values: Array, P: Array) -> Array:
        """Return the least-squares fit to a measurement, weighted by P and R."""
        return x + compute_update(P, self.C, self.R, values - self.C.dot(x)).step

    def at_rest(self, x: Array, t: float) -> Array:
        """Return x, which has no velocities."""
        return x

    def unmodelled_variance(self, acceleration: float, dt: float) -> Array:
        """Return zeros, since a linear process does not define accelerations."""
        return np.zeros(self.n)

    def transport(self, x0: Array, x1: Array) -> None:
        """Return None, since the tangent is the same everywhere."""

    def bounds(self, x: Array) -> StateBounds:
        """Return the bounded entries of x."""
        return StateBounds(x[self._has_bound], self._selected, *self._bounds)


def check_covariance(name: str, matrix: Array) -> None:
    """Check that a matrix is a covariance: finite, symmetric and positive semidefinite.

    Raises:
        ModelError: It is not; the message names the matrix and the condition.
    """
    if not np.isfinite(matrix).all():
        raise ModelError(f"{name} is not finite")
    size = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > _ASYMMETRY * size:
        raise ModelError(f"{name} is not symmetric")
    if len(matrix) and np.linalg.eigvalsh(matrix)[0] < -_ASYMMETRY * size:
        raise ModelError(f"{name} is not positive semidefinite")


class Transition(NamedTuple):
    """One interval of a process, linearised.

    Attributes:
        x: State at the end, without disturbance.
        F: Derivative of x with respect to the state at the start, in their tangents, shape (n, n).
        G: Derivative of x with respect to the disturbance w, shape (n, nw).
        Q: Covariance of w, shape (nw, nw).
    """

    x: Any
    F: Array
    G: Array
    Q: Array

    @property
    def noise(self) -> Array:
        """Covariance G Q G' that the interval adds, shape (n, n)."""
        return self.G.dot(self.Q).dot(self.G.T)


class Observation(NamedTuple):
    """Expected measurement at a state, linearised.

    Attributes:
        y: Expected values without noise, shape (m,).
        H: Derivative of y with respect to a tangent step, shape (m, n).
        R: Covariance of the noise, shape (m, m).
    """

    y: Array
    H: Array
    R: Array


class StateBounds(NamedTuple):
    """Bounded quantities at a state, linearised.

    Attributes:
        values: Their values, shape (b,).
        slope: Derivative of the values with respect to a tangent step, shape (b, n).
        lower: Lower bounds, shape (b,).
        upper: Upper bounds, shape (b,).
        can_be_released: Which bounds may be dropped if measurements clearly contradict them, shape
            (b,); None for none.
    """

    values: Array
    slope: Array
    lower: Array
    upper: Array
    can_be_released: Bools | None = None


class Estimator:
    """Estimates the state of a process: call `begin`, then `predict` and `correct` in turn.

    Attributes:
        belief: Newest belief.
        is_late: Whether the next correction should take as little time as possible; the caller
            sets it.
    """

    belief: Belief
    is_late: bool = False

    def __init__(self, process: Process) -> None:
        self.process = process

    def begin(self, x: Any, P: Array, t: float = 0.0) -> Belief:
        """Begin with a prior.

        Args:
            x: State of the process.
            P: Covariance of the state, shape (n, n).
            t: Time [s].

        Raises:
            ModelError: P is not a covariance of shape (n, n).
        """
        n = self.process.n
        if np.shape(P) != (n, n):
            raise ModelError(f"P has shape {np.shape(P)}, but must have shape {(n, n)}")
        check_covariance("P", np.asarray(P))
        self.belief = Belief(t, x, np.array(P, dtype=np.float64))
        return self.belief

    def predict(self, u: Array | None, t: float) -> Belief:
        """Predict the belief at a later time.

        Args:
            u: Inputs since the last belief, shape (nu,); None without inputs.
            t: Time [s].
        """
        raise NotImplementedError

    def correct(self, measurement: Measurement, observation: Observation | None = None) -> Belief:
        """Correct the newest belief by a measurement at its time.

        Args:
            measurement: The measurement.
            observation: Expected measurement at the newest belief; None to compute it.
        """
        raise NotImplementedError

    def checkpoint(self) -> Any:
        """Return everything on which later results depend."""
        return self.belief

    def restore(self, checkpoint: Any) -> None:
        """Return to the state in which `checkpoint` was taken."""
        self.belief = checkpoint


class Belief(NamedTuple):
    """Estimated state with its covariance.

    Attributes:
        t: Time [s].
        x: Estimated state of the process.
        P: Covariance of the tangent step from x to the true state, shape (n, n).
        innovation: Innovation of the newest measurement; None before the first one.
        is_trusted: Whether the estimate is reliable.
        remark: Reason why it is not reliable, empty if it is.
    """

    t: float
    x: Any
    P: Array
    innovation: Innovation | None = None
    is_trusted: bool = True
    remark: str = ""


class Measurement(NamedTuple):
    """Measured values of all sensors at one time.

    Attributes:
        t: Time [s].
        values: Values of all sensors of the process, NaN where not measured, shape (m,).
        used: Which values an estimator may use, shape (m,); None for all finite ones.
    """

    t: float
    values: Array
    used: Bools | None = None


class SensorSet:
    """Stacked measurements of the sensors of a mechanism.

    Args:
        evaluate: Function that evaluates accelerations and multipliers for sensors that depend on
            them; `System.evaluate` by default.

    Attributes:
        m: Number of measured values of all sensors.
        slices: Slice of each sensor in the stacked values.
        names: `<sensor>`, or `<sensor>.<component>`, of each value.
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
            ".".join(filter(None, (sensor.name, component)))
            for sensor in sensors
            for component in sensor.components
        )
        self._reads = max((_reads(sensor) for sensor in sensors), default=Reads.NOTHING)
        self._needs_forces = any(s.level >= Measures.ACCELERATION for s in sensors)
        has_force_sensors = any(s.level >= Measures.FORCE for s in sensors)
        self._reactions = SystemReactions(system) if has_force_sensors else None
        self._noise_varies = any(s.noise_varies for s in sensors)
        self._R: Array | None = None
        nv = int(system.robot.model.nv)
        self._by_q, self._by_v = np.zeros((2, self.m, nv))
        each = zip(self.sensors, self.slices, strict=True)
        self._nonlinear = [(s, mine) for s, mine in each if not s.is_linear]
        self._is_filled, nz = False, system.internals.nz
        self._constant_H: Array | None = None  # the derivative, if it is the same everywhere
        self._by_z, self._is_offset = np.zeros((self.m, nz)), False
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            slope = sensor.by_internal(nz)
            if slope is not None:
                self._by_z[mine], self._is_offset = slope, True
        each = zip(self.sensors, self.slices, strict=True)
        self._periodic = [(s, mine) for s, mine in each if type(s).near is not Sensor.near]

    def near(self, values: Array, expected: Array) -> Array:
        """Return measured values with angles unwrapped next to the expected ones, shape (m,)."""
        if not self._periodic:
            return values
        unwrapped = values.copy()
        for sensor, mine in self._periodic:
            unwrapped[mine] = sensor.near(values[mine], expected[mine])
        return unwrapped

    def values(self, y: State, u: Array | None) -> Array:
        """Return the expected values of all sensors, shape (m,)."""
        return self._expected(y, u)[1]

    def covariance(self, y: State) -> Array:
        """Return the covariance of the noise as a read-only array, shape (m, m).

        Raises:
            ModelError: A sensor has no noise.
            SolveError: The covariance is not finite at this state.
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
                raise ModelError(f"sensor {sensor.name}: its noise must be > 0 for an estimator")
        self._R = R
        return R

    def observe(self, y: State, u: Array | None, tangent: StateTangent) -> Observation:
        """Return the expected values and their derivative with respect to tangent steps."""
        R = self.covariance(y)
        x, expected = self._expected(y, u)
        if self._constant_H is not None:
            return Observation(expected, self._constant_H, R)
        if not self._is_filled:
            self._fill(x)
        k, differ = self._system.k, list[int]()
        for sensor, mine in self._nonlinear:
            if sensor.level is Measures.POSITION:
                self._by_q[mine] = sensor.jacobian(k, x)
                continue
            by_q = sensor.by_position(k, x) if sensor.level is Measures.VELOCITY else None
            if by_q is None:
                differ.extend(range(mine.start, mine.stop))
            else:
                self._by_q[mine], self._by_v[mine] = by_q, sensor.jacobian(k, x)
        nv, lift = self._by_q.shape[1], tangent.lift_to_joints(y)
        H = self._by_q.dot(lift[:nv]) + self._by_v.dot(lift[nv:])
        if self._is_offset:
            H[:, tangent.n - self._by_z.shape[1] :] += self._by_z
        if differ:
            H[differ] = self._differences(y, u, expected, tangent)[differ]
        is_full = tangent.is_unconstrained and tangent.n == 2 * nv + self._by_z.shape[1]
        if is_full and not self._nonlinear:
            self._constant_H = H
        return Observation(expected, H, R)

    def _fill(self, x: State) -> None:
        """Fill the constant rows of the derivative."""
        self._is_filled = True
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            if sensor.is_linear and sensor.level is Measures.POSITION:
                self._by_q[mine] = sensor.jacobian(self._system.k, x)
            elif sensor.is_linear:
                by_q = sensor.by_position(self._system.k, x)
                self._by_q[mine] = 0.0 if by_q is None else by_q
                self._by_v[mine] = sensor.jacobian(self._system.k, x)

    def _differences(
        self, y: State, u: Array | None, expected: Array, tangent: StateTangent
    ) -> Array:
        H, step = np.zeros((self.m, tangent.n)), np.zeros(tangent.n)
        for i in range(tangent.n):
            step[i] = _STEP
            H[:, i] = (self.values(tangent.plus(y, step), u) - expected) / _STEP
            step[i] = 0.0
        return H

    def _expected(self, y: State, u: Array | None) -> tuple[State, Array]:
        """Return the state of all joints and the expected values of the sensors there."""
        system, now = self._system, None
        x, k = system.expand(y), system.k
        if self._needs_forces:
            evaluation = self._evaluate(x, u)
            a, lam = evaluation.a, evaluation.lam
            reactions = None if self._reactions is None else self._reactions.at(x, u, a, lam)
            now = Now(a, lam, reactions)
        k.refresh(x.q, x.v, self._reads)
        values = [np.asarray(s.measure(k, x, now), dtype=np.float64) for s in self.sensors]
        return x, np.concatenate([np.zeros(0), *values])


def _reads(sensor: Sensor) -> Reads:
    """Return the level of kinematics that a sensor and its Jacobian read."""
    return Reads(max(sensor.reads, Reads.JACOBIAN)) if sensor.reads else Reads.NOTHING


def transport_covariance(process: Process, P: Array, x0: Any, x1: Any) -> Array:
    """Return a covariance in the tangent at x0 as one in the tangent at a nearby state x1."""
    T = process.transport(x0, x1)
    return P if T is None else T.dot(P).dot(T.T)
