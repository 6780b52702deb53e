"""A step in which velocities jump: impacts, stick and gaps hold at its end.

    M (v+ - v) = h f + J' p,   q+ = q (+) h ((1 - theta) v + theta v+)

All rows are in one complementarity problem, with their rates at the end of the step: bilateral
rows hold, one-sided rows that would close push, and bounded forces act with h times their bounds
at most. Where rows close faster than the forces of one step make them, an impact divides the step
where the first of them closes. What is beyond a one-sided row nevertheless is moved out of it, in
the mass metric. A slip that ends so early in a step that friction would do work along the way
divides the step, too, and so does a body that turns far beside a contact.

Sources: J. J. Moreau, in Nonsmooth Mechanics and Applications, 1988; M. Jean, Comput. Methods
Appl. Mech. Eng. 177 (1999); V. Acary, Comput. Methods Appl. Mech. Eng. 256 (2013), on positions.
"""

import math
from itertools import chain

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.impacts.impact_map import VelocityLevel
from mbd_ros.core.state import Array, State
from mbd_ros.core.time_stepping.position_correction import MovesOut
from mbd_ros.core.time_stepping.step_equations import StepProblems
from mbd_ros.core.time_stepping.step_problem import StepProblem, first_closing
from mbd_ros.core.time_stepping.unilateral_rows import Slots, Which

_IMPACTS = 4  # of one step, which give back; what met rests at once in those after them
_TURNS = 3  # of slips in one step
_TURN = 0.5  # rad, on which rows of a contact change by little
_PARTS = 100  # of a step at most
_SHARES = (0.25, 0.0625, 0.015625)  # of a step, in which a slip that ends early is looked at
_WHOLE = 1.0 - 1.0e-6  # of a step, so that something is left of it
_TOGETHER = 1.0e-6  # of the way of the fastest row in a step: gaps that close at one time
_MOVES = 4  # out of rows; each leaves the square of what the last one left


