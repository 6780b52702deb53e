"""A system, an integrator and a stabilization at work."""

import math
from collections.abc import Iterator

import numpy as np

from mbd_ros.core.dynamics.mass_check import check_mass
from mbd_ros.core.dynamics.overshoots import Overshoots
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.projection.assembly import assemble
from mbd_ros.core.projection.stabilizing import Stabilization
from mbd_ros.core.simulation.input_course import InputCourse
from mbd_ros.core.simulation.stall import PATIENCE, WINDOW, Notice, StallWatch, refuse_crawl
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import DivergedError, ModelError, SolveError

_SHOWN = 8  # joints in a message
_IN_REACH = 1.0e6  # rad or m: where a mass matrix still says something of the robot
_STRIDE = 16  # steps after which a state must be finite


class Simulation:
    """Predicts motion from forces and commands.

    Args:
        system: The system; its rows are corrected as the stabilization demands.
        integrator: The method.
        stabilization: What keeps the rows; idle where the integrator keeps them itself.
        dt: Step of a fixed-step method, and interval of the output [s], > 0.

    Attributes:
        steps: Steps taken so far.
        worst: Largest condition number of the rows after a step, inf where they are redundant,
            and its time [s]. Beyond some 1e6, near a toggle, multipliers are unreliable.
        overshoots: How far joints went beyond their stops; None without any.
    """

    def __init__(
        self, system: System, integrator: Integrator, stabilization: Stabilization, dt: float
    ) -> None:
        if not dt > 0:
            raise ModelError(f"dt {dt:g} s must be > 0")
        self.system, self.integrator, self.dt = system, integrator, dt
        self.stabilization = stabilization
        system.correct_rows(*stabilization.gains(dt))
        self.stepper = integrator.prepare(system, dt)
        self._stride = getattr(self.stepper, "stride", None)  # several steps at once, if it can
        self.steps = 0
        self.worst = (1.0, 0.0)
        has_stops = any(block.part.stops for block in system.layout.yielding)
        self.overshoots = Overshoots(system) if has_stops else None
        self._is_corrected = bool(system.rows) and not integrator.keeps_constraints

    def start(self, x: State) -> State:
        """The nearest consistent state of the integrated coordinates to a state of all joints.

        Raises:
            SolveError: The mechanism cannot be assembled near it, or its mass matrix is singular.
        """
        self.stepper.restart()
        y = self.system.reduce(x)
        check_mass(self.system, y.q)
        if self.system.rows:
            y = assemble(self.system, y)
            check_mass(self.system, y.q)
        if self.overshoots is not None:
            self.overshoots.begin(y)
        return y

    def run(
        self,
        x: State,
        duration: float,
        notice: Notice | None = None,
    ) -> Iterator[State]:
        """States of all joints every dt, the first one included; steps end where inputs jump.

        Args:
            x: State of all joints; moved onto the constraints first.
            duration: [s], >= 0; a last shorter interval ends exactly there.
            notice: Is called once where steps are so short that the end is far away.

        Raises:
            DivergedError: The state is no longer finite, or steps are too short to get to the end.
            SolveError: The mechanism cannot be assembled, or equations contradict one another.
        """
        y = self.start(x)
        yield self.system.expand(y)
        begin, count = y.t, math.ceil(duration / self.dt - SAME_TIME)
        last, k = begin + duration, 1
        resolution = 2.0 * math.ulp(max(abs(begin), abs(last)))
        slack = max(SAME_TIME * self.dt, resolution)
        watch, look_at = StallWatch(self.system, self.dt, notice), self.steps + WINDOW
        watch.begin(begin)
        inputs = InputCourse(self.system.loads.sources, begin, last, self.dt, slack)
        while k <= count:
            due = min(begin + k * self.dt, last)
            late = abs(begin + (k - 1) * self.dt - y.t)
            is_rounded = 0.2 * slack < late < 1.0e3 * slack  # a sum of steps, to be put right
            is_off = inputs.now > begin + (k - 1) * self.dt + slack  # back to the outputs
            end = min(due if is_rounded or is_off else last, inputs.end)
            y_next = self._step(y, inputs.u, end)
            if self.steps >= look_at:
                watch.look(y_next, inputs.u, last)
                look_at = self.steps + WINDOW
            if 0.0 < abs(y_next.t - due) <= resolution == slack:  # late times are coarse
                y_next = y_next._replace(t=due)
                self.stepper.continue_from(y_next)
            while k <= count and due < y_next.t - slack:
                yield self.system.expand(self._corrected(self.stepper.interpolate(due)))
                k += 1
                due = min(begin + k * self.dt, last)
            y = self._corrected(y_next)
            if y is not y_next:
                self.stepper.continue_from(y)
            if k <= count and due <= y.t + slack:
                yield self.system.expand(y)
                k += 1
            inputs.reach(y.t)

    def advance(self, y: State, u: Array | None, due: float) -> State:
        """State of the integrated coordinates at a time, in as many steps as the method needs.

        Args:
            y: What `start` or the last `advance` returned.
            u: Commands, held until then.
            due: [s]; y itself at or after it.

        Raises:
            DivergedError: The state is no longer finite.
            SolveError: Equations contradict one another.
        """
        is_looked_at = self._is_corrected or self.overshoots is not None
        nearly = due - max(SAME_TIME * self.dt, 2.0 * math.ulp(due))
        begin, first, look_at = y.t, self.steps, self.steps + PATIENCE * WINDOW
        while y.t < nearly:
            if self.steps >= look_at:
                refuse_crawl(self.system, y, u, (y.t - begin) / (self.steps - first), self.dt, due)
                look_at = self.steps + WINDOW
            y_next = self._step(y, u, due, 1 if is_looked_at else _STRIDE)
            y = self._corrected(y_next)
            if y is not y_next:
                self.stepper.continue_from(y)
        return y

    def passed_stops(self) -> list[str]:
        """Joints that went beyond stops since the start, one text each."""
        return [] if self.overshoots is None else [str(one) for one in self.overshoots.found()]

    def _corrected(self, y: State) -> State:
        if not self._is_corrected:
            return y
        corrected = self.stabilization.correct(self.system, y)
        if self.system.condition > self.worst[0]:
            self.worst = self.system.condition, y.t
        return corrected

    def _step(self, y: State, u: Array | None, end: float, most: int = 1) -> State:
        """One step, or up to `most` that nothing looks at in between."""
        try:
            if most == 1 or self._stride is None:
                after, count = self.stepper.step(y, u, end), 1
            else:
                after, count = self._stride(y, u, end, most)
        except (DivergedError, SolveError) as error:
            raise type(error)(f"{error}; {last_finite(self.system, y)}") from error
        self.steps += count
        if math.isfinite(after.v.dot(after.v)) and math.isfinite(after.q.dot(after.q)):
            if self.overshoots is not None:
                self.overshoots.look(y, after)
            return after
        raise DivergedError(
            f"diverged at t = {after.t:.9g} s: {_lost(after)}; {last_finite(self.system, y)}; "
            f"{self._advice(y)}"
        )

    def _advice(self, y: State) -> str:
        try:
            if np.abs(y.q).max(initial=0.0) < _IN_REACH:  # else rounding speaks, not the robot
                check_mass(self.system, y.q)
        except SolveError as error:
            return str(error)
        return "try a smaller dt"


def _lost(after: State) -> str:
    lost = int(np.count_nonzero(~np.isfinite(after.v)))
    if lost:
        return f"{lost} of {len(after.v)} velocities are not finite"
    return "positions or velocities are beyond all numbers"


def last_finite(system: System, y: State) -> str:
    """The fastest joint, time and positions of the last finite state."""
    x, joints = system.expand(y), system.robot.joints
    wild = max(joints, key=lambda joint: abs(float(x.v[joint.v])))
    values = ", ".join(f"{j.name} {x.q[j.q]:.4g}" for j in joints[:_SHOWN])
    return (
        f"last finite state at t = {y.t:.9g} s: fastest joint {wild.name} with "
        f"{x.v[wild.v]:.3g}/s; positions {values}{', ..' if len(joints) > _SHOWN else ''}"
    )
