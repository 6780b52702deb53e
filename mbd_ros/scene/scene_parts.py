"""The built parts of a scene."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_ros.core.contracts import Actuator, Load
from mbd_ros.core.loads.inputs import Inputs
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.state import Array, State
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.methods.simulation.live_simulation import SafeCommand
from mbd_ros.scene.reading.building import Origin, parts_in
from mbd_ros.scene.reading.coupling_entries import coupling_kinds
from mbd_ros.scene.reading.part_entries import MeasuredWrench, Solver
from mbd_ros.scene.schema.sections import Section

if TYPE_CHECKING:
    from mbd_ros.core.contracts import Sensor
    from mbd_ros.core.muscles.muscle import Muscle
    from mbd_ros.scene.reading.phase_entries import PhasePlan

from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.loads.inputs import bound
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.schema import schema

# Where the inputs of the parts of a scene stand in u, and their internal states in z.


def bind_inputs(
    sections: Sequence[Section], parts: Mapping[str, Any]
) -> tuple[dict[str, Any], Inputs]:
    """Built sections whose parts know where their inputs and states stand, and all inputs.

    Actuators come first, in their order, then the others in the order of the table.

    Args:
        sections: The table.
        parts: Built sections by key.
    """
    built = [(s, parts[s.key]) for s in sections if s.key in parts]
    every = [part for section, given in built for part in parts_in(section, given)]
    takers = [p for p in every if getattr(p, "inputs", ()) or getattr(p, "internal", ())]
    takers.sort(key=lambda part: not hasattr(part, "command"))  # stable
    after, inputs = bound(takers)
    swapped = {id(a): b for a, b in zip(takers, after, strict=True) if a is not b}
    if not swapped:
        return dict(parts), inputs
    return {key: _replaced(given, swapped) for key, given in parts.items()}, inputs


def first_values(internals: Internals, given: Any, where: str) -> Array:
    """Internal states at the start, NaN where nothing is given, shape (nz,).

    Args:
        internals: Of the scene.
        given: Values by name, `<part>.<name>: 0.1` or `<part>: {<name>: 0.1}`; None for none.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    z = np.full(internals.nz, np.nan)
    for name, value in _flat(given or {}):
        if name not in internals.names:
            accepted = ", ".join(internals.names) or "none, no part has internal states"
            raise SceneError(f"{where}.internal: unknown '{name}', accepted: {accepted}")
        z[internals.names.index(name)] = schema.value(value, float, f"{where}.internal.{name}")
    try:
        internals.completed(z)
    except ModelError as error:
        raise SceneError(f"{where}.internal: {error}") from error
    return z


