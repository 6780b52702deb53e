"""A mechanism as a process: it goes on as its simulation does, its sensors say what is seen.

Derivatives are those of x' = f(x, u) along the interval, e^(A dt) with A at the start of pieces of
it, taken into the tangent of consistent states. Disturbances are efforts on the independent
directions, white and held over an interval.

Sources: A. H. Jazwinski, Stochastic Processes and
Filtering Theory, 1970, ch. 8; C. Moler, C. Van Loan, SIAM Review 45(1) (2003), on e^A.
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
from mbd_ros.methods.estimation.kalman_update import updated
from mbd_ros.methods.estimation.process import Bounded, Observation, SensorSet, Transition
from mbd_ros.methods.estimation.state_tangent import StateTangent
from mbd_ros.methods.simulation.simulation import Simulation

_PIECE = 0.01  # s, over which A is taken for constant
_SMALL = 0.25  # of |A dt|, where its exponential is not halved: twelve terms leave 1e-16
_SERIES = np.array([1.0 / math.factorial(i) for i in range(12)]).reshape(3, 4)
_STAGE = 0.1  # rad, m or their rates in one step to the first state, unless it is far away
_SHARE = 0.05  # of the way, in one step, if that is longer
_FARTHEST = 1.0e3  # rad, m or their rates, from where on nothing is sought
_SEARCHES = 150  # steps to the first state, at most
_STALLED = 50  # steps without a shorter one, after which no more is sought
_FOUND = 1.0e-9  # last step to it [m, rad and rates]


class MechanismProcess:
    """The scene of a simulation, as estimators see it; x is a state of what it integrates.

    Args:
        simulation: Of the scene, with its own Pinocchio data.
        sensors: What is measured.
        x: State of all joints near which it begins.
        effort_noise: Density of white efforts on all joints [N·m s^(1/2) or N s^(1/2)], (nv,).
        internal_noise: Density of white noise on the rates of internal states, shape (nz,).
        masses: Of its robot, whose model nobody else uses then, that are internal states.
        internal_sizes: Changes of internal states that count as one where it is linearised, inf
            for those that only add up, shape (nz,); ones by default.
        limits: Whether joints keep their position and velocity limits, in estimators with bounds.

    Attributes:
        tangent: Of its consistent states.
        start: The nearest consistent state to x.
        n: Size of a step.
        nw: Size of a disturbance.
        sizes: As those of `Process`.

    Raises:
        SolveError: The mechanism cannot be assembled near x.
        ModelError: Noise that is not finite or negative.
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
        self.simulation, system = simulation, simulation.system
        self._system: System = system
        self._inertias = UnknownInertias(system.robot.model, masses)
        self.start = self.consistent(x)
        self.sensors = SensorSet(sensors, system, self.evaluate)
        self.tangent = StateTangent(system, self.start)
        self._limits = StateLimits(system, self.tangent, positions=limits, velocities=limits)
        self.n, nz = self.tangent.n, system.internals.nz
        self._density = np.concatenate(
            (effort_noise, np.zeros(nz) if internal_noise is None else internal_noise)
        )
        if not (np.isfinite(self._density).all() and (self._density >= 0.0).all()):
            raise ModelError("process noise must be finite and >= 0")
        self.nw, self.sizes = len(self._density), np.ones(self.n)
        if internal_sizes is not None:
            self.sizes[self.n - nz :] = internal_sizes

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Accelerations and forces at a state, with the masses that are part of it."""
        self._inertias.write(x.z)
        return self._system.evaluate(x, u)

    def consistent(self, x: State) -> State:
        """The nearest state of what is integrated to one of all joints.

        Raises:
            SolveError: The mechanism cannot be assembled near x.
        """
        return self.simulation.start(x, self._system.loads.sources.held(x.t))

    def near(self, x: State, values: Array, P: Array) -> State:
        """The state of what is integrated that fits a measurement, on the way from x.

        Short steps keep the branches of loops. What is not measured goes as little as the prior
        allows.

        Args:
            x: State to begin from.
            values: Measured, NaN where nothing was, shape (m,).
            P: Covariance of the prior, shape (n, n).

        Raises:
            SolveError: No consistent state is near, or the measurement is too far away.
        """
        y, shortest, since = x, np.inf, 0
        for _ in range(_SEARCHES):
            seen = self.sensors.observe(y, None, self.tangent)
            error = self.sensors.near(values, seen.y) - seen.y
            step = updated(P, seen.H, seen.R, error).step
            longest = float(np.abs(step).max())
            if not longest <= _FARTHEST:
                raise SolveError(
                    f"the measurement is {longest:.3g} rad or m away from the state, accepted: "
                    f"{_FARTHEST:g}"
                )
            shortest, since = (longest, 0) if longest < shortest else (shortest, since + 1)
            y = self.plus(y, step * min(1.0, max(_STAGE / max(longest, TINY), _SHARE)))
            if longest <= _FOUND or since >= _STALLED:
                break
        return y

    def advance(self, x: State, u: Array | None, t: float) -> Transition:
        """The state at a later time, and how it depends on the first; simulated in between.

        Raises:
            DivergedError: The state is no longer finite.
            SolveError: Equations contradict one another.
        """
        self._inertias.write(x.z)
        count = max(1, math.ceil((t - x.t) / _PIECE - 1.0e-9))
        lift, flow, y, before = self.tangent.lifted(x), None, self._begun(x, u), x.t
        for i in range(1, count + 1):
            end = t if i == count else before + i * (t - before) / count
            slopes = self._system.derivatives(y, u, inputs=False)
            piece = _exponential(self._flow(y, u, slopes) * (end - y.t))
            flow = piece if flow is None else piece.dot(flow)
            y = self.simulation.advance(y, u, end)
        assert flow is not None
        pushed = self._pushed(y, u, slopes.force, t - before)
        noise = np.diag(self._density**2 / (t - before))
        if self.tangent.is_whole:
            return Transition(y, flow, pushed, noise)
        lower = self.tangent.lowered(y)
        return Transition(y, lower.dot(flow).dot(lift), lower.dot(pushed), noise)

    def observe(self, x: State, u: Array | None) -> Observation:
        """What the sensors measure at a state, and their derivatives."""
        return self.sensors.observe(x, u, self.tangent)

    def plus(self, x: State, d: Array) -> State:
        """The state a step of the tangent away."""
        return self.tangent.plus(x, d)

    def minus(self, x1: State, x0: State) -> Array:
        """The step of the tangent between two states, shape (n,)."""
        return self.tangent.minus(x1, x0)

    def at_rest(self, x: State, t: float) -> State:
        """The state at another time, at rest."""
        return x._replace(t=t, v=np.zeros(x.v.shape))

    def unforeseen(self, acceleration: float, dt: float) -> Array:
        """Variances by unforeseen accelerations, shape (n,); internal states do not accelerate."""
        deviations = acceleration * np.array((0.5 * dt * dt, dt, 0.0))
        return (deviations**2)[self.tangent.levels]

    def turned(self, x0: State, x1: State) -> Array | None:
        """From steps at x0 to the same steps at a state beside it, (n, n); None for unity."""
        return self.tangent.turned(x0, x1)

    def bounded(self, x: State) -> Bounded:
        """Limits of joints and bounds of internal states, at a state."""
        return self._limits.at(x)

    @property
    def bounded_names(self) -> tuple[str, ...]:
        """Names of what has bounds, in the order of `bounded`."""
        return self._limits.names

    def _begun(self, x: State, u: Array | None) -> State:
        stepper = self.simulation.stepper
        stepper.restart()
        return stepper.settle(x, u)

    def _flow(self, y: State, u: Array | None, found: Derivatives) -> Array:
        """A of (q, v, z)' in the steps of `Chart.plus`, shape (2 nv + nz, 2 nv + nz)."""
        system = self._system
        nv = system.nv
        A = np.zeros((2 * nv + len(y.z),) * 2)
        A[:nv, nv : 2 * nv] = np.eye(nv)
        for base in system.chart.bases:
            A[base, base] = -pin.Motion(y.v[base]).action
        A[nv : 2 * nv, :nv], A[nv : 2 * nv, nv : 2 * nv] = found.q, found.v
        A[nv : 2 * nv, 2 * nv :] = found.z
        if self._inertias.masses:
            now = system.evaluate(system.expand(y), u)
            asked = now.respond(self._inertias.efforts(now.x, now.a))
            for mass, column in zip(self._inertias.masses, asked.T, strict=True):
                A[nv : 2 * nv, 2 * nv :][:, mass.part.z] = -system.integrated(column)[:, None]
        if found.rates is not None:
            rates = found.rates
            A[2 * nv :, :nv], A[2 * nv :, nv : 2 * nv], A[2 * nv :, 2 * nv :] = rates[:3]
        return A

    def _pushed(self, y: State, u: Array | None, rate: Array | None, dt: float) -> Array:
        """What held disturbances change in the steps of `Chart.plus`, shape (2 nv + nz, nw)."""
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
    """e^A by scaling and squaring, of twelve terms of its series with five products.

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
    found: Array = low + fourth.dot(middle + fourth.dot(high))
    for _ in range(halvings):
        found = found.dot(found)
    return found


class StateLimits:
    """Positions and velocities of joints within their limits, internal states within bounds.

    Args:
        positions: Whether joints keep their position limits.
        velocities: Whether they keep their velocity limits.

    Attributes:
        names: Of what has bounds, in the order of `at`: `<joint>.position`, `<joint>.velocity`,
            then internal states.
    """

    def __init__(
        self, system: System, tangent: StateTangent, *, positions: bool, velocities: bool
    ) -> None:
        self._system, self._tangent = system, tangent
        self._by: Array | None = None
        joints, internals = system.robot.joints, system.internals
        held = [j for j in joints if positions and np.isfinite((j.lower, j.upper)).any()]
        quick = [j for j in joints if velocities and np.isfinite(j.max_velocity)]
        bounded = np.isfinite(internals.lower) | np.isfinite(internals.upper)
        self._q, self._qv = [j.q for j in held], [j.v for j in held]
        self._v, self._z = [j.v for j in quick], np.flatnonzero(bounded)
        fastest = [j.max_velocity for j in quick]
        lower = [j.lower for j in held] + [-v for v in fastest]
        upper = [j.upper for j in held] + fastest
        self._lower = np.array([*lower, *internals.lower[self._z]], dtype=np.float64)
        self._upper = np.array([*upper, *internals.upper[self._z]], dtype=np.float64)
        self.names = (
            *(f"{joint.name}.position" for joint in held),
            *(f"{joint.name}.velocity" for joint in quick),
            *(internals.names[i] for i in self._z),
        )
        self._may_be_wrong = np.arange(len(self._lower)) < len(held) + len(quick)

    def at(self, y: State) -> Bounded:
        """Values at a state, and their derivatives by a step of the tangent."""
        n, nv = self._tangent.n, self._system.robot.model.nv
        if not len(self._lower):
            return Bounded(self._lower, np.zeros((0, n)), self._lower, self._upper)
        x = self._system.expand(y)
        by = self._by
        if by is None:
            lift = self._tangent.of_all_joints(y)
            rows = np.zeros((len(self._z), n))
            rows[np.arange(len(self._z)), n - len(y.z) + self._z] = 1.0
            by = np.vstack((lift[self._qv], lift[nv:][self._v], rows))
            if self._tangent.is_whole and self._system.nv == nv:
                self._by = by  # the same everywhere
        values = np.concatenate((x.q[self._q], x.v[self._v], x.z[self._z]))
        return Bounded(values, by, self._lower, self._upper, self._may_be_wrong)
