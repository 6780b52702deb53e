"""Methods of integration whose steps run in native code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.compiled.build.library import Library, load
from mbd_ros.compiled.build.verify import verify
from mbd_ros.compiled.code.emit import emitted
from mbd_ros.compiled.runs.event_stepper import EventStepper, ModeStepper
from mbd_ros.compiled.runs.native_run import NativeRun, Sizes, with_integrators
from mbd_ros.compiled.runs.native_stepper import NativeStepper
from mbd_ros.compiled.runs.run_layout import internal_bounds
from mbd_ros.compiled.symbols.trace import Traced, trace
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.contracts import type_name
from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.methods.integration.adapted_steps import TurnedSteps
from mbd_ros.methods.integration.linear_motion import LinearMotion
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.methods.simulation.checked_steps import event_sources, prepare_stepper

Say = Callable[[str], None]


def silent(line: str) -> None:
    """Discard a progress message."""


class NativeMethod(Integrator):
    """Integration method that uses native code for the steps or the equations of another method.

    Args:
        method: The other method.
        stabilization: Correction of constraint drift.
        say: Function that receives progress messages.
        cache: Compiled code of a system by options, which is extended here; one dict a system.

    Attributes:
        traced: Symbolic form of the system that was prepared last.
        library: Compiled library of that system.
    """

    moves_internal = True

    def __init__(
        self,
        method: Integrator,
        stabilization: Stabilization,
        say: Say = silent,
        cache: dict[Any, Any] | None = None,
    ) -> None:
        self.method, self._stabilization, self._say = method, stabilization, say
        self._cache = {} if cache is None else cache
        self.order, self.stable = method.order, method.stable
        self.traced: Traced | None = None
        self.library: Library | None = None

    @property
    def title(self) -> str:
        """Title of the method, marked as compiled."""
        return f"compiled {self.method.title}"

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Return the largest factor by which a step multiplies a linear motion."""
        return self.method.growth(motion, dt)


class CompiledMethod(NativeMethod):
    """The steps of another method, and the projection after them, in native code."""

    keeps_constraints = True
    event_steps = EventStepper
    turns = True

    @property
    def event_driven(self) -> bool:  # type: ignore[override]
        """Whether the method stops at events."""
        return self.method.event_driven

    @property
    def finds_surfaces(self) -> bool:  # type: ignore[override]
        """Whether the method locates switching surfaces of forces."""
        return self.method.finds_surfaces

    def refuse(self, system: Any) -> None:
        """Check that native runs support a system.

        Raises:
            Untraceable: They do not; the message names the reason.
        """
        if not self.method.native:
            name = type_name(type(self.method))
            raise Untraceable(f"integrator {name} takes no compiled steps")
        rows, guards = event_sources(system)
        if guards or (rows and not self.method.event_driven):
            raise Untraceable(f"steps stop at events of {', '.join((*rows, *guards))}")
        stabilization = type(self._stabilization)
        corrects = stabilization.correct is not Stabilization.correct
        if system.bilateral.rows and corrects and not self._stabilization.projects:
            raise Untraceable(f"stabilization {type_name(stabilization)} has no compiled form")
        for at, source in system.loads.sources.smooth:
            if source.pieces() is None:
                name = type_name(type(source))
                raise Untraceable(
                    f"{name} gives u[{at.start}:{at.stop}] within steps, from Python"
                )

    def prepare(self, system: Any, dt: float) -> NativeStepper:
        """Prepare the stepper for a system and a step size [s].

        Raises:
            Untraceable: A part of the system or the method has no compiled form.
            BuildError: The code cannot be compiled.
            ModelError: The method does not support the system.
        """
        self.refuse(system)
        plain, form = prepare_stepper(self.method, system, dt), None
        if isinstance(system, InWorldAxes):
            plain, form = TurnedSteps(system, plain), system
        self.traced, sizes, self.library = built = self._build(system, dt)
        pairs = ((at, source.pieces()) for at, source in system.loads.sources.smooth)
        smooth = [(at, pieces) for at, pieces in pairs if pieces is not None]
        run = NativeRun(
            *(self.library, sizes, self.method, dt, internal_bounds(system), np.ones(sizes.modes)),
            least_health=built.traced.least_health,
            smooth=smooth,
            form=form,
        )
        arguments = run, plain, self._correction(system), system.loads.idle
        if not sizes.modes:
            return NativeStepper(*arguments)
        gaps = [i for i, reach in enumerate(system.event_rows.reach) if reach is Reach.GAP]
        return ModeStepper(*arguments, self.traced.keys, gaps)

    def _build(self, system: Any, dt: float) -> Built:
        """Return the native code of a system from the cache, and build it first if necessary."""
        key = self.method.native, self._is_projected(system), self._stabilization.gains(dt)
        if key not in self._cache:
            in_world = isinstance(system, InWorldAxes)
            local, mode = system.system if in_world else system, None if system.event_rows else ()
            traced = trace(local, mode=mode, in_world=in_world)
            sizes = self.sizes(system, traced)
            source = with_integrators(emitted(traced, sizes.functions), sizes)
            library = load(source, self._say, lambda built: verify(built, traced, system))
            self._cache[key] = Built(traced, sizes, library)
        return self._cache[key]

    def sizes(self, system: Any, traced: Traced) -> Sizes:
        """Return the sizes and options for which native steps are compiled."""
        is_projected = self._is_projected(system)
        rows = traced.mg, traced.mh
        return Sizes(
            *(traced.nq, traced.nv, traced.nz, traced.nu, *rows, traced.nq_all, traced.nv_all),
            is_flat=system.chart.is_flat,
            is_whole=system.nv == system.model.nv and not isinstance(system, InWorldAxes),
            is_projected=is_projected,
            is_rattle=self.method.native == "rattle",
            np=traced.np,
            **_modes(system, traced),
        )

    def _is_projected(self, system: Any) -> bool:
        needs_correction = bool(system.bilateral.rows) and not self.method.keeps_constraints
        return needs_correction and self._stabilization.projects

    def _correction(self, system: Any) -> Any:
        if not self._is_projected(system):
            return lambda y: y
        local = system.system if isinstance(system, InWorldAxes) else system
        return lambda y: self._stabilization.correct(local, y)


def _modes(system: Any, traced: Traced) -> dict[str, int]:
    """Return the sizes that concern unilateral rows."""
    if not traced.switches:
        return {}
    reach = system.event_rows.reach
    counts = {kind: reach.count(kind) for kind in Reach}
    slips, demands = counts[Reach.SLIP], counts[Reach.DEMAND]
    return {
        "modes": traced.switches,
        "answers": int(traced.function("answers").size1_out(0)),
        "gaps": counts[Reach.GAP],
        "stays": counts[Reach.GAP] + slips + counts[Reach.FRICTION],
        "contacts": counts[Reach.FRICTION] // 2,
        "has_demands": demands > 0,
        "asks_always": slips + demands > 0,
    }


class Built(NamedTuple):
    """A system in native code.

    Attributes:
        traced: Symbolic form of the system.
        sizes: Sizes and options for which the integrators are compiled.
        library: Compiled library.
    """

    traced: Traced
    sizes: Sizes
    library: Library
