"""Outputs of the parts of a scene at a state, under the names of columns."""

from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.contracts import FrictionCone, Kind, Now, Output, Part, Value, Wrench, label
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint_rows import RowLayout
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_NO_ROWS = slice(0, 0)


class Showing:
    """Multipliers of all rows, internal states, and the outputs of constraints, then of loads.

    Args:
        k: Kinematics, refreshed here where a part reads it.
        loads: Parts without rows.

    Attributes:
        numbers: What `at` gives: scalars, and the components of vectors and poses.
        arrows: What `wrenches` gives.
        cones: Names of what `cones_at` gives.

    Raises:
        ModelError: A part shows a wrench and does not say where it acts.
    """

    def __init__(self, k: Kinematics, layout: RowLayout, loads: Sequence[Part] = ()) -> None:
        self._k = k
        every: list[tuple[Part, slice]] = [(block.part, block.slots) for block in layout.blocks]
        every += [(part, _NO_ROWS) for part in loads]
        self._counted = [pair for pair in every if any(map(_is_number, pair[0].outputs))]
        self._drawn = [pair for pair in every if any(map(_is_arrow, pair[0].outputs))]
        self._coned = [pair for pair in every if any(map(_is_cone, pair[0].outputs))]
        self._internals = Internals([part for part, _ in every])
        states = zip(self._internals.names, self._internals.units, strict=True)
        internals = (Output(name, unit) for name, unit in states)
        multipliers = (Output(row.name, row.unit, frame=row.frame) for row in layout.rows)
        shown = (number for part, _ in self._counted for number in numbers_of(part))
        self.numbers = (*multipliers, *internals, *shown)
        self.arrows = tuple(arrow for part, _ in self._drawn for arrow in _arrows(part))
        coned = (part for part, _ in self._coned)
        self.cones = tuple(
            label(part, one.name) for part in coned for one in filter(_is_cone, part.outputs)
        )

    def at(self, x: State, u: Array, a: Array, multipliers: Array) -> Array:
        """Return values of `numbers`, shape (len(numbers),), not to be written to.

        Args:
            a: Accelerations of all joints, shape (nv,).
            multipliers: Of all rows, in the order of the layout.

        Raises:
            ModelError: A part shows something else than it declares; names it.
        """
        if not self._counted and not self._internals.nz:
            return multipliers
        shown = self._values_of(self._counted, x, u, a, multipliers)
        return np.concatenate(
            [multipliers, x.z, *(v for output, v in shown if _is_number(output))]
        )

    def wrenches(self, x: State, u: Array, a: Array, multipliers: Array) -> list[Wrench]:
        """Values of `arrows`, with where each begins; arguments and errors are those of `at`."""
        shown = self._values_of(self._drawn, x, u, a, multipliers)
        return [self._wrench(*each) for each in shown if _is_arrow(each[0])]

    def cones_at(self, x: State, u: Array, a: Array, multipliers: Array) -> list[FrictionCone]:
        """Return values of `cones`; arguments and errors are those of `at`."""
        shown = self._values_of(self._coned, x, u, a, multipliers)
        return [
            FrictionCone(value[:3], value[3:6], float(value[6]))
            for output, value in shown
            if _is_cone(output)
        ]

    def _wrench(self, output: Output, value: Array) -> Wrench:
        if output.at is None:
            return Wrench(output.frame, value[:3], value[3:6], value[6:])
        return Wrench(output.frame, self._k.position(output.at), value[:3], value[3:])

    def _values_of(
        self,
        parts: Sequence[tuple[Part, slice]],
        x: State,
        u: Array,
        a: Array,
        multipliers: Array,
    ) -> Iterator[tuple[Output, Array]]:
        """Return all outputs of parts."""
        reads = max((part.reads for part, _ in parts), default=Reads.NOTHING)
        if parts:
            self._k.refresh(x.q, x.v, max(reads, Reads.POSITION))
        for part, mine in parts:
            shown = part.show(self._k, x, u, Now(a, multipliers[mine]))
            if len(shown) != len(part.outputs):
                raise ModelError(
                    f"{part.name} shows {len(shown)} values, outputs: {len(part.outputs)}"
                )
            for output, value in zip(part.outputs, shown, strict=True):
                yield output, _checked(part, output, value)


def in_link(k: Kinematics, robot: Robot, wrench: Wrench) -> Array:
    """Return a wrench about the origin and in the axes of the link that it acts on, shape (6,).

    Args:
        k: Kinematics at positions.
        wrench: In world axes, about its point.
    """
    link = robot.point(wrench.frame)
    torque = wrench.torque + np.cross(wrench.point - k.position(link), wrench.force)
    whole = np.concatenate((wrench.force, torque)).reshape(2, 3)
    return whole.dot(k.rotation(link)).ravel()


def _checked(part: Part, output: Output, value: Value) -> Array:
    numbers: Array = np.asarray(value, dtype=np.float64).reshape(-1)
    wanted = len(output.kind.value)
    if len(numbers) != wanted:
        raise ModelError(
            f"{label(part, output.name)}: shows {len(numbers)} numbers, a "
            f"{output.kind.name.lower()} has {wanted}"
        )
    return numbers


def _is_number(output: Output) -> bool:
    """Whether it has columns."""
    return not output.is_drawn


def _is_arrow(output: Output) -> bool:
    return output.kind in (Kind.WRENCH, Kind.PLACED_WRENCH)


def _is_cone(output: Output) -> bool:
    return output.kind is Kind.FRICTION_CONE


def numbers_of(part: Part) -> Iterator[Output]:
    """Return its outputs as scalars."""
    for output in filter(_is_number, part.outputs):
        for word in output.kind.value:
            name = "_".join(filter(None, (label(part, output.name), word)))
            yield output._replace(name=name, kind=Kind.SCALAR)


def _arrows(part: Part) -> Iterator[Output]:
    for output in filter(_is_arrow, part.outputs):
        if output.at is None and output.kind is Kind.WRENCH:
            raise ModelError(f"{label(part, output.name)}: a wrench needs `at`, a point")
        yield output._replace(name=label(part, output.name))