def _flat(given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names with dots, and values."""
    for name, value in given.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{rest}", one) for rest, one in _flat(value))
        else:
            yield name, value


def _replaced(given: Any, swapped: Mapping[int, Any]) -> Any:
    if type(given) in (tuple, list):
        return tuple(swapped.get(id(part), part) for part in given)
    if isinstance(given, dict):
        return {name: swapped.get(id(part), part) for name, part in given.items()}
    return swapped.get(id(given), given)


@dataclass(frozen=True, eq=False, repr=False)
class SceneParts:
    """The built parts of a scene.

    Attributes:
        origin: The file, or what else its sections came from.
        robot: The robot, with the inertia of its drives.
        parts: The built sections, by key; the robot there is without its drives.
        entries: The sections as given, by key.
        sections: Lines of the table, those of other packages included.
        code: Key -> `package.module:Class` of what was imported from outside this package.
        inputs: What parts take from outside while they run: u.
        internals: States of parts of their own: z.
    """

    origin: Origin
    robot: Robot
    parts: Mapping[str, Any]
    entries: Mapping[str, Any]
    sections: tuple[Section, ...]
    code: Mapping[str, str]
    inputs: Inputs = field(init=False)
    internals: Internals = field(init=False)
    _first: Array = field(init=False)

    def __post_init__(self) -> None:
        parts, inputs = bind_inputs(self.sections, self.parts)
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "inputs", inputs)
        every = [
            part for s in self.sections if s.key in parts for part in parts_in(s, parts[s.key])
        ]
        holders = [part for part in every if getattr(part, "internal", ())]
        object.__setattr__(self, "internals", Internals(holders))
        given = self.entries.get("initial") or {}
        z = first_values(self.internals, given.get("internal"), f"{self.name}: initial")
        object.__setattr__(self, "_first", z)

    @property
    def path(self) -> Path | None:
        """The file; None for a scene that Python made."""
        return self.origin.path

    @property
    def name(self) -> str:
        """The file as messages call it, `scene` without one."""
        return self.origin.name

    @property
    def source(self) -> str:
        """File or topic of the robot description."""
        return self.robot.source

    @property
    def couplings(self) -> Couplings:
        """Its dependent joints."""
        couplings: Couplings = self.parts["couplings"]
        return couplings

    @property
    def coupling_kinds(self) -> Mapping[str, str]:
        """Dependent joint -> parent and kind of coupling function, for people."""
        return coupling_kinds(self.couplings, self.entries.get("couplings", {}))

    @property
    def wrenches(self) -> Mapping[str, MeasuredWrench]:
        """External loads by name."""
        return self.parts.get("external_wrenches", {})

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """Constraints besides the couplings, of all sections."""
        return self._offering("residual")

    @property
    def forces(self) -> tuple[Load, ...]:
        """Loads that nobody commands, of all sections."""
        return tuple(part for part in self._offering("force") if not hasattr(part, "command"))

    @property
    def acting(self) -> tuple[Load, ...]:
        """Those of the forces that act by themselves: nobody gives them an input."""
        return tuple(force for force in self.forces if not force.inputs)

    @property
    def muscles(self) -> "tuple[Muscle, ...]":
        """Muscles, in the order of their excitations."""
        return self._offering("active_force")

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Actuators, in the order of their commands."""
        return self._offering("command")

    @property
    def sensors(self) -> "tuple[Sensor, ...]":
        """What is measured, of all sections."""
        return self._offering("measure")

    @property
    def commanded(self) -> tuple[Actuator, ...]:
        """Actuators, then muscles: the parts whose inputs are commands."""
        return (*self.actuators, *self.muscles)

    @property
    def phases(self) -> "Mapping[str, PhasePlan]":
        """Phases of the motion by name, empty where it has none."""
        return self.parts.get("phases", {})

    @property
    def stabilization(self) -> Stabilization | None:
        """Stabilization of the constraints; None leaves the choice to `simulation`."""
        return self.parts.get("stabilization")

    @property
    def solver(self) -> Solver:
        """How the equations are solved."""
        solver: Solver = self.parts["solver"]
        return solver

    @property
    def integrator(self) -> Integrator | None:
        """Method; None leaves the choice to `simulation`."""
        return self.parts.get("integrator")

    @property
    def integrator_entry(self) -> Mapping[str, Any]:
        """The entry of the file, empty without one."""
        return self.entries.get("integrator", {})

    @property
    def dt(self) -> float:
        """Step [s]."""
        dt: float = self.parts["dt"]
        return dt

    @property
    def initial(self) -> State:
        """State of all joints at the start as the file gives it, NaN where z is left open."""
        initial: State = self.parts["initial"]
        return initial if len(initial.z) else initial._replace(z=self._first)

    @property
    def safe(self) -> SafeCommand:
        """The safe command of the actuators."""
        safe: SafeCommand = self.parts["safe"]
        return safe

    @property
    def absent(self) -> tuple[str, ...]:
        """Sections that the file leaves out; gravity acts without one."""
        keys = (section.key for section in self.sections if section.key != "gravity")
        return tuple(key for key in keys if not self.entries.get(key))

    def _offering(self, method: str) -> tuple[Any, ...]:
        """Parts of all sections whose parts have a method, in the order of the table."""
        return tuple(
            part
            for section in self.sections
            if method in " or ".join(section.offers).split(" or ") and section.key in self.parts
            for part in parts_in(section, self.parts[section.key])
            if hasattr(part, method)
        )

    @property
    def has_loops(self) -> bool:
        """Whether bilateral constraints act besides the couplings."""
        return any(part.law.is_rigid for part in self.constraints)

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Parts with states that no measured motion shows, besides actuators."""
        return tuple(part.name for part in (*self.forces, *self.constraints) if part.internal)

    @property
    def actuated(self) -> tuple[str, ...]:
        """Joints with an actuator; without any, all independent ones that no drive moves."""
        if self.actuators:
            return tuple(dict.fromkeys(name for part in self.actuators for name in part.joints))
        driven = {name for part in self.constraints for name in part.driven}
        return tuple(name for name in self.couplings.independent if name not in driven)

    def __repr__(self) -> str:
        from mbd_ros.scene.describe.scene_summary import scene_text

        return scene_text(self)

    def _repr_html_(self) -> str:
        from mbd_ros.scene.describe.scene_summary import scene_html

        return scene_html(self)
