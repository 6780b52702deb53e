"""The stepper of a simulation: plain steps of a method, or steps from event to event."""

from collections.abc import Iterator

from mbd_ros.core.contracts import Part, type_name
from mbd_ros.core.dynamics.system import System, phased
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.stepping import Integrator, Stepper


def stepper_of(method: Integrator, system: System, dt: float) -> Stepper:
    """The steps of a method, from event to event where a scene has any.

    Args:
        system: What it integrates.
        dt: Length of a step, or first guess [s].

    Raises:
        ModelError: The method cannot stop at events, or surfaces stand beside smoothed rows; or it
            cannot move internal states; names them.
    """
    if (several := phased(system)) is not None:
        from mbd_ros.methods.events.phases import PhaseSteps

        return PhaseSteps(several, lambda one: stepper_of(method, one, dt))
    rows, guards = happenings(system)
    surfaces = method.finds_surfaces and any(force.surfaces for force in system.loads.forces)
    if not (guards or surfaces) and (method.at_velocity_level or not rows):
        return prepared(method, system, dt)
    if not method.event_driven:
        way_out = "; or smoothed: true at these constraints" if rows and not guards else ""
        raise ModelError(
            f"integrator {method.title} does not stop at events, which exact rows and "
            f"guards need: {', '.join((*rows, *guards))}; accepted: rk4, dopri5, dop853, "
            f"filippov, gauss_legendre, adams, and moreau_jean without guards{way_out}"
        )
    _refuse_kinks(method, system)
    from mbd_ros.methods.events.event_steps import EventSteps
    from mbd_ros.methods.events.mode_field import ModeField

    field = ModeField(system, surfaces)
    steps = method.event_steps or EventSteps
    if field.has_contacts and not system.chart.is_flat:
        return steps(field, _turned(method, field.system, dt), dt)
    return steps(field, prepared(method, field.system, dt), dt)


def happenings(system: System) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the exact rows that give way, and of parts with guards."""
    rows = () if system.exact is None else tuple(system.exact.names)
    return rows, tuple(part.name for part in _parts(system) if part.guards)


def _parts(system: System) -> Iterator[Part]:
    yield from system.loads.actuators
    yield from system.loads.forces
    yield from (block.part for block in system.layout.blocks)
    yield from system.loads.watching


def prepared(method: Integrator, system: System, dt: float) -> Stepper:
    """The steps of a method, internal states included."""
    if not system.internals.nz or method.at_velocity_level or method.moves_internal:
        return method.prepare(system, dt)
    if not method.keeps_internal:
        names = ", ".join(filter(None, system.internals.names))
        raise ModelError(
            f"integrator {type_name(type(method))} does not move internal states, the scene has "
            f"{names}; accepted: any other, such as rk4"
        )
    from mbd_ros.methods.integration.adapted_steps import InternalSteps

    return InternalSteps(method, system, dt)


def _refuse_kinks(method: Integrator, system: System) -> None:
    """Refuse contacts whose gaps are not smooth where events have to be found.

    Raises:
        ModelError: Names them, and the way out.
    """
    parts = [block.part for block in system.layout.having(Kind.CONE)]
    pairs = ((part.name, getattr(part, "pair", None)) for part in parts)
    rough = [f"{name} ({pair.why_not})" for name, pair in pairs if pair and not pair.is_smooth]
    if rough:
        raise ModelError(
            f"integrator {type_name(type(method))} goes from event to event, which needs smooth "
            f"gaps; not so {', '.join(rough)}; accepted: moreau_jean, or points on one of the "
            "bodies over a half_space or over spheres"
        )


def _turned(method: Integrator, system: System, dt: float) -> Stepper:
    """The steps of a method in the axes of the world, where spins turn no velocity."""
    from mbd_ros.core.dynamics.world_axes import InWorldAxes
    from mbd_ros.methods.integration.adapted_steps import TurnedSteps

    world = InWorldAxes(system)
    inner = prepared(method, world, dt)
    return inner if method.turns else TurnedSteps(world, inner)
