"""SHAKE: Verlet on position constraints."""

import math
from typing import Any, Literal

from mbd_ros.core.state import Array, Memory, State, have_same_bits
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.constrained_verlet import ConstrainedVerlet, PositionStep
from mbd_ros.methods.integration.newton import refuse_bounded_rows, refuse_rows_of_velocities
from mbd_ros.methods.integration.stepping import Integrator, Stepper, clip


class Shake(Integrator):
    """Second order, g = 0 after every step; the velocities violate J v = 0 by O(h^2).

    With constant masses and forces f(q) this is Verlet with multipliers,

        q_{n+1} - 2 q_n + q_{n-1} = h^2 M^-1 (f(q_n) + J(q_n)' lam_n),   g(q_{n+1}) = 0
        v_n = (q_{n+1} - q_{n-1}) / (2 h)

    whose positions are those of RATTLE. v_n needs the positions of the next step, which are solved
    for ahead and used then; a step after a restart therefore costs two. Scenes of particles may
    have `unprojected` velocities instead, those of RATTLE without its last projection, whose
    positions are the same. For other robots q_{n+1} =
    q_n (+) h w_{n+1/2}, v_n is the mean of both w, and f(q_n, v_n) comes by iteration; the method
    is of second order and time-reversible (if the forces are), but not symplectic. One-sided rows
    and rows of velocities are refused.

    Args:
        tolerance: |g| from which one more correction is the last [m, rad].
        velocity: `central` as above, or `unprojected`, for particles alone.

    Source: Ryckaert, Ciccotti, Berendsen, J. Comput. Phys. 23, 1977, 327-341; Leimkuhler, Skeel,
        J. Comput. Phys. 112, 1994, 117-125.
    """

    order = 2
    keeps_constraints = True
    stable = 2.0
    example: dict[str, Any] = {}

    def __init__(
        self,
        *,
        tolerance: float = 1.0e-13,
        velocity: Literal["central", "unprojected"] = "central",
    ) -> None:
        if not 0.0 < tolerance < 1.0:
            raise ModelError(f"tolerance {tolerance:g}, accepted: between 0 and 1")
        self.tolerance = tolerance
        self.velocity = velocity

    def prepare(self, system: Any, dt: float) -> Stepper:
        """Return a stepper for one system and one step size [s].

        Raises:
            ModelError: The system has one-sided rows, or rows of velocities.
        """
        if self.velocity != "central":
            raise ModelError(
                f"shake: velocity {self.velocity} is for particles; accepted: central"
            )
        refuse_bounded_rows(system, "shake")
        refuse_rows_of_velocities(system, "shake")
        return _Steps(system, self.tolerance, dt)

    def prepare_particles(self, system: Any, dt: float) -> Any:
        """Return the stepper for a system of particles and one step size [s]."""
        from mbd_ros.methods.particles.verlet_steps import ParticleShake, ParticleVerlet

        if self.velocity == "unprojected":
            return ParticleVerlet(system, self.tolerance, dt, projects=False)
        return ParticleShake(system, self.tolerance, dt)


class _Steps(Stepper):
    checkpoint_fields = ("_ahead",)

    def __init__(self, system: Any, tolerance: float, dt: float) -> None:
        self._system = system
        self._dt = dt
        self._verlet = ConstrainedVerlet(system, "SHAKE", tolerance)
        self.restart()

    def restart(self) -> None:
        """Forget the half-step that was solved ahead."""
        self._ahead: tuple[Any, ...] = (None, None, None, None, None)
        self._verlet.restart()

    def checkpoint(self) -> Memory:
        """Return the half-step that was solved ahead, and the last corrections."""
        return {**super().checkpoint(), "verlet": self._verlet.checkpoint()}

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Take up what an earlier step has kept, the corrections of its Verlet steps included."""
        super().restore({name: checkpoint[name] for name in self.checkpoint_fields}, x)
        self._verlet.restore(checkpoint["verlet"])

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step."""
        h, t = clip(x.t, self._dt, end)
        y, last_u, h_then, w, q = self._ahead
        if x is not y or not have_same_bits(u, last_u) or h != h_then:
            force = self._system.applied(x.t, x.q, x.v, u)
            w, q = self._verlet.advance(x, u, PositionStep(h, t), 0.5 * h, 0.0, force)
        middle = State(t, q, w)
        force = self._system.applied(t, q, w, u)
        w_next, q_next = self._verlet.advance(middle, u, PositionStep(h, t + h), h, 0.5, force)
        y = State(t, q, 0.5 * (w + w_next))
        self._ahead = (y, None if u is None else u.copy(), h, w_next, q_next)
        return y
