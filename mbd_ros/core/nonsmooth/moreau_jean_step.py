"""The Moreau-Jean time step: velocities jump, and impacts, stick and gaps hold at its end.

    M (v+ - v) = h f + J' p,   q+ = q (+) h ((1 - theta) v + theta v+)

All rows are in one complementarity problem, with their rates w = J v+ at the end of the step:

    bilateral   w = 0                                unilateral  p >= 0,  w >= 0,  p w = 0
    bounded     |p| <= h limit,  w = 0 inside        friction    p in its cone, against the slip

A unilateral row takes part if its gap would close in the step. M and f are those of an
intermediate state, at the time theta h with the velocity (1 - theta) v + theta v+. One step of
Newton's method and a correction solve for v+, with the matrix

    K = M - theta h f_v - theta^2 h^2 f_q

of the loads, so that stiff loads do not limit h. `time_step` has the step on one page;
`implicit_loads` computes K with internal states, `unilateral_rows` poses the linear problem and
solves it without friction, `contact_step` with friction.

Where rows close faster than the forces of one step make them, an impact divides the step where the
first of them closes. A negative gap that remains is corrected in the mass metric. A slip that ends
so early in a step that friction would do work along the rest of it divides the step, too, and so
does a body that turns far beside a contact.

Sources: J. J. Moreau, in Nonsmooth Mechanics and Applications, 1988; M. Jean, Comput. Methods
Appl. Mech. Eng. 177 (1999); V. Acary, Comput. Methods Appl. Mech. Eng. 256 (2013), on positions.
"""

import math
from collections.abc import Sequence
from itertools import chain

import numpy as np

from mbd_ros.core.complementarity.bounded_rows import PushImpulses
from mbd_ros.core.dynamics.mechanism import ImpulseResponse, Mechanism, RigidRows
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.world_axes import FreeBodies
from mbd_ros.core.nonsmooth.impact_map import ImpactMap
from mbd_ros.core.nonsmooth.implicit_loads import ImplicitLoads, mass_with
from mbd_ros.core.nonsmooth.unilateral_rows import (
    Slots,
    StepProblem,
    StepRows,
    UnilateralSolver,
    Which,
)
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowBlock
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import HELD_BY_ROWS, LANDED
from mbd_ros.errors import DivergedError

_IMPACTS = 4  # with restitution in one step; later ones bring the rows that hit to rest together
_TURNS = 3  # of slips in one step
_TURN = 0.5  # rad by which rows of a contact change little
_PARTS = 100  # of a step at most
_SHARES = (0.25, 0.0625, 0.015625)  # of a step, in which the end of an early slip is searched
_WHOLE = 1.0 - 1.0e-6  # of a step, so that a part of it remains
_TOGETHER = 1.0e-6  # of the change of the fastest gap in a step: gaps that close at one time
_MOVES = 4  # position corrections; each squares the remaining error
_NEAR = 10.0  # times the most negative gap: gaps that a position correction takes into account


