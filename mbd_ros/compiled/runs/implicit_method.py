"""Implicit methods in Python whose accelerations and exact derivatives are native code.

Compiled derivatives are held against differences of the plain tier before they are used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import Library, load
from mbd_ros.compiled.build.verify import plain_rates, some_inputs, some_state, verify
from mbd_ros.compiled.code.emit import emitted
from mbd_ros.compiled.runs.compiled_method import NativeMethod, Say, silent
from mbd_ros.compiled.runs.compiled_system import CompiledSystem
from mbd_ros.compiled.symbols.trace import Traced, trace
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.dynamics.internal_dynamics import Extended
from mbd_ros.core.dynamics.linearization import Balance
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import MbdError
from mbd_ros.methods.integration.stepping import Stepper
from mbd_ros.methods.simulation.checked_steps import event_sources, prepare_stepper

_SEED = 22
_STEP = 1.0e-4  # along a direction of length 1: differences are good to 1e-6
_CLOSE = 1.0e-4  # of the largest; wrong code is wrong by more
_SMOOTH = 1.0e-5  # of the largest: where steps of two lengths agree, there is a slope
Field = Callable[[State], Array]
EXACT = "accelerate", "derivatives"  # what exact derivatives of a system need


class ImplicitMethod(NativeMethod):
    """The steps of a method that solves by Newton's method, over a compiled system."""

    is_explicit = False

    @property
    def keeps_constraints(self) -> bool:  # type: ignore[override]
        """Whether the method keeps constraints by itself."""
        return self.method.keeps_constraints

    def refuse(self, system: Any) -> None:
        """Refuse what stops steps.

        Raises:
            Untraceable: Names it.
        """
        names = [name for names in event_sources(system) for name in names]
        if names:
            raise Untraceable(f"steps stop at events of {', '.join(names)}")

    def prepare(self, system: Any, dt: float) -> Stepper:
        """The stepper for one system and one step size [s].

        Raises:
            Untraceable: Something in the system has no compiled form; names it.
            BuildError: It cannot be compiled.
            ModelError: The method does not serve the system.
        """
        self.refuse(system)
        prepare_stepper(self.method, system, dt)  # the method speaks before the compiler works
        key = self.method.asks, self._stabilization.gains(dt)
        if key not in self._kept:
            traced = _traced(system)
            library = _compiled(system, traced, self.method.asks, self._say)
            self._kept[key] = traced, library
        self.traced, self.library = self._kept[key]
        compiled = CompiledSystem(system, self.traced, self.library)
        return prepare_stepper(self.method, compiled, dt)


def _traced(system: System) -> Traced:
    refuse_bounds(system)
    return trace(system)


def refuse_bounds(system: System) -> None:
    """Refuse unilateral and bounded rows.

    Raises:
        Untraceable: There are some.
    """
    if system.bounded is not None or system.event_rows is not None:
        raise Untraceable("rows that give way have no derivatives across their bounds")


def _compiled(
    system: System, traced: Traced, names: tuple[str, ...], say: Say, p: Array = NONE
) -> Library:
    def check(library: Library) -> None:
        verify(library, traced, system, p)
        verify_slopes(CompiledSystem(system, traced, library, p), names)

    return load(emitted(traced, names), say, check)


def verify_slopes(system: CompiledSystem, names: Sequence[str]) -> None:
    """Compares slopes along one direction at a random state.

    States at which the plain tier has no solution, or no slope, say nothing.

    Args:
        names: The functions that it was compiled to.

    Raises:
        BuildError: They differ.
    """
    plain, rng = system.system, np.random.default_rng(_SEED)
    y = some_state(plain, rng)
    u, _ = some_inputs(plain, y.t, rng)
    along = rng.normal(size=2 * plain.nv + len(y.z))
    along /= np.linalg.norm(along)
    try:
        if "derivatives" in names:
            by_q, by_v = system.derivatives(y, u, inputs=False).of_velocities
            _compare(system, lambda x: plain_rates(plain, x, u), y, along, (by_q, by_v))
        if "balance" in names:
            whole = Extended(plain) if len(y.z) else plain
            a, lam = rng.normal(size=whole.nv), rng.normal(size=len(plain.bilateral.rows))
            forces, given = Balance(whole), (u, a, lam)

            def force(x: State) -> Array:
                at = whole.joined(x) if isinstance(whole, Extended) else x
                return forces.force(at.t, at.q, at.v, *given)

            own, at = system.balance(whole), whole.joined(y) if isinstance(whole, Extended) else y
            _compare(system, force, y, along, own.slopes(at.t, at.q, at.v, *given))
    except MbdError as error:
        if isinstance(error, BuildError):
            raise


def _compare(
    system: CompiledSystem, field: Field, y: State, along: Array, slopes: tuple[Array, Array]
) -> None:
    """Slopes along a direction beside differences of a field.

    Raises:
        BuildError: They differ.
    """
    n, chart = system.system.nv, system.system.chart
    found = slopes[0][:, :n].dot(along[:n]) + slopes[1].dot(along[n:])

    def difference(h: float) -> Array:
        after, before = (field(chart.plus(y, sign * h * along)) for sign in (1.0, -1.0))
        return (after - before) / (2.0 * h)

    wanted, again = difference(_STEP), difference(0.5 * _STEP)
    size = 1.0 + float(np.abs(wanted).max(initial=0.0))
    if not np.abs(wanted - again).max(initial=0.0) <= _SMOOTH * size:
        return
    apart = float(np.abs(found - wanted).max(initial=0.0))
    if not apart <= _CLOSE * size:
        raise BuildError(
            f"compiled derivatives differ by {apart:.3g} from those of the plain tier"
        )


def compiled_system(
    system: System, traced: Traced | None = None, p: Array = NONE, say: Say = silent
) -> CompiledSystem:
    """A system whose `derivatives` are exact.

    Args:
        traced: Its symbolic form, with parameters; one without any by default.
        p: Values of the parameters, those with which the system was built, shape (np,).
        say: Is told what takes time.

    Raises:
        Untraceable: Something in the system has no compiled form; names it.
        BuildError: It cannot be compiled.
    """
    form = _traced(system) if traced is None else traced
    return CompiledSystem(system, form, _compiled(system, form, EXACT, say, p), p)
