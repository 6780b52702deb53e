"""A mechanism as a process of an estimator: its simulation predicts, its sensors observe.

Derivatives are those of x' = f(x, u) along the interval, e^(A dt) with A at the start of short
pieces of it, projected into the tangent of consistent states. Disturbances are white efforts on
the independent directions, constant over an interval.

Sources: A. H. Jazwinski, Stochastic Processes and Filtering Theory, 1970, ch. 8; C. Moler, C. Van
Loan, SIAM Review 45(1) (2003), on e^A.
"""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.dynamics.system import Derivatives, System
from mbd_ros.core.state import Array, Evaluation, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.estimation.unknowns import UnknownInertias, UnknownMass
from mbd_ros.methods.estimation.kalman_update import compute_update
from mbd_ros.methods.estimation.process import Observation, SensorSet, StateBounds, Transition
from mbd_ros.methods.estimation.state_tangent import StateTangent
from mbd_ros.methods.simulation.simulation import Simulation

_PIECE = 0.01  # s, over which A counts as constant
_SMALL = 0.25  # of |A dt|: its exponential needs no halving, and twelve terms leave 1e-16
_SERIES = np.array([1.0 / math.factorial(i) for i in range(12)]).reshape(3, 4)
_STAGE = 0.1  # rad, m or their rates: longest step to the first state, unless it is far away
_SHARE = 0.05  # of the distance, in one step, if that is longer
_FARTHEST = 1.0e3  # rad, m or their rates: measurements farther away are refused
_SEARCHES = 150  # steps to the first state, at most
_STALLED = 50  # steps without progress, after which the search ends
_FOUND = 1.0e-9  # last step of the search [m, rad and rates]


