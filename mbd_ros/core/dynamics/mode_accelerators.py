"""The functions that write accelerations and rates, one a mode."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.dynamics.free_motion import FreeMotion
from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.state import Array, Mode, State

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.event_rows import ExactRows


class ModeAccelerators:
    """Accelerators of a `ComposedSystem`, made once a mode.

    Args:
        motion: Accelerations without rows that give way.
        bounded: Rows that are solved for in every evaluation.
        exact: Rows that are on or off by the mode.
        internals: The internal states of all parts.
        rates: Rates of internal states at a state of all joints.
    """

    def __init__(
        self,
        motion: FreeMotion,
        bounded: BoundedRows | None,
        exact: "ExactRows | None",
        internals: Internals,
        rates: Callable[[State, Array | None], Array],
    ) -> None:
        self._motion, self._mechanism = motion, motion.mechanism
        self._bounded, self._exact = bounded, exact
        self._internals, self._rates = internals, rates
        self._made = dict[Mode, Accelerator]()

    def of(self, mode: Mode) -> Accelerator:
        """The function that writes y'' in a mode, and z' with internal states."""
        if mode not in self._made:
            self._made[mode] = self._written(mode)
        return self._made[mode]

    def _written(self, mode: Mode) -> Accelerator:
        mechanism, write = self._mechanism, self._without_exact()
        if self._exact is not None and not self._exact.is_idle(mode):
            write = self._with_exact(self._exact, mode)
        if self._internals.nz:
            return self._with_rates(write, mode)
        if not mode or mechanism.loads.is_empty:  # nobody reads the mode
            return write

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            mechanism.mode = mode
            try:
                write(t, q, v, u, out)
            finally:
                mechanism.mode = ()

        return accelerate

    def _with_rates(self, write: Accelerator, mode: Mode) -> Accelerator:
        mechanism, inside, rates = self._mechanism, self._internals.inside, self._rates
        expand, is_constant = self._motion.coordinates.expand, self._internals.is_constant

        def accelerate(
            t: float, q: Array, v: Array, z: Array, u: Array | None, a_out: Array, z_out: Array
        ) -> None:
            before = mechanism.mode, mechanism.z
            mechanism.mode, mechanism.z = mode, inside(z)
            try:
                if is_constant:
                    z_out[...] = 0.0
                else:
                    z_out[...] = rates(expand(State(t, q, v, mechanism.z, mode)), u)
                write(t, q, v, u, a_out)
            finally:
                mechanism.mode, mechanism.z = before

        return accelerate

    def _with_exact(self, exact: "ExactRows", mode: Mode) -> Accelerator:
        motion, pushed = self._motion, exact.pushing(mode)

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            a = motion.accelerate(t, q, v, u)
            if pushed is None:
                out[...] = exact.accelerate(t, q, v, a, mode, splits=False)
            else:
                out[...] = pushed(t, q, v, a)

        return accelerate

    def _without_exact(self) -> Accelerator:
        motion, bounded = self._motion, self._bounded
        if bounded is None:
            return motion.accelerator()

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            a = motion.accelerate(t, q, v, u)
            out[...] = bounded.accelerate(motion, t, q, v, a)

        return accelerate
