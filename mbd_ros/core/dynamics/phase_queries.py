"""What is asked of systems that may have phases; nothing is paid for where they have none."""

from typing import Any

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import State


def phased(system: System) -> Any:
    """The system as a `PhasedSystem`; None where it has no phases."""
    return system if getattr(system, "phases", ()) else None


def during(system: System, x: State) -> System:
    """The system of the phase of a state; the system itself where it has no phases."""
    several = phased(system)
    return system if several is None else several.during(x)


def inward(system: System, x: State) -> State:
    """The state with the mode that the system of its phase has for it."""
    several = phased(system)
    return x if several is None else several.inward(x)


def phase_names(system: System) -> tuple[str, ...]:
    """Names of the phases in the order of the scene; empty where it has none."""
    several = phased(system)
    return () if several is None else tuple(phase.name for phase in several.phases)
