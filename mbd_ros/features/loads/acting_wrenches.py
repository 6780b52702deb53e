"""Everything that acts on bodies in a motion, by name: rows, forces, external loads, tensions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contracts import Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import NONE, Array, State

CONSTRAINT, CONTACT, FORCE = "constraint", "contact", "force"
EXTERNAL, MUSCLE = "external wrench", "muscle"


class ActingWrenches:
    """Wrenches of parts on bodies.

    What acts in joints, such as torques of drives and of couplings, is none of them: it goes
    through the reactions of joints.

    Args:
        rows: The rows that multipliers are given for.
        forces: Force terms.
        loads: External loads by name.
        paths: What muscles pull along, by the name of the muscle.
    """

    def __init__(
        self,
        rows: ConstraintRows,
        forces: Sequence[Load],
        loads: Mapping[str, ExternalWrench],
        paths: Mapping[str, Path],
    ) -> None:
        self._rows, self._forces = rows, tuple(forces)
        self._loads, self._paths = dict(loads), dict(paths)

    def at(
        self,
        k: Kinematics,
        x: State,
        multipliers: Array,
        loads: Sequence[Array],
        tensions: Sequence[float],
    ) -> Iterator[Named]:
        """The wrenches at a state.

        Args:
            k: Kinematics there.
            x: State of all joints.
            multipliers: Of the rows, shape (m,).
            loads: One (6,) array [N, N·m] for every external load.
            tensions: One for every path [N].
        """
        for part, mine in zip(self._rows.parts, self._rows.slices, strict=True):
            kind = CONTACT if part.law.kind is Kind.CONE else CONSTRAINT
            yield from _named(part.name, kind, part.wrenches(k, x, multipliers[mine]))
        for force in self._forces:
            kind = CONTACT if getattr(force, "contact", None) is not None else FORCE
            yield from _named(force.name, kind, force.wrenches(k, x, NONE))
        for (name, load), value in zip(self._loads.items(), loads, strict=True):
            yield from _named(name, EXTERNAL, load.wrenches_of(k, value))
        free = np.zeros(3)
        for (name, path), tension in zip(self._paths.items(), tensions, strict=True):
            pulls = path.pulls(k, x)
            pulled = (Wrench(p.frame, p.point, p.force * tension, free) for p in pulls)
            yield from _named(name, MUSCLE, pulled)


class Named(NamedTuple):
    """A wrench on a body, and whose it is.

    Attributes:
        name: Of the part.
        kind: constraint, contact, force, external wrench or muscle.
    """

    name: str
    kind: str
    wrench: Wrench


def _named(
    name: str, kind: str, wrenches: Iterator[Wrench] | tuple[Wrench, ...]
) -> Iterator[Named]:
    return (Named(name, kind, wrench) for wrench in wrenches)
