"""The force that lacks for the equation of motion, for methods that solve for accelerations."""

from typing import Any

from mbd_ros.core.dynamics.linearization import Linearization
from mbd_ros.core.state import Array


class Balance:
    """f = tau - h - M a + J' lam at given accelerations and multipliers, and its slopes.

    Slopes are differences, to about 1e-6.

    Args:
        system: A `System`, or an `Extended` one, whose rates are accelerations of mass 1.
    """

    def __init__(self, system: Any) -> None:
        self._system, self._kept = system, system.held
        self._linearization = Linearization(system, self._write)

    def force(self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array) -> Array:
        """The f, shape (nv,).

        Args:
            t: Time [s].
            q: Configuration of what is integrated.
            v: Its velocity.
            u: Inputs, as for `System.evaluate`.
            a: Accelerations, shape (nv,).
            lam: Multipliers of the rows that are held.
        """
        system = self._system
        force: Array = system.applied(t, q, v, u) - system.mass(q).dot(a)
        return force + lam.dot(self._kept.jacobian(t, q)) if self._kept.rows else force

    def slopes(
        self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array
    ) -> tuple[Array, Array]:
        """Of f by steps in the tangent of q and by v, each of shape (nv, nv)."""
        self._at = a, lam
        self._linearization.update(t, q, v, u)
        return self._linearization.stiffness, self._linearization.damping

    def _write(self, t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
        out[...] = self.force(t, q, v, u, *self._at)


def balance_of(system: Any) -> Any:
    """The balance of a system that has one of its own, else one by differences."""
    own = getattr(system, "balance", None)
    return Balance(system) if own is None else own(system)