class MoreauJeanStep:
    """Time steps of one system; it owns a Pinocchio `Data`.

    Args:
        system: The system, under any tier.
        theta: From 1/2, of second order where motion is smooth, to 1, which damps most.

    Attributes:
        row_solver: Solver of unilateral and bounded rows.
    """

    def __init__(self, system: System, theta: float) -> None:
        nv, layout = int(system.model.nv), system.layout
        self._system = system
        self._theta = theta
        self._mechanism = mechanism = Mechanism(system.robot, system.loads)
        self._loads = ImplicitLoads(mechanism, system.internals)
        gains = system.constraints.gains
        self._rigid = RigidRows(mechanism, ConstraintRows(layout.rigid, nv, gains))
        unilateral = ConstraintRows(layout.yielding, nv)
        self._slots = unilateral.slots
        self._rows, self.row_solver = rows_of_step(system, mechanism, unilateral, theta)
        self._return = returns(layout.rigid, gains), returns(layout.yielding)
        self._nothing = np.zeros((0, nv)), np.zeros(0)
        self._impacts = ImpactMap(system)
        self._correction = PositionCorrection(mechanism, self._rigid, self._rows)

    def step(self, y: State, u: Array | None, h: float, t: float) -> State:
        """Return the state of what is integrated at a time t, after a step of length h [s].

        Args:
            y: State at the start.
            u: Inputs; None for safe values.
            h: Length of the step [s].
            t: Time at the end [s].

        Raises:
            SolveError: Rows contradict one another.
            DivergedError: Forces are not finite.
        """
        self._rows.start_from(y.q)
        posed = self._pose(y, u, h)
        parts = self._parts(posed[0])
        if parts == 1:
            return self._advance(posed, y, u, t, _TURNS)
        part = h / parts
        for left in reversed(range(parts)):
            y = self._advance(self._pose(y, u, part), y, u, t - left * part, _TURNS)
        return y

    def _parts(self, problem: StepProblem) -> int:
        """Return the number of parts of a step in which no body turns far beside a contact."""
        if not problem.row_set.cones:
            return 1
        turn = problem.h * max(self._rows.turn_rate(v) for v in (problem.x.v, problem.free))
        return max(1, math.ceil(min(turn / _TURN, _PARTS)))

    def _advance(
        self, posed: tuple[StepProblem, Which], y: State, u: Array | None, t: float, turns: int
    ) -> State:
        """Return the state after a part of a step.

        Args:
            posed: Problem of the part, and its rows that would be closed.
            y: State at its start.
            u: Inputs.
            t: Time at its end [s].
            turns: How many times slips that end may divide it.
        """
        problem, closed = posed
        h = problem.h
        met: list[list[int]] = []
        while (hits := problem.hits(closed)).any() and len(met) < _IMPACTS + len(self._slots):
            y, h = self._take_impact(problem, closed, hits, y, met)
            problem, closed = self._pose(y, u, h)
        problem, end = self._solve(problem, closed, y, u)
        slips = self.row_solver.early_slips(problem, end) if turns else None
        if slips is not None:
            if part := self._first_slip_end(slips, y, u, h):
                y = self._finish(y, *self._solve(*self._pose(y, u, part), y, u), t - h + part)
                return self._advance(self._pose(y, u, h - part), y, u, t, turns - 1)
            self.row_solver.accept()
        return self._correct_positions(self._finish(y, problem, end, t))

    def _pose(self, y: State, u: Array | None, h: float) -> tuple[StepProblem, Which]:
        """Return the problem of a step without impacts, and its rows that would close."""
        problem = self._problem(y, u, h)
        return problem, problem.closed()

    def _problem(self, y: State, u: Array | None, h: float) -> StepProblem:
        """Return the linear problem of a step from a state of what is integrated.

            K (free - v) = h f + J_b' p_b,   J_b free = goal   without the other rows
            w = J v+ + offset                                 rates of the rows at the end

        J and its drift are those of the intermediate time; gaps and rates at both ends of the step
        follow from there to second order.
        """
        mechanism, late = self._mechanism, (1.0 - self._theta) * h
        x = self._intermediate(y, h)
        M = np.array(mechanism.mass(x.q))
        slopes, dz = self._loads.slopes(x, u, self._theta * h), h * self._loads.rates(x, u)
        impulse = h * self._force(x, u, M) + slopes.push.dot(dz)
        if not np.isfinite(slopes.added).all() or not np.isfinite(impulse).all():
            raise DivergedError(f"forces at t = {x.t:.9g} s are not finite")
        K = mass_with(M, slopes.added) if slopes.added.any() else M
        hold, goal, factor = self._bilateral(x, K, late, h)
        constrained = ImpulseResponse(K, None, hold, factor)
        free, _ = constrained.constrain(x.v + constrained.free(impulse), goal)
        row_set, J, drift, gap, offset = self._rows.at(x, free, h)
        drift = self._drift(x, J, drift)
        still = slopes.gain.dot(dz) - slopes.by_v.dot(x.v)
        known = goal, free, h, self._theta, slopes, still
        if not len(gap):
            return StepProblem(x, M, constrained, row_set, J, gap, offset, offset, offset, *known)
        with np.errstate(invalid="ignore"):  # an end that is infinitely far, times 0
            back = np.minimum(self._return[1][row_set.at], 1.0 / h)
            back = np.where(row_set.pushes, 0.0, back * gap)
        early = self._theta * h  # from the start to the state where J and drift are known
        rate = J.dot(x.v) + offset - early * drift
        gap = gap - early * (rate + 0.5 * early * drift)
        bend, response = late * drift, self._rows.response(constrained, K, J)
        end = offset + bend + back
        return StepProblem(x, M, response, row_set, J, gap, rate, end, bend, *known)

    def _bilateral(
        self, x: State, K: Array, late: float, h: float
    ) -> tuple[Array, Array, RowFactor | None]:
        """Return bilateral rows, their J v at the end of a step, and their factor for K."""
        k, rows = self._mechanism.k, self._rigid.constraints
        if not self._rigid.rows:
            return *self._nothing, None
        k.refresh(x.q, x.v, rows.reads)
        J, drift = (each.copy() for each in rows.accelerations(k, x))
        back = np.minimum(self._return[0], 1.0 / h)
        drift = self._drift(x, J, drift)
        goal = -(rows.rate(k, x) + late * drift + back * rows.residual(k, x))
        return J, goal, RowFactor(K, J)

    def _solve(
        self, problem: StepProblem, closed: Which, y: State, u: Array | None
    ) -> tuple[StepProblem, Array]:
        """Solve with the forces on the way to the end; return that problem, and the velocity."""
        end = self.row_solver.solve(problem, closed, problem.free)
        problem = self._correct_forces(problem, y, u, end)
        return problem, self.row_solver.solve(problem, closed, problem.free, end)

    def _correct_forces(
        self, problem: StepProblem, y: State, u: Array | None, end: Array
    ) -> StepProblem:
        """Return the problem with forces and rates on the way to a velocity at its end."""
        v, h, slopes, loads = problem.x.v, problem.h, problem.slopes, self._loads
        mean, dz = (1.0 - self._theta) * v + self._theta * end, problem.dz(end)
        x = self._intermediate_with(y, self._system.integrated(mean), y.z + self._theta * dz, h)
        left_z = h * loads.rates(x, u) - dz
        left = h * self._force(x, u, problem.M) - problem.M.dot(end - v) + slopes.push.dot(left_z)
        response = problem.response
        free, _ = response.constrain(end + response.free(left), problem.goal)
        still = dz + slopes.gain.dot(left_z) - slopes.by_v.dot(end)
        return problem._replace(free=free, dz_still=still)

    def _intermediate(self, y: State, h: float) -> State:
        """Return the state of all joints at the intermediate time, with the velocity of y."""
        return self._intermediate_with(y, y.v, y.z, h)

    def _intermediate_with(self, y: State, v: Array, z: Array, h: float) -> State:
        """Return the state of all joints at the intermediate time, for a mean velocity of y."""
        share = self._theta * h
        q = self._system.chart.integrate(y.q, share * v)
        return self._system.expand(State(y.t + share, q, v, z))

    def _force(self, x: State, u: Array | None, M: Array) -> Array:
        """Generalized force of all joints that changes velocities as a step counts them."""
        return self._loads.force(x, u)

    def _drift(self, x: State, J: Array, drift: Array) -> Array:
        """Return the part of g'' without the change of velocities as a step counts them."""
        return drift

    def _take_impact(
        self, problem: StepProblem, closed: Which, hits: Which, y: State, met: list[list[int]]
    ) -> tuple[State, float]:
        """Return the state after the next impact of a step, and the rest of the step [s].

        The rows of the impact are appended to `met`.
        """
        v, gap, rate, h = problem.x.v, problem.gap, problem.rate, problem.h
        end = self.row_solver.solve_active(problem, closed & ~hits, problem.free)
        gained = (end - v) / h
        bent = problem.J.dot(gained)
        wait = min(first_closing(gap[hits], rate[hits], bent[hits]), _WHOLE * h)
        at = gap + wait * rate + 0.5 * wait**2 * bent
        touching = closed & (at <= _TOGETHER * h * np.abs(rate[hits]).max())
        met.append(self._slots[problem.row_set.at[touching[problem.row_set.decides]]].tolist())
        expands = len(met) <= _IMPACTS
        slots = met[-1] if expands else list(chain(*met))
        before = v + wait * gained
        displacement, dz = 0.5 * wait * (v + before), wait / h * problem.dz(end)
        y = self._move(y, displacement, before, dz, y.t + wait)
        v = self._impacts.impact(self._system.expand(y), slots, expands=expands).v
        return y._replace(v=np.array(self._system.integrated(v))), h - wait

    def _first_slip_end(self, slips: Slots, y: State, u: Array | None, h: float) -> float:
        """Return when the first of some slips ends within a step [s]; 0 where none is seen to."""
        for share in _SHARES:
            problem, end = self._solve(*self._pose(y, u, share * h), y, u)
            part = self.row_solver.first_slip_end(slips, problem, end)
            if part:
                return part if part < _WHOLE * h else 0.0
        return 0.0

    def _finish(self, y: State, problem: StepProblem, end: Array, t: float) -> State:
        """Return the state at the end of a step: q+ = q (+) h ((1 - theta) v + theta v+)."""
        displacement = problem.h * ((1.0 - self._theta) * problem.x.v + self._theta * end)
        dz = problem.dz(end)
        correction = self.row_solver.displacement_correction(problem, end)
        if correction is not None:
            energy, candidates = self._system.energy, (displacement, displacement - correction)
            displacement = min(candidates, key=lambda w: energy(self._move(y, w, end, dz, t)))
        return self._move(y, displacement, end, dz, t)

    def _correct_positions(self, y: State) -> State:
        """Return the nearest state without negative gaps, in the mass metric."""
        if not self._rows.are_one_sided:
            return y
        for _ in range(_MOVES):
            x = self._system.expand(y)
            displacement = self._correction.displacement(x)
            if displacement is None:
                break
            y = self._move(y, displacement, x.v, 0.0 * y.z, y.t)
        return y

    def _move(self, y: State, displacement: Array, v: Array, dz: Array, t: float) -> State:
        """Return the state after a displacement, with a velocity of all joints."""
        system = self._system
        q = system.chart.integrate(y.q, system.integrated(displacement))
        z = system.internals.inside(y.z + dz)
        self._rows.record_displacement(q, displacement)
        return State(t, q, np.array(system.integrated(v)), z, y.mode)


