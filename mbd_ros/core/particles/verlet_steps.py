"""RATTLE and SHAKE of points: rows of a molecule are solved side by side in all molecules."""

import math

import numpy as np

from mbd_ros.core.integration.step_length import clip
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.particles.cluster import Cluster
from mbd_ros.core.particles.particle_system import ParticleSystem
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, SolveError


class ParticleVerlet(Stepper):
    """Velocity Verlet with multipliers.

        w  = v + h/2 M^-1 f(q) + M^-1 J(q)' mu,      g(q+) = 0,   q+ = q + h w
        v+ = w + h/2 M^-1 f(q+) + M^-1 J(q+)' nu,    J(q+) v+ = 0

    Unprojected velocities leave nu out: positions are the same, since mu of the next step takes
    up what nu would have.

    Args:
        system: The points.
        tolerance: |g| in sizes of the rows that may be left.
        dt: Step.
        projects: Whether velocities are moved onto the rows.
    """

    kept = ("_last",)

    def __init__(
        self,
        system: ParticleSystem,
        tolerance: float,
        dt: float,
        *,
        projects: bool = True,
    ) -> None:
        self._points, self._tolerance, self._dt = system, tolerance, dt
        self._projects = projects
        self.restart()

    def restart(self) -> None:
        """Forget the forces of the last configuration."""
        self._last: tuple[State | None, Array] = (None, np.zeros(0))

    def step(self, x: State, u: Array | None = None, end: float = math.inf) -> State:
        """Advance by one step.

        Raises:
            DivergedError: Rows of a molecule cannot be closed; names them.
        """
        h, t = clip(x.t, self._dt, end)
        last, force = self._last
        if last is not x:
            force = self._points.applied(x.t, x.q, x.v)
        half = 0.5 * h
        v = x.v + half * self._points.mass(x.q).solve(force)
        q = x.q + h * v
        self._close(x, q, v, h)
        force = self._points.applied(t, q, v)
        v += half * self._points.mass(q).solve(force)
        if self._projects:
            parts = zip(self._points.kinds, *map(self._points.split, (q, v)), strict=True)
            for kind, position, velocity in parts:
                kind.project(position, velocity)
        y = State(t, q, v)
        self._last = y, force
        return y

    def _close(self, x: State, q: Array, v: Array, h: float) -> None:
        parts = zip(self._points.kinds, *map(self._points.split, (x.q, q, v)), strict=True)
        for kind, before, moved, w in parts:
            for cluster in kind.clusters:
                self._close_one(kind.name, cluster, (before, moved, w), x.t, h)

    def _close_one(
        self, name: str, cluster: Cluster, arrays: tuple[Array, Array, Array], t: float, h: float
    ) -> None:
        try:
            cluster.close(*arrays, h, self._tolerance)
        except SolveError as error:
            raise DivergedError(
                f"no step from t = {t:.9g} by {h:g} ends on the rows of {name}: {error}; "
                "try a smaller dt"
            ) from error


class ParticleShake(ParticleVerlet):
    """Positions of RATTLE; velocities (q_{n+1} - q_{n-1}) / 2h, the means of both half steps.

    The position after the next one is solved for ahead; a step after a restart costs two.

    Args:
        system: The points.
        tolerance: As for `ParticleVerlet`.
        dt: Step.
    """

    def __init__(self, system: ParticleSystem, tolerance: float, dt: float) -> None:
        super().__init__(system, tolerance, dt, projects=False)

    def restart(self) -> None:
        """Forget the half step that was solved ahead."""
        super().restart()
        self._ahead: tuple[State | None, float, Array, Array] = (None, 0.0, *2 * (np.zeros(0),))

    kept = ("_ahead",)

    def step(self, x: State, u: Array | None = None, end: float = math.inf) -> State:
        """Advance by one step; errors as for `ParticleVerlet.step`."""
        h, t = clip(x.t, self._dt, end)
        last, length, w, q = self._ahead
        if last is not x or length != h:
            w, q = self._moved(x, x.v, 0.5 * h, h)
        middle = State(t, q, w)
        w_next, q_next = self._moved(middle, w, h, h)
        y = State(t, q, 0.5 * (w + w_next))
        self._ahead = y, h, w_next, q_next
        return y

    def _moved(self, x: State, v: Array, kick: float, h: float) -> tuple[Array, Array]:
        """Velocity of the half step, and the positions it leads to."""
        force = self._points.applied(x.t, x.q, v)
        w = v + kick * self._points.mass(x.q).solve(force)
        q = x.q + h * w
        self._close(x, q, w, h)
        return w, q
