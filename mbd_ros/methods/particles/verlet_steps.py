"""RATTLE and SHAKE of points, all molecules of a kind side by side."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import DivergedError, SolveError
from mbd_ros.methods.integration.stepping import Stepper, clip
from mbd_ros.methods.particles.molecules import Molecules
from mbd_ros.methods.particles.particle_system import ParticleSystem


class ParticleVerlet(Stepper):
    """Velocity Verlet with multipliers.

        w  = v + h/2 M^-1 f(q) + M^-1 J(q)' mu,      g(q+) = 0,   q+ = q + h w
        v+ = w + h/2 M^-1 f(q+) + M^-1 J(q+)' nu,    J(q+) v+ = 0

    Unprojected velocities leave nu out: positions are the same, since mu of the next step takes
    up what nu would have.

    Args:
        tolerance: |g| in sizes of the rows that may be left.
        projects: Whether velocities are moved onto the rows.
    """

    def __init__(
        self,
        system: ParticleSystem,
        tolerance: float,
        dt: float,
        *,
        projects: bool = True,
    ) -> None:
        self._points, self._dt = system, dt
        steps = system.steps or KindSteps
        self._steps: list[KindSteps] = [steps(k, tolerance, projects) for k in system.kinds]
        self.restart()

    def restart(self) -> None:
        """Forget the last state and its forces."""
        self._last: State | None = None
        self._lanes: list[tuple[Array, Array]] = []
        self._force: Sequence[Array | None] = ()

    def step(self, x: State, u: Array | None = None, end: float = math.inf) -> State:
        """Advance by one step.

        Raises:
            DivergedError: Rows of a molecule cannot be closed; names them.
        """
        self._load(x)
        h, t = clip(x.t, self._dt, end)
        self._step_lanes(x.t, h)
        return self._unload(t)

    def advance(self, x: State, due: float) -> State:
        """Advance to a time in as many steps as that takes; errors as for `step`."""
        nearly = due - max(SAME_TIME * self._dt, 2.0 * math.ulp(due))
        if not x.t < nearly:
            return x
        self._load(x)
        t = x.t
        while t < nearly:
            h, after = clip(t, self._dt, due)
            self._step_lanes(t, h)
            t = after
        return self._unload(t)

    def _load(self, x: State) -> None:
        """Takes up a state, unless it is the last one."""
        if x is not self._last:
            pairs = zip(self._points.split(x.q), self._points.split(x.v), strict=True)
            self._lanes = [(np.array(q, order="C"), np.array(v, order="C")) for q, v in pairs]
            self._force = self._points.forces([q for q, _ in self._lanes])

    def _unload(self, t: float) -> State:
        q, v = (self._points.joined([pair[i] for pair in self._lanes]) for i in (0, 1))
        self._last = State(t, q, v)
        return self._last

    def _step_lanes(self, t: float, h: float) -> None:
        """One step of the lanes."""
        half = 0.5 * h
        self._move(t, half, h)
        self._force = self._points.forces([q for q, _ in self._lanes])
        for steps, (q, v), force in zip(self._steps, self._lanes, self._force, strict=True):
            steps.finish(q, v, force, half)

    def _move(self, t: float, kick: float, h: float) -> None:
        parts = zip(self._steps, self._lanes, self._force, strict=True)
        moved = []
        for steps, (q, v), force in parts:
            try:
                moved.append((steps.move(q, v, force, kick, h), v))
            except SolveError as error:
                raise DivergedError(
                    f"no step from t = {t:.9g} by {h:g} ends on the rows of {steps.kind.name}: "
                    f"{error}; try a smaller dt"
                ) from error
        self._lanes = moved


class ParticleShake(ParticleVerlet):
    """Positions of RATTLE; velocities (q_{n+1} - q_{n-1}) / 2h, the means of both half steps.

    The position after the next one is solved for ahead; a step after a restart costs two.

    Args:
        tolerance: As for `ParticleVerlet`.
    """

    def __init__(self, system: ParticleSystem, tolerance: float, dt: float) -> None:
        super().__init__(system, tolerance, dt, projects=False)

    def restart(self) -> None:
        """Forget the half step that was solved ahead."""
        super().restart()
        self._ahead = 0.0

    def step(self, x: State, u: Array | None = None, end: float = math.inf) -> State:
        """Advance by one step; errors as for `ParticleVerlet.step`."""
        h, t = clip(x.t, self._dt, end)
        if x is not self._last or self._ahead != h:
            self._load(x)
            self._move(x.t, 0.5 * h, h)
        q = self._points.joined([q for q, _ in self._lanes])
        w = self._points.joined([v for _, v in self._lanes])
        self._force = self._points.forces([q for q, _ in self._lanes])
        self._move(t, h, h)
        w_next = self._points.joined([v for _, v in self._lanes])
        self._last, self._ahead = State(t, q, 0.5 * (w + w_next)), h
        return self._last

    def advance(self, x: State, due: float) -> State:
        """Advance to a time in as many steps as that takes; errors as for `step`."""
        nearly = due - max(SAME_TIME * self._dt, 2.0 * math.ulp(due))
        while x.t < nearly:
            x = self.step(x, None, due)
        return x


def run(
    system: ParticleSystem,
    stepper: ParticleVerlet,
    x: State,
    duration: float,
    dt: float,
    every: int = 1,
) -> Iterator[State]:
    """States, the first one included; a last shorter interval ends exactly at the end.

    Args:
        x: State on the rows.
        duration: Time from the first state to the last.
        every: Steps from one state to the next.

    Raises:
        DivergedError: A state is not finite, or rows of a molecule cannot be closed.
    """
    origin, end = x.t, x.t + duration
    yield x
    for k in range(1, sample_count(duration, dt, every) + 1):
        due = min(origin + k * every * dt, end)
        x = stepper.advance(x, due)
        if not (math.isfinite(x.q.dot(x.q)) and math.isfinite(x.v.dot(x.v))):
            bad = np.flatnonzero(~np.isfinite(x.q + x.v))
            name = system.names[int(bad[0]) // 3] if len(bad) else system.names[0]
            raise DivergedError(f"the state of {name} is not finite at t = {x.t:.9g}")
        yield x


def sample_count(duration: float, dt: float, every: int) -> int:
    """How many samples follow the first one."""
    return math.ceil(duration / (dt * every) - SAME_TIME)


class KindSteps:
    """Half steps of the molecules of one kind, on arrays of shape (atoms, 3, lanes).

    Args:
        tolerance: |g| in sizes of the rows that may be left.
        projects: Whether velocities are moved onto the rows.
    """

    def __init__(self, kind: Molecules, tolerance: float, projects: bool) -> None:
        self.kind, self._tolerance, self._projects = kind, tolerance, projects

    def move(self, x: Array, v: Array, force: Array | None, kick: float, h: float) -> Array:
        """Kicks the velocities, which are written; the places they lead to, on the rows.

        Raises:
            SolveError: Rows cannot be closed.
        """
        if force is not None:
            v += kick * self.kind.accelerations(force)
        moved: Array = h * v
        moved += x
        for cluster in self.kind.clusters:
            cluster.close(x, moved, v, h, self._tolerance)
        return moved

    def finish(self, x: Array, v: Array, force: Array | None, kick: float) -> None:
        """Kicks the velocities and moves them onto the rows; v is written."""
        if force is not None:
            v += kick * self.kind.accelerations(force)
        if self._projects:
            self.kind.project(x, v)