class MechanismProcess:
    """The scene of a simulation as a process; x is a state as the simulation integrates it.

    Args:
        simulation: Simulation of the scene, with its own Pinocchio data.
        sensors: Sensors of the scene.
        x: State of all joints near which the process begins.
        effort_noise: Density of white efforts on all joints [N·m s^(1/2) or N s^(1/2)], (nv,).
        internal_noise: Density of white noise on the rates of internal states, shape (nz,).
        masses: Masses of its robot that are internal states; its model must not be shared then.
        internal_sizes: Changes of internal states that count as one in linearizations, inf for
            those with a linear effect, shape (nz,); ones by default.
        limits: Whether joints keep position and velocity limits, in estimators with bounds.

    Attributes:
        tangent: Tangent of the consistent states.
        start: Consistent state nearest to x.
        n: Size of a tangent step.
        nw: Size of a disturbance.
        sizes: Changes of the state that count as one, as in `Process`.

    Raises:
        SolveError: The loops cannot be closed near x.
        ModelError: Noise is not finite or negative.
    """

    def __init__(
        self,
        simulation: Simulation,
        sensors: Sequence[Sensor],
        x: State,
        effort_noise: Array,
        internal_noise: Array | None = None,
        *,
        masses: Sequence[UnknownMass] = (),
        internal_sizes: Array | None = None,
        limits: bool = True,
    ) -> None:
        self.simulation = simulation
        system = simulation.system
        self._system: System = system
        self._inertias = UnknownInertias(system.robot.model, masses)
        self.start = self.consistent(x)
        self.sensors = SensorSet(sensors, system, self.evaluate)
        self.tangent = StateTangent(system, self.start)
        self._limits = StateLimits(system, self.tangent, positions=limits, velocities=limits)
        self.n = self.tangent.n
        nz = system.internals.nz
        self._density = np.concatenate(
            (effort_noise, np.zeros(nz) if internal_noise is None else internal_noise)
        )
        if not (np.isfinite(self._density).all() and (self._density >= 0.0).all()):
            raise ModelError("the density of process noise must be finite and >= 0")
        self.nw = len(self._density)
        self.sizes = np.ones(self.n)
        if internal_sizes is not None:
            self.sizes[self.n - nz :] = internal_sizes

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Return accelerations and forces at a state, with the masses that are part of it."""
        self._inertias.write(x.z)
        return self._system.evaluate(x, u)

    def consistent(self, x: State) -> State:
        """Return the nearest consistent state, as integrated, to a state of all joints.

        Raises:
            SolveError: The loops cannot be closed near x.
        """
        return self.simulation.start(x, self._system.loads.sources.hold(x.t))

    def fit_state(self, x: State, values: Array, P: Array) -> State:
        """Return the consistent state that fits a measurement, starting from x.

        Short steps keep the branches of loops. Quantities without a measurement change as little
        as the prior allows.

        Args:
            x: Initial state.
            values: Measured values, NaN where there are none, shape (m,).
            P: Covariance of the prior, shape (n, n).

        Raises:
            SolveError: There is no consistent state near, or the measurement is too far away.
        """
        y, shortest, since = x, np.inf, 0
        for _ in range(_SEARCHES):
            observation = self.sensors.observe(y, None, self.tangent)
            error = self.sensors.near(values, observation.y) - observation.y
            step = compute_update(P, observation.H, observation.R, error).step
            longest = float(np.abs(step).max())
            if not longest <= _FARTHEST:
                raise SolveError(
                    f"the measurement is {longest:.3g} rad or m away from the state, but at most "
                    f"{_FARTHEST:g} is accepted"
                )
            shortest, since = (longest, 0) if longest < shortest else (shortest, since + 1)
            y = self.plus(y, step * min(1.0, max(_STAGE / max(longest, TINY), _SHARE)))
            if longest <= _FOUND or since >= _STALLED:
                break
        return y

    def advance(self, x: State, u: Array | None, t: float) -> Transition:
        """Simulate to a later time, and return the transition.

        Raises:
            DivergedError: The state is not finite.
            SolveError: Equations are inconsistent.
        """
        self._inertias.write(x.z)
        count = max(1, math.ceil((t - x.t) / _PIECE - 1.0e-9))
        lift, flow, y, before = self.tangent.lift(x), None, self._settled(x, u), x.t
        for i in range(1, count + 1):
            end = t if i == count else before + i * (t - before) / count
            slopes = self._system.derivatives(y, u, inputs=False)
            piece = _exponential(self._flow(y, u, slopes) * (end - y.t))
            flow = piece if flow is None else piece.dot(flow)
            y = self.simulation.advance(y, u, end)
        assert flow is not None
        response = self._disturbance_response(y, u, slopes.force, t - before)
        noise = np.diag(self._density**2 / (t - before))
        if self.tangent.is_unconstrained:
            return Transition(y, flow, response, noise)
        lower = self.tangent.restriction(y)
        return Transition(y, lower.dot(flow).dot(lift), lower.dot(response), noise)

    def observe(self, x: State, u: Array | None) -> Observation:
        """Return the predicted measurements of the sensors, and their derivatives."""
        return self.sensors.observe(x, u, self.tangent)

    def plus(self, x: State, d: Array) -> State:
        """Return the state after a tangent step."""
        return self.tangent.plus(x, d)

    def minus(self, x1: State, x0: State) -> Array:
        """Return the tangent step between two states, shape (n,)."""
        return self.tangent.minus(x1, x0)

    def at_rest(self, x: State, t: float) -> State:
        """Return the state at another time, at rest."""
        return x._replace(t=t, v=np.zeros(x.v.shape))

    def unmodelled_variance(self, acceleration: float, dt: float) -> Array:
        """Return variances of unforeseen accelerations, 0 for internal states, shape (n,)."""
        deviations = acceleration * np.array((0.5 * dt * dt, dt, 0.0))
        return (deviations**2)[self.tangent.levels]

    def transport(self, x0: State, x1: State) -> Array | None:
        """Return the map from tangent steps at x0 to those at a near state, or None for unity."""
        return self.tangent.transport(x0, x1)

    def bounds(self, x: State) -> StateBounds:
        """Return the limits of joints and the bounds of internal states, at a state."""
        return self._limits.at(x)

    @property
    def bounded_names(self) -> tuple[str, ...]:
        """Names of the bounded quantities, in the order of `bounds`."""
        return self._limits.names

    def _settled(self, x: State, u: Array | None) -> State:
        stepper = self.simulation.stepper
        stepper.restart()
        return stepper.settle(x, u)

    def _flow(self, y: State, u: Array | None, slopes: Derivatives) -> Array:
        """Return A of (q, v, z)' in tangent steps, shape (2 nv + nz, 2 nv + nz)."""
        system = self._system
        nv = system.nv
        A = np.zeros((2 * nv + len(y.z),) * 2)
        A[:nv, nv : 2 * nv] = np.eye(nv)
        for base in system.chart.bases:
            A[base, base] = -pin.Motion(y.v[base]).action
        A[nv : 2 * nv, :nv] = slopes.q
        A[nv : 2 * nv, nv : 2 * nv] = slopes.v
        A[nv : 2 * nv, 2 * nv :] = slopes.z
        if self._inertias.masses:
            now = system.evaluate(system.expand(y), u)
            changes = now.respond(self._inertias.efforts(now.x, now.a))
            for mass, column in zip(self._inertias.masses, changes.T, strict=True):
                A[nv : 2 * nv, 2 * nv :][:, mass.part.z] = -system.integrated(column)[:, None]
        if slopes.rates is not None:
            rates = slopes.rates
            A[2 * nv :, :nv], A[2 * nv :, nv : 2 * nv], A[2 * nv :, 2 * nv :] = rates[:3]
        return A

    def _disturbance_response(
        self, y: State, u: Array | None, rate: Array | None, dt: float
    ) -> Array:
        """Return the effect of constant disturbances in tangent steps, shape (2 nv + nz, nw)."""
        system, nz = self._system, len(y.z)
        nv, joints = system.nv, system.robot.model.nv
        pushed = np.zeros((2 * nv + nz, self.nw))
        if rate is None:
            respond = system.evaluate(system.expand(y), u).respond
            rate = system.integrated(respond(np.eye(joints)))
        pushed[:nv, :joints], pushed[nv : 2 * nv, :joints] = 0.5 * dt * dt * rate, dt * rate
        pushed[2 * nv :, joints:] = dt * np.eye(nz)
        return pushed


