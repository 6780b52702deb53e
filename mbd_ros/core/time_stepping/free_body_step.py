"""Steps of velocities with free bodies, whose axes turn within a step.

A velocity v of a free body stands in its own axes, so that it changes where the body turns:
v' = R' a - w x v. A step that counts this as a change of the motion errs by (w h)^2 of the
velocity of a ball that spins. Here the linear velocities of a step stand in the axes of its
intermediate state, where free bodies keep them.
"""

from mbd_ros.core.dynamics.free_bodies import FreeBodies
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.time_stepping.step_problem import StepProblem
from mbd_ros.core.time_stepping.time_step import VelocityStep


class FreeBodyStep(VelocityStep):
    """Steps of one system with free bodies; has a `Data` of its own.

    Args:
        system: The system, under any tier.
        theta: As for all systems.
    """

    def __init__(self, system: System, theta: float) -> None:
        super().__init__(system, theta)
        self._bodies, self._integrated = FreeBodies(system.model), FreeBodies(system.chart.model)
        self._q = system.robot.neutral()
        self._axes = self._bodies.axes(self._q)

    def _on_the_way(self, y: State, h: float) -> State:
        """State of all joints at the intermediate time, with the velocity of y."""
        before = self._axes = self._integrated.axes(y.q)
        x = self._between(y, y.v, y.z, h)
        self._axes, self._q = self._bodies.axes(x.q), x.q
        return x._replace(v=self._bodies.turned(x.v, before, self._axes))

    def _between(self, y: State, v: Array, z: Array, h: float) -> State:
        """State of all joints at the intermediate time, of a step with that mean velocity of y."""
        share, system = self._theta * h, self._system
        q = self._integrated.moved(system.chart, y.q, share * v, self._axes)
        return system.expand(State(y.t + share, q, v, z))

    def _force(self, x: State, u: Array | None, M: Array) -> Array:
        """Generalized force of all joints that changes velocities as a step counts them."""
        bodies, axes = self._bodies, self._axes
        turning: Array = M.dot(bodies.turning(x.v))
        if x.q is self._q:
            return super()._force(x, u, M) + turning
        own = bodies.axes(x.q)
        force = super()._force(x._replace(v=bodies.turned(x.v, axes, own)), u, M)
        return bodies.turned(force, own, axes) + turning

    def _drift(self, x: State, J: Array, drift: Array) -> Array:
        """The part of g'' without the change of velocities as a step counts them."""
        left: Array = drift - J.dot(self._bodies.turning(x.v))
        return left

    def _moved(self, y: State, way: Array, v: Array, dz: Array, t: float) -> State:
        """A state of what is integrated, after a way and with a velocity of all joints."""
        system, bodies = self._system, self._integrated
        q = bodies.moved(system.chart, y.q, system.integrated(way), self._axes)
        self._rows.moved(q, way)
        v = bodies.turned(system.integrated(v), self._axes, bodies.axes(q))
        return State(t, q, v, system.internals.inside(y.z + dz), y.mode)

    def _ended(self, y: State, problem: StepProblem, end: Array, t: float) -> State:
        """The state at the end of a step; other steps may have been tried since its problem."""
        self._axes = self._bodies.axes(problem.x.q)
        return super()._ended(y, problem, end, t)

    def _outside(self, y: State) -> State:
        """The state with no one-sided row beyond 0, moved the least in the mass metric."""
        self._axes = self._integrated.axes(y.q)
        return super()._outside(y)
