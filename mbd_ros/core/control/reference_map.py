"""Names of a reference -> controlled joints; dependent joints are mapped to their parents."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.control.reference_limits import TargetError
from mbd_ros.core.couplings import Couplings
from mbd_ros.core.laws import Linear
from mbd_ros.core.state import Array

_MOST = 8  # names in an error


class Selection(NamedTuple):
    """How values of a reference become those of the controlled joints.

        q = (values[columns] - offset) / factor,   v = rates[columns] / factor

    Attributes:
        columns: Of the reference, shape (n,).
        factor: Shape (n,).
        offset: [rad or m], shape (n,).
        note: What was mapped or left out, for people; empty where nothing was.
    """

    columns: NDArray[np.intp]
    factor: Array
    offset: Array
    note: str

    def positions(self, values: Array) -> Array:
        """Positions of the controlled joints from those of the reference, shape (.., n)."""
        return (values[..., self.columns] - self.offset) / self.factor

    def rates(self, values: Array) -> Array:
        """Velocities or accelerations of the controlled joints, shape (.., n)."""
        return values[..., self.columns] / self.factor


class ReferenceMap:
    """Selects the controlled joints from references of any order.

    A joint that follows a controlled one by a linear law may stand for it; beside it, it is left
    out, since the coupling decides where it goes.

    Args:
        names: Controlled joints.
        couplings: Those of the scene.
    """

    def __init__(self, names: Sequence[str], couplings: Couplings) -> None:
        self._names = tuple(names)
        self._linear: dict[str, tuple[str, float, float]] = {}  # independent, factor, offset
        self._dependent = couplings.dependent
        for name, link in zip(couplings.dependent, couplings.links, strict=True):
            parent = couplings.parents[name]
            root, factor, offset = self._linear.get(parent, (parent, 1.0, 0.0))
            followed = parent not in couplings.dependent or parent in self._linear
            if followed and isinstance(link.law, Linear) and link.law.factor != 0.0:
                factor, offset = link.law.factor * factor, link.law.factor * offset
                self._linear[name] = (root, factor, offset + link.law.offset)

    def select(self, given: Sequence[str]) -> Selection:
        """How to read a reference of these names.

        Raises:
            TargetError: A name twice or unknown, or a controlled joint that none of them gives.
        """
        if len(set(given)) != len(given) or not given:
            raise TargetError("reference refused: names are empty or repeated")
        unknown = [n for n in given if n not in self._names and n not in self._dependent]
        if unknown:
            raise TargetError(
                f"reference refused: {_first(unknown)} not controlled; accepted: "
                f"{', '.join(self._names)}, or what follows them"
            )
        columns, factors, offsets, notes = [], [], [], []
        for name in self._names:
            source, factor, offset = name, 1.0, 0.0
            if name not in given:
                source, factor, offset = self._stand_in(name, given)
                notes.append(f"{name} from {source}")
            columns.append(list(given).index(source))
            factors.append(factor)
            offsets.append(offset)
        used = {given[column] for column in columns}
        notes += [f"{name} left out: it follows" for name in given if name not in used]
        return Selection(
            np.array(columns, dtype=np.intp),
            np.array(factors),
            np.array(offsets),
            "; ".join(notes),
        )

    def _stand_in(self, name: str, given: Sequence[str]) -> tuple[str, float, float]:
        for source in given:
            root, factor, offset = self._linear.get(source, ("", 1.0, 0.0))
            if root == name:
                return source, factor, offset
        raise TargetError(
            f"reference refused: {name} is missing; accepted: {', '.join(self._names)}"
        )


def _first(names: Sequence[str]) -> str:
    """Some names for people, however many and long a message has them."""
    some = ", ".join(f"{name:.64}" for name in names[:_MOST])
    return some if len(names) <= _MOST else f"{some} and {len(names) - _MOST} more"