def _exponential(A: Array) -> Array:
    """Return e^A by scaling and squaring, with twelve terms of its series in five products.

    Source: M. S. Paterson, L. J. Stockmeyer, SIAM J. Comput. 2, 1973, 60.
    """
    n, size = len(A), float(np.abs(A).sum(axis=1).max(initial=0.0))
    halvings = max(0, math.ceil(math.log2(size / _SMALL))) if size > _SMALL else 0
    powers = np.empty((4, n, n))
    powers[0], powers[1] = np.eye(n), A / 2.0**halvings
    square = np.dot(powers[1], powers[1], out=powers[2])
    np.dot(square, powers[1], out=powers[3])
    fourth = square.dot(square)
    low, middle, high = _SERIES.dot(powers.reshape(4, -1)).reshape(3, n, n)
    result: Array = low + fourth.dot(middle + fourth.dot(high))
    for _ in range(halvings):
        result = result.dot(result)
    return result


class StateLimits:
    """Limits of the positions and velocities of joints, and bounds of internal states.

    Args:
        positions: Whether joints keep their position limits.
        velocities: Whether joints keep their velocity limits.

    Attributes:
        names: Names of the bounded quantities, in the order of `at`: `<joint>.position`,
            `<joint>.velocity`, then internal states.
    """

    def __init__(
        self, system: System, tangent: StateTangent, *, positions: bool, velocities: bool
    ) -> None:
        self._system = system
        self._tangent = tangent
        self._constant_derivative: Array | None = None
        joints, internals = system.robot.joints, system.internals
        limited = [j for j in joints if positions and np.isfinite((j.lower, j.upper)).any()]
        quick = [j for j in joints if velocities and np.isfinite(j.max_velocity)]
        bounded = np.isfinite(internals.lower) | np.isfinite(internals.upper)
        self._q = [j.q for j in limited]
        self._qv = [j.v for j in limited]
        self._v = [j.v for j in quick]
        self._z = np.flatnonzero(bounded)
        fastest = [j.max_velocity for j in quick]
        lower = [j.lower for j in limited] + [-v for v in fastest]
        upper = [j.upper for j in limited] + fastest
        self._lower = np.array([*lower, *internals.lower[self._z]], dtype=np.float64)
        self._upper = np.array([*upper, *internals.upper[self._z]], dtype=np.float64)
        self.names = (
            *(f"{joint.name}.position" for joint in limited),
            *(f"{joint.name}.velocity" for joint in quick),
            *(internals.names[i] for i in self._z),
        )
        self._is_soft = np.arange(len(self._lower)) < len(limited) + len(quick)

    def at(self, y: State) -> StateBounds:
        """Return values at a state, and their derivatives by a tangent step."""
        n, nv = self._tangent.n, self._system.robot.model.nv
        if not len(self._lower):
            return StateBounds(self._lower, np.zeros((0, n)), self._lower, self._upper)
        x = self._system.expand(y)
        by = self._constant_derivative
        if by is None:
            lift = self._tangent.lift_to_joints(y)
            rows = np.zeros((len(self._z), n))
            rows[np.arange(len(self._z)), n - len(y.z) + self._z] = 1.0
            by = np.vstack((lift[self._qv], lift[nv:][self._v], rows))
            if self._tangent.is_unconstrained and self._system.nv == nv:
                self._constant_derivative = by  # the same everywhere
        values = np.concatenate((x.q[self._q], x.v[self._v], x.z[self._z]))
        return StateBounds(values, by, self._lower, self._upper, self._is_soft)
