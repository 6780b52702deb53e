"""Scenes compiled for many runs side by side."""

from collections.abc import Callable
from typing import Any

from mbd_ros.compiled.build.compiler import lanes
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.build.verify import verify
from mbd_ros.compiled.code.emit import emit
from mbd_ros.compiled.runs.compiled_method import CompiledMethod
from mbd_ros.compiled.runs.lane_runs import LaneRuns
from mbd_ros.compiled.runs.native_run import with_integrators
from mbd_ros.compiled.runs.run_layout import internal_bounds
from mbd_ros.compiled.symbols.trace import Traced
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.contracts import type_name
from mbd_ros.core.state import Array
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.projection.assembly import Stabilization


def lane_runs(
    system: Any,
    method: Integrator,
    stabilization: Stabilization,
    dt: float,
    traced: Callable[[], Traced],
    p: Array,
    say: Callable[[str], None],
) -> LaneRuns:
    """Runs of a system side by side.

    Args:
        system: The system, with the gains of the stabilization.
        stabilization: What keeps the rows.
        dt: Step [s].
        traced: Gives the symbolic form of the system.
        p: Values of its parameters in the system.
        say: Is told what takes time.

    Raises:
        Untraceable: Something has no form in vectors; names it.
        BuildError: It cannot be compiled.
    """
    compiled = CompiledMethod(method, stabilization, say)
    compiled.refuse(system)
    _refuse(system, method)
    form = traced()
    sizes = compiled.sizes(system, form)
    functions = [form.function(name) for name in sizes.functions]
    if form.searched:
        raise Untraceable("paths that wrap are searched one run at a time")
    source = with_integrators(emit(functions, lanes()), sizes)
    library = load(source, say, lambda library: verify(library, form, system, p))
    bounds, idle = internal_bounds(system), system.loads.idle
    return LaneRuns(library, sizes, method, dt, bounds, idle, form.least_health)


def _refuse(system: Any, method: Integrator) -> None:
    """Refuse what runs side by side do not do, although single ones do.

    Raises:
        Untraceable: Names it.
    """
    name = type_name(type(method))
    if getattr(method, "tolerance", None) is not None:
        raise Untraceable(f"integrator {name} with a tolerance takes steps of its own in each run")
    if system.loads.sources.entries:
        raise Untraceable("inputs that change in time are given")
