"""What goes by a name in a task: expressions of the symbols of a phase.

Unknowns of a phase have names, and so has what sensors measure, parts show and joints pass on.
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

    `<joint>.position`, `.velocity`, `.acceleration`, commands and excitations as tables call them,
    internal states, multipliers, `<frame>.position.x` and `.velocity.x` of links, loads of joints
    as `<link>.load.force_x`, and parameters.

    Args:
        given: Places of inputs that are no unknowns but known over time, such as measured loads.
    """

    def __init__(
        self, phase: PhaseEquations, sensors: Sequence[Sensor] = (), given: Collection[int] = ()
    ) -> None:
        self._phase, self._named, self._given = phase, dict[str, Quantity](), frozenset(given)
        self._parts = PartQuantities(phase.equations, sensors)
        for one in (*self._joints(), *self._bodies(), *self._others()):
            self._named.setdefault(one.name, one)

    @property
    def symbols(self) -> Mapping[str, Any]:
        """Letter -> column of symbols of the phase."""
        return self._phase.symbols

    @property
    def names(self) -> tuple[str, ...]:
        """All names but those of frames."""
        return tuple(self._named)

    def find(self, name: str) -> list[Quantity]:
        """The quantities of a name, or of a pattern: unknowns first, else others.

        Raises:
            ModelError: There is none; lists what there is.
        """
        if name in self._named:
            return [self._named[name]]
        found = [one for key, one in self._named.items() if fnmatchcase(key, name)]
        found = [one for one in found if one.letter] or found
        found = found or [self._of_part(one) for one in self._parts.matching(name)]
        if not found:
            of_frame = self._of_frame(name)
            found = [] if of_frame is None else [of_frame]
        if not found:
            raise ModelError(
                f"no quantity '{name}', there are {', '.join(self._named)}, what sensors and "
                "parts show, <frame>.position.x and <link>.load.force_x of links"
            )
        return found

    def requested(self) -> dict[str, tuple[Quantity, str]]:
        """Quantities of parts, sensors and joints that have been requested, and units, by name."""
        names = (name for name in self._named if name in self._parts.names)
        return {name: (self._named[name], self._parts.unit(name)) for name in names}

    def name_of(self, letter: str, index: int) -> str:
        """What an unknown is called."""
        for one in self._named.values():
            if (one.letter, one.index) == (letter, index):
                return one.name
        return f"{letter}[{index}]"

    def inputs(self) -> list[Quantity]:
        """All inputs that are unknowns, in the order of u."""
        every = [one for one in self._named.values() if one.letter == "u"]
        return [one for one in every if one.index not in self._given]

    def metabolic_rates(self, numbers: Metabolism) -> list[Quantity]:
        """Metabolic rates of all muscles, by name of the muscle."""
        rates = self._parts.metabolic_rates(numbers)
        return [Quantity(name, ca.SX(plain(one))) for name, one in rates.items()]

    @property
    def mass(self) -> float:
        """Of all links [kg]."""
        return self._parts.mass

    def markers(self) -> list[tuple[Quantity, float]]:
        """Coordinates of all markers with the weights of these."""
        return [(self._of_part(name), weight) for name, weight in self._parts.markers()]

    def _of_part(self, name: str) -> Quantity:
        if name not in self._named:
            self._named[name] = Quantity(name, ca.SX(plain(self._parts.value(name))))
        return self._named[name]

    def _joints(self) -> Iterator[Quantity]:
        e, symbols = self._phase.equations, self._phase.symbols
        lifted = e.coordinates.lifted(ca.vertsplit(symbols["a"]))
        own = {letter: _places(symbols[letter]) for letter in "qva"}
        for joint in e.system.robot.joints:
            values = {
                "position": ("q", plain(e.coordinates.q[joint.q])),
                "velocity": ("v", plain(e.coordinates.v[joint.v])),
                "acceleration": ("a", lifted[joint.v]),
            }
            for kind, (letter, value) in values.items():
                yield _quantity(f"{joint.name}.{kind}", ca.SX(value), letter, own[letter])

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
        frame, _, rest = name.partition(".")
        kind, _, axis = rest.partition(".")
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
        self._e, self._shown = equations, dict[str, list[Any]]()
        self._sensors = {
            ".".join(filter(None, (one.name, component))): (one, i)
            for one in sensors
            for i, component in enumerate(one.components)
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
        """All names: of sensors, of parts, then of loads of joints."""
        return dict.fromkeys((*self._sensors, *self._outputs, *self._loads))

    def matching(self, pattern: str) -> list[str]:
        """Names of a pattern."""
        return [one for one in self.names if fnmatchcase(one, pattern)]

    def unit(self, name: str) -> str:
        """Unit of the number of a name."""
        if name in self._sensors:
            return self._sensors[name][0].unit
        if name in self._loads:
            return _LOAD[name.rpartition(".")[2]]
        part, i = self._outputs[name]
        return [*numbers_of(part)][i].unit

    def markers(self) -> Iterator[tuple[str, float]]:
        """Coordinates of markers, and the weights of these."""
        for name, (sensor, _) in self._sensors.items():
            if sensor.weight > 0.0:
                yield name, float(sensor.weight)

    def metabolic_rates(self, numbers: Metabolism) -> dict[str, Any]:
        """Muscle -> expression of its metabolic rate [W].

        Args:
            numbers: Of the fibres.
        """
        e, found = self._e, dict[str, Any]()
        for part in e.system.loads.actuators:
            if part.has_metabolic_rate:
                with tracing(part):
                    found[part.name] = e.own(part).metabolic_rate(e.k, e.x, e.u, numbers)
        return found

    @property
    def mass(self) -> float:
        """Of all links [kg]."""
        return float(sum(one.mass for one in self._e.system.model.inertias))

    def value(self, name: str) -> Any:
        """The number of a name, an expression or a float.

        Raises:
            Untraceable: Names a part that has no symbolic form.
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
        if sensor.name not in self._shown:
            now = None
            if sensor.level >= Measures.ACCELERATION:
                now = self._now(np.zeros(0))
            if sensor.level is Measures.FORCE:
                now = now._replace(reactions=self._reactions.felt)
            with tracing(sensor):
                values = sensor.measure(self._e.k, self._e.x, now)
            self._shown[sensor.name] = _flat(values)
        return self._shown[sensor.name]

    def _values(self, part: Part) -> list[Any]:
        """What a part shows, its numbers one after the other."""
        if part.name not in self._shown:
            e, own = self._e, self._e.own(part)
            with tracing(part):
                shown = own.show(e.k, e.x, e.u, self._now(self._rows[part]))
            pairs = zip(part.outputs, shown, strict=True)
            found = [one for out, value in pairs if not out.is_drawn for one in _flat(value)]
            self._shown[part.name] = found
        return self._shown[part.name]

    @cached_property
    def _rows(self) -> dict[Part, Any]:
        """Parts that show something, and the multipliers of their rows."""
        e, lam = self._e, numbers(self._e.symbols["l"])
        every, first = dict[Part, Any](), 0
        for block in e.system.bilateral.constraints.blocks:
            every[block.part] = lam[first : first + len(block.rows)]
            first += len(block.rows)
        none = np.zeros(0)
        every.update((part, none) for part in (*e.system.loads.actuators, *e.system.loads.forces))
        return {part: own for part, own in every.items() if part.outputs}

    def _now(self, lam: Any) -> Now:
        e = self._e
        lifted = e.coordinates.lifted(scalars(e.symbols["a"]))
        whole = np.empty(len(lifted), dtype=object)
        whole[:] = [number(ca.SX(one)) for one in lifted]
        return Now(whole, lam)


def _flat(values: Any) -> list[Any]:
    return list(np.asarray(values, dtype=object).reshape(-1))


def _places(symbols: Any) -> dict[int, int]:
    return {one.element_hash(): i for i, one in enumerate(ca.vertsplit(symbols))}


def _quantity(name: str, value: Any, letter: str, places: dict[int, int]) -> Quantity:
    at = places.get(value.element_hash(), -1) if value.is_symbolic() else -1
    return Quantity(name, value, letter if at >= 0 else "", at)


def input_labels(system: Any) -> list[str]:
    """Names of u: `<joint>.effort` where that is the command, `<name>.command`, or their own."""
    loads, found = system.loads, [""] * len(system.loads.idle)
    for part, names in zip(loads.actuators, command_names(loads.actuators), strict=True):
        for i, name in enumerate(names):
            is_effort = not part.takes and name in part.joints
            kind = ".effort" if is_effort else ".command"
            found[part.u.start + i] = f"{name}{kind}" if part.joints else name
    for part in loads.forces:
        if part.inputs:
            found[part.u] = input_names(part)
    return found


def multiplier_names(e: Any) -> list[str]:
    """Names of the rows that act."""
    rigid = e.system.bilateral.constraints.blocks
    found = [row.name for block in rigid for row in block.rows]
    every = [row.name for row in e.system.multiplier_rows]
    return found + [every[slot] for slot in e.unilateral.slots[: len(e.acting.J) - len(found)]]


class Quantity(NamedTuple):
    """A number of a motion.

    Attributes:
        name: As tasks call it.
        letter: That of the unknown that it is; empty for other expressions.
        index: Its place in that.
    """

    name: str
    value: Any
    letter: str = ""
    index: int = -1


def unilateral_gaps(phase: PhaseEquations) -> list[Quantity]:
    """Gaps of unilateral unilateral_gaps, ropes and contacts, which a motion keeps open.

    Raises:
        ModelError: Names a part whose force jumps otherwise.
    """
    e = phase.equations
    rows = e.system.multiplier_rows
    try:
        gaps = e.unilateral.gaps()
    except Untraceable as error:
        names = ", ".join(rows[slot].name for slot in e.unilateral.slots)
        raise ModelError(
            f"{names}: {error}; accepted: forces that are smooth, such as joint_friction"
        ) from error
    return [Quantity(f"gap of {rows[slot].name}", ca.SX(gap)) for slot, gap in gaps.items()]


def input_bounds(system: Any) -> tuple[Array, Array]:
    """Bounds within which inputs have an effect, shape (nu,) each."""
    lower, upper = np.full((2, len(system.loads.idle)), np.inf) * [[-1.0], [1.0]]
    for part in (*system.loads.actuators, *system.loads.forces):
        if part.inputs:
            lower[part.u] = [one.lower for one in part.inputs]
            upper[part.u] = [one.upper for one in part.inputs]
    return lower, upper