class FreeBodyStep(MoreauJeanStep):
    """Steps of a system with free bodies, whose axes turn within a step.

    A velocity v of a free body stands in its own axes, so that it changes where the body turns:
    v' = R' a - w x v. A step that integrates this change errs by (w h)^2 of the velocity of a ball
    that spins. Here the linear velocities of a step are expressed in the axes of its intermediate
    state, where free bodies keep them.

    Args:
        system: The system, under any tier.
        theta: From 1/2, of second order where motion is smooth, to 1, which damps most.
    """

    def __init__(self, system: System, theta: float) -> None:
        super().__init__(system, theta)
        self._bodies = FreeBodies(system.model)
        self._integrated = FreeBodies(system.chart.model)
        self._q = system.robot.neutral()
        self._axes = self._bodies.axes(self._q)

    def _intermediate(self, y: State, h: float) -> State:
        """Return the state of all joints at the intermediate time, with the velocity of y."""
        before = self._axes = self._integrated.axes(y.q)
        x = self._intermediate_with(y, y.v, y.z, h)
        self._axes, self._q = self._bodies.axes(x.q), x.q
        return x._replace(v=self._bodies.in_axes(x.v, before, self._axes))

    def _intermediate_with(self, y: State, v: Array, z: Array, h: float) -> State:
        """Return the state of all joints at the intermediate time, for a mean velocity of y."""
        share, system = self._theta * h, self._system
        q = self._integrated.integrate(system.chart, y.q, share * v, self._axes)
        return system.expand(State(y.t + share, q, v, z))

    def _force(self, x: State, u: Array | None, M: Array) -> Array:
        """Generalized force of all joints that changes velocities as a step counts them."""
        bodies, axes = self._bodies, self._axes
        turning: Array = M.dot(bodies.spin_acceleration(x.v))
        if x.q is self._q:
            return super()._force(x, u, M) + turning
        own = bodies.axes(x.q)
        force = super()._force(x._replace(v=bodies.in_axes(x.v, axes, own)), u, M)
        return bodies.in_axes(force, own, axes) + turning

    def _drift(self, x: State, J: Array, drift: Array) -> Array:
        """Return the part of g'' without the change of velocities as a step counts them."""
        left: Array = drift - J.dot(self._bodies.spin_acceleration(x.v))
        return left

    def _move(self, y: State, displacement: Array, v: Array, dz: Array, t: float) -> State:
        """Return the state after a displacement, with a velocity of all joints."""
        system, bodies = self._system, self._integrated
        q = bodies.integrate(system.chart, y.q, system.integrated(displacement), self._axes)
        self._rows.record_displacement(q, displacement)
        v = bodies.in_axes(system.integrated(v), self._axes, bodies.axes(q))
        return State(t, q, v, system.internals.inside(y.z + dz), y.mode)

    def _finish(self, y: State, problem: StepProblem, end: Array, t: float) -> State:
        """Return the state at the end of a step, in the axes of its problem."""
        self._axes = self._bodies.axes(problem.x.q)
        return super()._finish(y, problem, end, t)

    def _correct_positions(self, y: State) -> State:
        """Return the nearest state without negative gaps, in the mass metric."""
        self._axes = self._integrated.axes(y.q)
        return super()._correct_positions(y)


