"""Quantities that tasks name: expressions of the symbols of a phase.

Unknowns of a phase have names, and so have measurements of sensors, outputs of parts and loads of
joints.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.scalar import number, numbers, plain, scalars
from mbd_ros.compiled.symbols.tree.reactions import SymbolicReactions
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contracts import Measures, Now, Part, Sensor
from mbd_ros.core.dynamics.output_values import numbers_of
from mbd_ros.core.loads.inputs import command_names, input_names
from mbd_ros.core.muscles.metabolic_rate import Metabolism
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.methods.inverse_dynamics.reactions import find_joint_links
from mbd_ros.optimal_control.phase_equations import PhaseEquations
from mbd_ros.optimal_control.problem import body_names

_AXES = "xyz"
_LOAD = {
    f"{kind}_{axis}": unit for kind, unit in (("force", "N"), ("moment", "N·m")) for axis in _AXES
}


class Quantities:
    """Quantities by name.

    `<joint>.position`, `.velocity`, `.acceleration`, commands and excitations as in tables,
    internal states, multipliers, `<frame>.position.x` and `.velocity.x` of links, loads of joints
    as `<link>.load.force_x`, and parameters.

    Args:
        phase: Equations of the phase.
        sensors: Sensors of the scene.
        prescribed: Indices of prescribed inputs, such as measured loads, which are not unknowns.
    """

    def __init__(
        self,
        phase: PhaseEquations,
        sensors: Sequence[Sensor] = (),
        prescribed: Collection[int] = (),
    ) -> None:
        self._phase = phase
        self._named = dict[str, Quantity]()
        self._prescribed = frozenset(prescribed)
        self._parts = PartQuantities(phase.equations, sensors)
        for quantity in (*self._joints(), *self._bodies(), *self._others()):
            self._named.setdefault(quantity.name, quantity)

    @property
    def symbols(self) -> Mapping[str, Any]:
        """Letter -> column of symbols of the phase."""
        return self._phase.symbols

    @property
    def names(self) -> tuple[str, ...]:
        """All names except those of frames."""
        return tuple(self._named)

    def find(self, name: str) -> list[Quantity]:
        """Return the quantities of a name or a pattern: unknowns, or others if there are none.

        Raises:
            ModelError: There is none; the message lists the names that exist.
        """
        if name in self._named:
            return [self._named[name]]
        matches = [value for key, value in self._named.items() if fnmatchcase(key, name)]
        matches = [match for match in matches if match.letter] or matches
        matches = matches or [self._of_part(key) for key in self._parts.matching(name)]
        if not matches:
            of_frame = self._of_frame(name)
            matches = [] if of_frame is None else [of_frame]
        if not matches:
            raise ModelError(
                f"no quantity '{name}', there are {', '.join(self._named)}, measurements of "
                "sensors, outputs of parts, <frame>.position.x and <link>.load.force_x of links"
            )
        return matches

    def requested(self) -> dict[str, tuple[Quantity, str]]:
        """Return requested quantities of parts, sensors and joints, with units, by name."""
        names = (name for name in self._named if name in self._parts.names)
        return {name: (self._named[name], self._parts.unit(name)) for name in names}

    def name_of(self, letter: str, index: int) -> str:
        """Return the name of an unknown."""
        for quantity in self._named.values():
            if (quantity.letter, quantity.index) == (letter, index):
                return quantity.name
        return f"{letter}[{index}]"

    def inputs(self) -> list[Quantity]:
        """Return all inputs that are unknowns, in the order of u."""
        inputs = [quantity for quantity in self._named.values() if quantity.letter == "u"]
        return [quantity for quantity in inputs if quantity.index not in self._prescribed]

    def metabolic_rates(self, numbers: Metabolism) -> list[Quantity]:
        """Return the metabolic rates of all muscles, named like the muscles."""
        rates = self._parts.metabolic_rates(numbers)
        return [Quantity(name, ca.SX(plain(rate))) for name, rate in rates.items()]

    @property
    def mass(self) -> float:
        """Mass of all links [kg]."""
        return self._parts.mass

    def markers(self) -> list[tuple[Quantity, float]]:
        """Return the coordinates of all markers, with the weights of these."""
        return [(self._of_part(name), weight) for name, weight in self._parts.markers()]

    def _of_part(self, name: str) -> Quantity:
        if name not in self._named:
            self._named[name] = Quantity(name, ca.SX(plain(self._parts.value(name))))
        return self._named[name]

    def _joints(self) -> Iterator[Quantity]:
        e, symbols = self._phase.equations, self._phase.symbols
        lifted = e.coordinates.lifted(ca.vertsplit(symbols["a"]))
        places = {letter: _places(symbols[letter]) for letter in "qva"}
        for joint in e.system.robot.joints:
            values = {
                "position": ("q", plain(e.coordinates.q[joint.q])),
                "velocity": ("v", plain(e.coordinates.v[joint.v])),
                "acceleration": ("a", lifted[joint.v]),
            }
            for kind, (letter, value) in values.items():
                yield _quantity(f"{joint.name}.{kind}", ca.SX(value), letter, places[letter])

    def _bodies(self) -> Iterator[Quantity]:
        e, symbols = self._phase.equations, self._phase.symbols
        places = {letter: _places(symbols[letter]) for letter in "qv"}
        origin = e.system.robot.origin
        for base in e.system.robot.bases:
            values = [*e.coordinates.q[base.q], *e.coordinates.v[base.v]]
            for i, (name, value) in enumerate(zip(body_names(base.name), values, strict=True)):
                letter = "q" if i < base.q.stop - base.q.start else "v"
                shift = float(origin[i]) if i < len(_AXES) else 0.0
                shifted = plain(value) + shift if shift else plain(value)
                yield _quantity(name, ca.SX(shifted), letter, places[letter])

    def _others(self) -> Iterator[Quantity]:
        e, symbols = self._phase.equations, self._phase.symbols
        for i, name in enumerate(input_labels(e.system)):
            yield Quantity(name, symbols["u"][i], "u", i)
        for i, name in enumerate(e.system.internals.names):
            yield Quantity(name, symbols["z"][i], "z", i)
        for i, name in enumerate(multiplier_names(e)):
            yield Quantity(name, symbols["l"][i], "l", i)
        for i, name in enumerate(e.parameters):
            yield Quantity(name, symbols["p"][i], "p", i)
        yield Quantity("time", symbols["t"], "t", 0)
        total: Any = e.k.zeros(e.tree.nv)
        for part in e.loads[: len(e.system.loads.actuators)]:
            with tracing(part):
                total = total + part.force(e.k, e.x, e.u)
        for joint in e.system.robot.joints:
            yield Quantity(f"{joint.name}.effort", ca.SX(plain(total[joint.v])))

    def _of_frame(self, name: str) -> Quantity | None:
        frame, _, component = name.partition(".")
        kind, _, axis = component.partition(".")
        k, robot = self._phase.equations.k, self._phase.equations.system.robot
        if kind not in ("position", "velocity") or axis not in tuple(_AXES):
            return None
        point = robot.point(frame)
        value = getattr(k, kind)(point)[_AXES.index(axis)]
        if kind == "position":
            value = value + float(robot.origin[_AXES.index(axis)])
        return Quantity(name, ca.SX(plain(value)))


class PartQuantities:
    """Numbers of sensors and parts by the names of their columns, built on first use."""

    def __init__(self, equations: Equations, sensors: Sequence[Sensor] = ()) -> None:
        self._e = equations
        self._outputs_of_parts = dict[str, list[Any]]()
        self._sensors = {
            ".".join(filter(None, (sensor.name, component))): (sensor, i)
            for sensor in sensors
            for i, component in enumerate(sensor.components)
        }
        self._outputs = {
            output.name: (part, i)
            for part in self._rows
            for i, output in enumerate(numbers_of(part))
        }
        self._loads = {
            f"{joined.link}.load.{component}": (joined, i)
            for joined in find_joint_links(equations.system.robot)
            for i, component in enumerate(_LOAD)
        }
        self._reactions = SymbolicReactions(equations)

    @cached_property
    def names(self) -> dict[str, None]:
        """Names of sensors, of parts, then of loads of joints."""
        return dict.fromkeys((*self._sensors, *self._outputs, *self._loads))

    def matching(self, pattern: str) -> list[str]:
        """Return the names that match a pattern."""
        return [name for name in self.names if fnmatchcase(name, pattern)]

    def unit(self, name: str) -> str:
        """Return the unit of a named number."""
        if name in self._sensors:
            return self._sensors[name][0].unit
        if name in self._loads:
            return _LOAD[name.rpartition(".")[2]]
        part, i = self._outputs[name]
        return [*numbers_of(part)][i].unit

    def markers(self) -> Iterator[tuple[str, float]]:
        """Yield the coordinates of markers, and the weights of these."""
        for name, (sensor, _) in self._sensors.items():
            if sensor.weight > 0.0:
                yield name, float(sensor.weight)

    def metabolic_rates(self, numbers: Metabolism) -> dict[str, Any]:
        """Return the metabolic rate of each muscle [W] as an expression.

        Args:
            numbers: Properties of the fibres.
        """
        e, rates = self._e, dict[str, Any]()
        for part in e.system.loads.actuators:
            if part.has_metabolic_rate:
                with tracing(part):
                    rates[part.name] = e.with_symbols(part).metabolic_rate(e.k, e.x, e.u, numbers)
        return rates

    @property
    def mass(self) -> float:
        """Mass of all links [kg]."""
        return float(sum(inertia.mass for inertia in self._e.system.model.inertias))

    def value(self, name: str) -> Any:
        """Return a named number as an expression or a float.

        Raises:
            Untraceable: A part has no symbolic form; the message names it.
        """
        if name in self._loads:
            joined, i = self._loads[name]
            return self._reactions.load(joined)[i]
        if name in self._sensors:
            sensor, i = self._sensors[name]
            return self._measured(sensor)[i]
        part, i = self._outputs[name]
        return self._values(part)[i]

    def _measured(self, sensor: Sensor) -> list[Any]:
        if sensor.name not in self._outputs_of_parts:
            now = None
            if sensor.level >= Measures.ACCELERATION:
                now = self._now(np.zeros(0))
            if sensor.level is Measures.FORCE:
                now = now._replace(reactions=self._reactions.felt)
            with tracing(sensor):
                values = sensor.measure(self._e.k, self._e.x, now)
            self._outputs_of_parts[sensor.name] = _flat(values)
        return self._outputs_of_parts[sensor.name]

    def _values(self, part: Part) -> list[Any]:
        """Return the outputs of a part as numbers, one after the other."""
        if part.name not in self._outputs_of_parts:
            e, own = self._e, self._e.with_symbols(part)
            with tracing(part):
                outputs = own.show(e.k, e.x, e.u, self._now(self._rows[part]))
            pairs = zip(part.outputs, outputs, strict=True)
            values = [x for out, value in pairs if not out.is_drawn for x in _flat(value)]
            self._outputs_of_parts[part.name] = values
        return self._outputs_of_parts[part.name]

    @cached_property
    def _rows(self) -> dict[Part, Any]:
        """Parts with outputs, and the multipliers of their rows."""
        e, lam = self._e, numbers(self._e.symbols["l"])
        multipliers, first = dict[Part, Any](), 0
        for block in e.system.bilateral.constraints.blocks:
            multipliers[block.part] = lam[first : first + len(block.rows)]
            first += len(block.rows)
        none = np.zeros(0)
        multipliers.update(
            (part, none) for part in (*e.system.loads.actuators, *e.system.loads.forces)
        )
        return {part: values for part, values in multipliers.items() if part.outputs}

    def _now(self, lam: Any) -> Now:
        e = self._e
        lifted = e.coordinates.lifted(scalars(e.symbols["a"]))
        a = np.empty(len(lifted), dtype=object)
        a[:] = [number(ca.SX(value)) for value in lifted]
        return Now(a, lam)


def _flat(values: Any) -> list[Any]:
    return list(np.asarray(values, dtype=object).reshape(-1))


def _places(symbols: Any) -> dict[int, int]:
    return {symbol.element_hash(): i for i, symbol in enumerate(ca.vertsplit(symbols))}


def _quantity(name: str, value: Any, letter: str, places: dict[int, int]) -> Quantity:
    at = places.get(value.element_hash(), -1) if value.is_symbolic() else -1
    return Quantity(name, value, letter if at >= 0 else "", at)


def input_labels(system: Any) -> list[str]:
    """Return the names of u: `<joint>.effort` for efforts, `<name>.command`, or those of parts."""
    loads, labels = system.loads, [""] * len(system.loads.idle)
    for part, names in zip(loads.actuators, command_names(loads.actuators), strict=True):
        for i, name in enumerate(names):
            is_effort = not part.takes and name in part.joints
            kind = ".effort" if is_effort else ".command"
            labels[part.u.start + i] = f"{name}{kind}" if part.joints else name
    for part in loads.forces:
        if part.inputs:
            labels[part.u] = input_names(part)
    return labels


def multiplier_names(e: Any) -> list[str]:
    """Return the names of the active rows."""
    rigid = e.system.bilateral.constraints.blocks
    names = [row.name for block in rigid for row in block.rows]
    all_names = [row.name for row in e.system.multiplier_rows]
    slots = e.unilateral.slots[: len(e.active_rows.J) - len(names)]
    return names + [all_names[slot] for slot in slots]


class Quantity(NamedTuple):
    """A scalar quantity of a motion.

    Attributes:
        name: Name in tasks.
        value: Expression of the symbols of the phase.
        letter: Letter of the unknown; empty if the quantity is not an unknown.
        index: Index among the unknowns of this letter.
    """

    name: str
    value: Any
    letter: str = ""
    index: int = -1


def unilateral_gaps(phase: PhaseEquations) -> list[Quantity]:
    """Return the gaps of unilateral stops, ropes and contacts, which a motion keeps open.

    Raises:
        ModelError: The force of a part is discontinuous in another way; the message names it.
    """
    e = phase.equations
    rows = e.system.multiplier_rows
    try:
        gaps = e.unilateral.gaps()
    except Untraceable as error:
        names = ", ".join(rows[slot].name for slot in e.unilateral.slots)
        raise ModelError(f"{names}: {error}; use smooth forces, such as joint_friction") from error
    return [Quantity(f"gap of {rows[slot].name}", ca.SX(gap)) for slot, gap in gaps.items()]


def input_bounds(system: Any) -> tuple[Array, Array]:
    """Return the bounds within which inputs have an effect, shape (nu,) each."""
    lower, upper = np.full((2, len(system.loads.idle)), np.inf) * [[-1.0], [1.0]]
    for part in (*system.loads.actuators, *system.loads.forces):
        if part.inputs:
            lower[part.u] = [channel.lower for channel in part.inputs]
            upper[part.u] = [channel.upper for channel in part.inputs]
    return lower, upper