class VelocityStep(StepProblems):
    """Steps of one system; has a `Data` of its own.

    Args:
        system: The system, under any tier.
        theta: From 1/2, of second order where motion is smooth, to 1, which damps most.

    Attributes:
        giving_way: What solves for rows that give way.
    """

    def __init__(self, system: System, theta: float) -> None:
        super().__init__(system, theta)
        self._level, self._slots = VelocityLevel(system), self._yielding.slots
        self._moves_out = MovesOut(self._mechanism, self._rigid, self._rows)

    def step(self, y: State, u: Array | None, h: float, t: float) -> State:
        """The state of what is integrated at a time t, after a step of length h [s].

        Args:
            y: State at the start.
            u: Inputs; None for safe ones.
            h: Length [s].
            t: Time at the end [s].

        Raises:
            SolveError: Rows contradict one another.
            DivergedError: Forces are not finite.
        """
        self._rows.begin(y.q)
        begun = self._begun(y, u, h)
        parts = self._parts(begun[0])
        if parts == 1:
            return self._stepped(begun, y, u, t, _TURNS)
        part = h / parts
        for left in reversed(range(parts)):
            y = self._stepped(self._begun(y, u, part), y, u, t - left * part, _TURNS)
        return y

    def _parts(self, problem: StepProblem) -> int:
        """Into how many parts a step is divided, so that no body turns far beside a contact."""
        if not problem.acting.cones:
            return 1
        turn = problem.h * max(self._rows.turning(v) for v in (problem.x.v, problem.free))
        return max(1, math.ceil(min(turn / _TURN, _PARTS)))

    def _stepped(
        self, begun: tuple[StepProblem, Which], y: State, u: Array | None, t: float, turns: int
    ) -> State:
        """The state after a part of a step, which slips that end may divide so many times more."""
        problem, closed = begun
        h = problem.h
        met: list[list[int]] = []
        while (hits := problem.hits(closed)).any() and len(met) < _IMPACTS + len(self._slots):
            y, h = self._after_impact(problem, closed, hits, y, met)
            problem, closed = self._begun(y, u, h)
        problem, end = self._solved(problem, closed, y, u)
        turned = self.giving_way.turned(problem, end) if turns else None
        if turned is not None:
            if part := self._until(turned, y, u, h):
                y = self._ended(y, *self._solved(*self._begun(y, u, part), y, u), t - h + part)
                return self._stepped(self._begun(y, u, h - part), y, u, t, turns - 1)
            self.giving_way.accept()
        return self._outside(self._ended(y, problem, end, t))

    def _begun(self, y: State, u: Array | None, h: float) -> tuple[StepProblem, Which]:
        """The problem of a step without impacts, and its rows that would be closed."""
        problem = self._problem(y, u, h)
        return problem, problem.closed()

    def _solved(
        self, problem: StepProblem, closed: Which, y: State, u: Array | None
    ) -> tuple[StepProblem, Array]:
        """The problem with forces on the way to its end, and the velocity there."""
        end = self.giving_way.end(problem, closed, problem.free)
        problem = self._corrected(problem, y, u, end)
        return problem, self.giving_way.end(problem, closed, problem.free, end)

    def _ended(self, y: State, problem: StepProblem, end: Array, t: float) -> State:
        way = problem.h * ((1.0 - self._theta) * problem.x.v + self._theta * end)
        dz = problem.dz(end)
        back = self.giving_way.given_back(problem, end)
        if back is not None:
            energy, ways = self._system.energy, (way, way - back)
            way = min(ways, key=lambda w: energy(self._moved(y, w, end, dz, t)))
        return self._moved(y, way, end, dz, t)

    def _until(self, turned: Slots, y: State, u: Array | None, h: float) -> float:
        """When the first of some slips ends within a step [s]; 0 where none is seen to."""
        for share in _SHARES:
            problem, end = self._solved(*self._begun(y, u, share * h), y, u)
            part = self.giving_way.ending(turned, problem, end)
            if part:
                return part if part < _WHOLE * h else 0.0
        return 0.0

    def _after_impact(
        self, problem: StepProblem, closed: Which, hits: Which, y: State, met: list[list[int]]
    ) -> tuple[State, float]:
        """State after the next impact of a step, and what is left of it [s]; adds to what met."""
        v, gap, rate, h = problem.x.v, problem.gap, problem.rate, problem.h
        end = self.giving_way.pushed(problem, closed & ~hits, problem.free)
        gained = (end - v) / h
        bent = problem.J.dot(gained)
        wait = min(first_closing(gap[hits], rate[hits], bent[hits]), _WHOLE * h)
        at = gap + wait * rate + 0.5 * wait**2 * bent
        touching = closed & (at <= _TOGETHER * h * np.abs(rate[hits]).max())
        met.append(self._slots[problem.acting.at[touching[problem.acting.decides]]].tolist())
        expands = len(met) <= _IMPACTS
        slots = met[-1] if expands else list(chain(*met))
        before = v + wait * gained
        way, dz = 0.5 * wait * (v + before), wait / h * problem.dz(end)
        y = self._moved(y, way, before, dz, y.t + wait)
        v = self._level.impact(self._system.expand(y), slots, expands=expands).v
        return y._replace(v=np.array(self._system.integrated(v))), h - wait

    def _outside(self, y: State) -> State:
        """The state with no one-sided row beyond 0, moved the least in the mass metric."""
        if not self._rows.are_one_sided:
            return y
        for _ in range(_MOVES):
            x = self._system.expand(y)
            way = self._moves_out.way(x)
            if way is None:
                break
            y = self._moved(y, way, x.v, 0.0 * y.z, y.t)
        return y

    def _moved(self, y: State, way: Array, v: Array, dz: Array, t: float) -> State:
        """A state of what is integrated, after a way and with a velocity of all joints."""
        system = self._system
        q = system.chart.integrate(y.q, system.integrated(way))
        z = system.internals.inside(y.z + dz)
        self._rows.moved(q, way)
        return State(t, q, np.array(system.integrated(v)), z, y.mode)
