"""The linear problems of steps in which velocities jump.

M and f are those of an intermediate state, at the time theta h with (1 - theta) v + theta v+. One
step of Newton's method and a correction solve for v+, with the matrix

    K = M - theta h f_v - theta^2 h^2 f_q

of the loads, so that stiff ones do not limit h. All rows are in one complementarity problem, with
their rates at the end of the step.
"""

import numpy as np

from mbd_ros.core.dynamics.impulse_response import ImpulseResponse
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.rigid_rows import RigidRows
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_factor import RowFactor
from mbd_ros.core.state import Array, State
from mbd_ros.core.time_stepping.implicit_loads import ImplicitLoads, mass_with
from mbd_ros.core.time_stepping.row_solvers import returns, rows_of_step
from mbd_ros.core.time_stepping.step_problem import StepProblem
from mbd_ros.errors import DivergedError


class StepProblems:
    """Problems of the steps of one system; has a `Data` of its own.

    Args:
        system: The system, under any tier.
        theta: From 1/2, of second order where motion is smooth, to 1, which damps most.

    Attributes:
        giving_way: What solves for rows that give way.
    """

    def __init__(self, system: System, theta: float) -> None:
        nv, layout = int(system.model.nv), system.layout
        self._system, self._theta = system, theta
        self._mechanism = mechanism = Mechanism(system.robot, system.loads)
        self._loads = ImplicitLoads(mechanism, system.internals)
        gains = system.constraints.gains
        self._rigid = RigidRows(mechanism, ConstraintRows(layout.rigid, nv, gains))
        self._yielding = ConstraintRows(layout.yielding, nv)
        self._rows, self.giving_way = rows_of_step(system, mechanism, self._yielding, theta)
        self._return = returns(layout.rigid, gains), returns(layout.yielding)
        self._nothing = np.zeros((0, nv)), np.zeros(0)

    def _problem(self, y: State, u: Array | None, h: float) -> StepProblem:
        """The linear problem of a step from a state of what is integrated."""
        mechanism, late = self._mechanism, (1.0 - self._theta) * h
        x = self._on_the_way(y, h)
        M = np.array(mechanism.mass(x.q))
        slopes, dz = self._loads.slopes(x, u, self._theta * h), h * self._loads.rates(x, u)
        impulse = h * self._force(x, u, M) + slopes.push.dot(dz)
        if not np.isfinite(slopes.added).all() or not np.isfinite(impulse).all():
            raise DivergedError(f"forces at t = {x.t:.9g} s are not finite")
        K = mass_with(M, slopes.added) if slopes.added.any() else M
        hold, goal, factor = self._bilateral(x, K, late, h)
        held = ImpulseResponse(K, None, hold, factor)
        free, _ = held.kept(x.v + held.free(impulse), goal)
        acting, J, drift, gap, own = self._rows.at(x, free, h)
        drift = self._drift(x, J, drift)
        still = slopes.gain.dot(dz) - slopes.by_v.dot(x.v)
        known = goal, free, h, self._theta, slopes, still
        if not len(gap):
            return StepProblem(x, M, held, acting, J, gap, own, own, own, *known)
        with np.errstate(invalid="ignore"):  # an end that is infinitely far, times 0
            back = np.minimum(self._return[1][acting.at], 1.0 / h)
            back = np.where(acting.pushes, 0.0, back * gap)
        early = self._theta * h  # from the start to the state where J and drift are known
        rate = J.dot(x.v) + own - early * drift
        gap = gap - early * (rate + 0.5 * early * drift)
        bend, response = late * drift, self._rows.response(held, K, J)
        end = own + bend + back
        return StepProblem(x, M, response, acting, J, gap, rate, end, bend, *known)

    def _bilateral(
        self, x: State, K: Array, late: float, h: float
    ) -> tuple[Array, Array, RowFactor | None]:
        """Bilateral rows, their J v at the end of a step, and their factor in the metric of K."""
        k, rows = self._mechanism.k, self._rigid.constraints
        if not self._rigid.rows:
            return *self._nothing, None
        k.refresh(x.q, x.v, rows.reads)
        J, drift = (each.copy() for each in rows.accelerations(k, x))
        back = np.minimum(self._return[0], 1.0 / h)
        drift = self._drift(x, J, drift)
        goal = -(rows.rate(k, x) + late * drift + back * rows.residual(k, x))
        return J, goal, RowFactor(K, J)

    def _corrected(
        self, problem: StepProblem, y: State, u: Array | None, end: Array
    ) -> StepProblem:
        """The problem with forces and rates on the way to a velocity at its end."""
        v, h, slopes, loads = problem.x.v, problem.h, problem.slopes, self._loads
        mean, dz = (1.0 - self._theta) * v + self._theta * end, problem.dz(end)
        x = self._between(y, self._system.integrated(mean), y.z + self._theta * dz, h)
        left_z = h * loads.rates(x, u) - dz
        left = h * self._force(x, u, problem.M) - problem.M.dot(end - v) + slopes.push.dot(left_z)
        response = problem.response
        free, _ = response.kept(end + response.free(left), problem.goal)
        still = dz + slopes.gain.dot(left_z) - slopes.by_v.dot(end)
        return problem._replace(free=free, dz_still=still)

    def _on_the_way(self, y: State, h: float) -> State:
        """State of all joints at the intermediate time, with the velocity of y."""
        return self._between(y, y.v, y.z, h)

    def _between(self, y: State, v: Array, z: Array, h: float) -> State:
        """State of all joints at the intermediate time, of a step with that mean velocity of y."""
        share = self._theta * h
        q = self._system.chart.integrate(y.q, share * v)
        return self._system.expand(State(y.t + share, q, v, z))

    def _force(self, x: State, u: Array | None, M: Array) -> Array:
        """Generalized force of all joints that changes velocities as a step counts them."""
        return self._loads.force(x, u)

    def _drift(self, x: State, J: Array, drift: Array) -> Array:
        """The part of g'' without the change of velocities as a step counts them."""
        return drift