def rows_of_step(
    system: System, mechanism: Mechanism, rows: ConstraintRows, theta: float
) -> tuple[StepRows, UnilateralSolver]:
    """Return the unilateral and bounded rows of steps, and what solves for them."""
    if not rows.cones:
        return StepRows(mechanism, rows), UnilateralSolver(rows)
    from mbd_ros.core.nonsmooth.contact_step import ContactScreening, ContactSolver

    is_whole = system.nv == system.model.nv
    return ContactScreening(mechanism, rows, is_whole), ContactSolver(rows, theta)


def returns(blocks: Sequence[RowBlock], gains: tuple[float, float] | None = None) -> Array:
    """Return rates [1/s] with which rows come back to 0, kp / kd, one a row; 0 without gains."""
    ratios = [np.zeros(0)]
    for block in blocks:
        kp, kd = (np.broadcast_to(gain, len(block.rows)) for gain in gains or block.gains)
        ratios.append(np.divide(kp, kd, out=np.zeros(len(kp)), where=kd > 0.0))
    return np.concatenate(ratios)


def first_closing(gap: Array, rate: Array, bent: Array) -> float:
    """Return the first time at which a gap is 0 [s]; rates are negative.

    A gap that is closed already gives 0.
    """
    root = np.sqrt(np.maximum(rate * rate - 2.0 * bent * gap, 0.0))
    return max(float((2.0 * gap / (root - rate)).min()), 0.0)


