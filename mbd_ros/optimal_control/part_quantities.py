"""What sensors measure, parts show and joints pass on, as expressions of a phase."""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.reactions import SymbolicReactions
from mbd_ros.compiled.symbols.scalar import number, numbers, scalars
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.contracts.outputs import Now
from mbd_ros.core.contracts.parts import Part
from mbd_ros.core.contracts.sensor import Measures, Sensor
from mbd_ros.core.dynamics.output_values import numbers_of
from mbd_ros.core.inverse_dynamics.joint_loads import joined_links
from mbd_ros.core.muscles.metabolic_rate import Metabolism

_LOAD = {
    f"{kind}_{axis}": unit for kind, unit in (("force", "N"), ("moment", "N·m")) for axis in "xyz"
}


class PartQuantities:
    """Numbers of sensors and parts by name, as tables call them; made when they are asked for.

    Args:
        equations: Of the phase.
        sensors: Of the scene.
    """

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
            for joined in joined_links(equations.system.robot)
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
            if hasattr(sensor, "weight") and sensor.weight > 0.0:
                yield name, float(sensor.weight)

    def metabolic_rates(self, numbers: Metabolism) -> dict[str, Any]:
        """Muscle -> expression of its metabolic rate [W].

        Args:
            numbers: Of the fibres.
        """
        e, found = self._e, dict[str, Any]()
        for part in e.system.loads.actuators:
            if hasattr(part, "metabolic_rate"):
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
        for block in e.system.held.constraints.blocks:
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
