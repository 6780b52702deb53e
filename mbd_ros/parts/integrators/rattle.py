"""RATTLE: velocity Verlet on position and velocity constraints."""

import math
from typing import Any

from mbd_ros.core.state import Array, Memory, State, have_same_bits
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.constrained_verlet import ConstrainedVerlet, PositionStep
from mbd_ros.methods.integration.newton import refuse_bounded_rows, refuse_rows_of_velocities
from mbd_ros.methods.integration.stepping import Integrator, Stepper, clip


class Rattle(Integrator):
    """Second order and time-reversible, both g = 0 and J v + dg/dt = 0 after every step.

        w  = v + h/2 M(q)^-1 f(q, w) + M(q)^-1 J(q)' mu,       g(q+) = 0,   q+ = q (+) h w
        v+ = w + h/2 M(q+)^-1 f(q+, w) + M(q+)^-1 J(q+)' nu,   J(q+) v+ + dg/dt = 0

    with f = tau - h. With constant masses and forces f(q), as for point masses on prismatic
    joints, it is the classic scheme, explicit but for the multipliers and symplectic: the energy
    error stays bounded for ever. For other robots w is found by iteration; the method is still of
    second order and time-reversible (if the forces are), but not symplectic: the energy of
    reversible motion usually stays bounded, which is no theorem. Stiff dampers need another
    method. Without rows it is velocity Verlet. One-sided rows and
    rows of velocities are refused.

    Args:
        tolerance: |g| from which one more correction is the last [m, rad].

    Source: Andersen, J. Comput. Phys. 52, 1983, 24-34; Leimkuhler, Skeel, J. Comput. Phys. 112,
        1994, 117-125; Hairer, Lubich, Wanner, Geometric Numerical Integration, sec. VII.1.4.
    """

    order = 2
    keeps_constraints = True
    native = "rattle"
    stable = 2.0
    example: dict[str, Any] = {}

    def __init__(self, *, tolerance: float = 1.0e-13) -> None:
        if not 0.0 < tolerance < 1.0:
            raise ModelError(f"tolerance {tolerance:g}, accepted: between 0 and 1")
        self.tolerance = tolerance

    def prepare(self, system: Any, dt: float) -> Stepper:
        """Return a stepper for one system and one step size [s].

        Raises:
            ModelError: The system has one-sided rows, or rows of velocities.
        """
        refuse_bounded_rows(system, "rattle")
        refuse_rows_of_velocities(system, "rattle")
        return _Steps(system, self.tolerance, dt)

    def prepare_particles(self, system: Any, dt: float) -> Any:
        """Return the stepper for a system of particles and one step size [s]."""
        from mbd_ros.methods.particles.verlet_steps import ParticleVerlet

        return ParticleVerlet(system, self.tolerance, dt)


class _Steps(Stepper):
    checkpoint_fields = ("_last",)

    def __init__(self, system: Any, tolerance: float, dt: float) -> None:
        self._system = system
        self._dt = dt
        self._verlet = ConstrainedVerlet(system, "RATTLE", tolerance)
        self._has_rows = bool(system.rows)
        self.restart()

    def restart(self) -> None:
        """Forget rows and force of the last configuration."""
        self._last: tuple[Any, ...] = (None, None, None)
        self._verlet.restart()

    def continue_from(self, x: State) -> None:
        """Continue from the last state, at a time without rounding."""
        self._last = (x, *self._last[1:])

    def checkpoint(self) -> Memory:
        """Return the force and corrections of the last step."""
        return {**super().checkpoint(), "verlet": self._verlet.checkpoint()}

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Take up what an earlier step has kept, the corrections of its Verlet steps included."""
        super().restore({name: checkpoint[name] for name in self.checkpoint_fields}, x)
        self._verlet.restore(checkpoint["verlet"])

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step."""
        move = PositionStep(*clip(x.t, self._dt, end))
        last, last_u, force = self._last
        if x is not last or not have_same_bits(u, last_u):
            force = self._system.applied(x.t, x.q, x.v, u)
        half = 0.5 * move.h
        w, q = self._verlet.advance(x, u, move, half, 1.0, force)
        there = self._verlet.at(move.t, q)
        force = self._system.applied(move.t, q, w, u)
        v = w + half * there.respond(force)
        y = State(move.t, q, there.project(v) if self._has_rows else v)
        self._last = (y, None if u is None else u.copy(), force)
        return y