class PositionCorrection:
    """Finds the least displacement, in the mass metric, that makes negative gaps 0.

        min |d|_M   subject to   g + J d >= 0,   J_b d = 0 of bilateral rows

    Args:
        mechanism: The mechanism.
        rigid: Its bilateral rows, which hold.
        rows: Its unilateral and bounded rows.
    """

    def __init__(self, mechanism: Mechanism, rigid: RigidRows, rows: StepRows) -> None:
        self._mechanism = mechanism
        self._rigid = rigid
        self._rows = rows
        self._no_rows = np.zeros((0, int(mechanism.model.nv)))

    def displacement(self, x: State) -> Array | None:
        """Return the displacement of all joints, shape (nv,); None where no gap is negative."""
        rows, rigid = self._rows, self._rigid
        gap = rows.gaps(x)
        if gap is None or (least := float(gap.min())) >= -LANDED:
            return None
        near = np.flatnonzero(gap <= -_NEAR * least)
        J = rows.jacobian(x, near)
        M = np.array(self._mechanism.mass(x.q))
        hold = rigid.jacobian(x.t, x.q) if rigid.rows else self._no_rows
        factor = rigid.factorise(M, hold) if rigid.rows else None
        response = ImpulseResponse(M, J, hold, factor)
        if len(near) == 1 and response.A[0, 0] > HELD_BY_ROWS * response.loose[0]:
            alone: Array = response.X[:, 0] * (-least / float(response.A[0, 0]))
            return alone
        names = [rows.all_rows.names[i] for i in near]
        p, _ = PushImpulses(response.G, response.loose, names).nearest(gap[near], 0.0)
        together: Array = response.X.dot(p)
        return together
