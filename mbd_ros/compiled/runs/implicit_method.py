"""Implicit methods in Python whose accelerations and exact derivatives are native code.

Compiled derivatives are compared with finite differences of the plain tier before they are used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import Library, load
from mbd_ros.compiled.build.verify import plain_rates, random_inputs, random_state, verify
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
_STEP = 1.0e-4  # of central differences, which are accurate to 1e-6
_CLOSE = 1.0e-4  # accepted relative difference, far below the effect of wrong code
_SMOOTH = 1.0e-5  # relative difference of two quotients up to which a derivative exists
Field = Callable[[State], Array]
EXACT = "accelerate", "derivatives"  # what exact derivatives of a system need


class ImplicitMethod(NativeMethod):
    """Implicit method in Python that solves equations of a compiled system by Newton's method."""

    is_explicit = False

    @property
    def keeps_constraints(self) -> bool:  # type: ignore[override]
        """Whether the method satisfies constraints itself."""
        return self.method.keeps_constraints

    def refuse(self, system: Any) -> None:
        """Check that a system has no events.

        Raises:
            Untraceable: It has events; the message names them.
        """
        names = [name for names in event_sources(system) for name in names]
        if names:
            raise Untraceable(f"steps stop at events of {', '.join(names)}")

    def prepare(self, system: Any, dt: float) -> Stepper:
        """Prepare the stepper for a system and a step size [s].

        Raises:
            Untraceable: A part of the system has no compiled form.
            BuildError: The code cannot be compiled.
            ModelError: The method does not support the system.
        """
        self.refuse(system)
        prepare_stepper(self.method, system, dt)  # errors of the method come before a compilation
        key = self.method.compiled_functions, self._stabilization.gains(dt)
        if key not in self._cache:
            traced = _trace(system)
            library = _compile(system, traced, self.method.compiled_functions, self._say)
            self._cache[key] = traced, library
        self.traced, self.library = self._cache[key]
        compiled = CompiledSystem(system, self.traced, self.library)
        return prepare_stepper(self.method, compiled, dt)


def _trace(system: System) -> Traced:
    refuse_bounds(system)
    return trace(system)


def refuse_bounds(system: System) -> None:
    """Check that a system has no unilateral or bounded rows.

    Raises:
        Untraceable: It has such rows.
    """
    if system.bounded is not None or system.event_rows is not None:
        raise Untraceable(
            "unilateral and bounded constraints have no derivatives across their bounds"
        )


def _compile(
    system: System, traced: Traced, names: tuple[str, ...], say: Say, p: Array = NONE
) -> Library:
    def check(library: Library) -> None:
        verify(library, traced, system, p)
        verify_slopes(CompiledSystem(system, traced, library, p), names)

    return load(emitted(traced, names), say, check)


def verify_slopes(system: CompiledSystem, names: Sequence[str]) -> None:
    """Compare compiled derivatives along a direction at a random state.

    A state at which the plain tier has no solution or no derivative is skipped.

    Args:
        system: The compiled system.
        names: Names of its compiled functions.

    Raises:
        BuildError: They differ.
    """
    plain, rng = system.system, np.random.default_rng(_SEED)
    y = random_state(plain, rng)
    u, _ = random_inputs(plain, y.t, rng)
    along = rng.normal(size=2 * plain.nv + len(y.z))
    along /= np.linalg.norm(along)
    try:
        if "derivatives" in names:
            by_q, by_v = system.derivatives(y, u, inputs=False).of_velocities
            _compare(system, lambda x: plain_rates(plain, x, u), y, along, (by_q, by_v))
        if "balance" in names:
            extended = Extended(plain) if len(y.z) else plain
            a, lam = rng.normal(size=extended.nv), rng.normal(size=len(plain.bilateral.rows))
            forces, arguments = Balance(extended), (u, a, lam)

            def force(x: State) -> Array:
                at = extended.joined(x) if isinstance(extended, Extended) else x
                return forces.force(at.t, at.q, at.v, *arguments)

            at = extended.joined(y) if isinstance(extended, Extended) else y
            slopes = system.balance(extended).slopes(at.t, at.q, at.v, *arguments)
            _compare(system, force, y, along, slopes)
    except MbdError as error:
        if isinstance(error, BuildError):
            raise


def _compare(
    system: CompiledSystem, field: Field, y: State, along: Array, slopes: tuple[Array, Array]
) -> None:
    """Compare derivatives along a direction with finite differences of a field.

    Raises:
        BuildError: They differ.
    """
    n, chart = system.system.nv, system.system.chart
    derivative = slopes[0][:, :n].dot(along[:n]) + slopes[1].dot(along[n:])

    def difference(h: float) -> Array:
        after, before = (field(chart.plus(y, sign * h * along)) for sign in (1.0, -1.0))
        return (after - before) / (2.0 * h)

    expected, finer = difference(_STEP), difference(0.5 * _STEP)
    size = 1.0 + float(np.abs(expected).max(initial=0.0))
    if not np.abs(expected - finer).max(initial=0.0) <= _SMOOTH * size:
        return
    error = float(np.abs(derivative - expected).max(initial=0.0))
    if not error <= _CLOSE * size:
        raise BuildError(
            f"compiled derivatives differ by {error:.3g} from those of the plain tier"
        )


def compiled_system(
    system: System, traced: Traced | None = None, p: Array = NONE, say: Say = silent
) -> CompiledSystem:
    """Return a system whose `derivatives` are exact.

    Args:
        system: The system.
        traced: Symbolic form with parameters; by default one without parameters.
        p: Values of the parameters of the system, shape (np,).
        say: Function that receives progress messages.

    Raises:
        Untraceable: A part of the system has no compiled form.
        BuildError: The code cannot be compiled.
    """
    form = _trace(system) if traced is None else traced
    return CompiledSystem(system, form, _compile(system, form, EXACT, say, p), p)
