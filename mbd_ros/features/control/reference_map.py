"""Names of a reference -> controlled joints; dependent joints are mapped to their parents."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import Array
from mbd_ros.features.control.reference_limits import TargetError

_MOST = 8  # names in an error


class Selection(NamedTuple):
    """How values of a reference become those of the controlled joints.

        q = (values[columns] - offset) / factor,   v = rates[columns] / factor

    A joint that the reference does not give has column 0, which means nothing.

    Attributes:
        is_given: Which of the controlled joints the reference gives, shape (n,).
        columns: Of the reference, shape (n,).
        factor: Shape (n,).
        offset: [rad or m], shape (n,).
        note: Joints that were mapped or left out, for people; empty without any.
    """

    is_given: NDArray[np.bool_]
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

    A joint that follows a controlled one by a linear function may stand for it; beside it, it is
    left out, since the coupling decides its position.

    Args:
        names: Controlled joints.
        couplings: Those of the scene.
    """

    def __init__(self, names: Sequence[str], couplings: Couplings) -> None:
        self._names = tuple(names)
        self._linear: dict[str, tuple[str, float, float]] = {}  # independent, factor, offset
        self._roots: dict[str, str] = {}
        for name, pair in zip(couplings.dependent, couplings.pairs, strict=True):
            parent = couplings.parents[name]
            self._roots[name] = self._roots.get(parent, parent)
            root, factor, offset = self._linear.get(parent, (parent, 1.0, 0.0))
            followed = parent not in self._roots or parent in self._linear
            if followed and isinstance(pair.function, Linear) and pair.function.factor != 0.0:
                factor, offset = pair.function.factor * factor, pair.function.factor * offset
                self._linear[name] = (root, factor, offset + pair.function.offset)

    def select(self, given: Sequence[str], *, partial: bool = False) -> Selection:
        """How to read a reference of these names.

        Args:
            given: Names, one a column.
            partial: Whether controlled joints may be left out.

        Raises:
            TargetError: A name twice or unknown, a controlled joint that none of them gives and
                that must be there, or a joint that follows one that is left out.
        """
        self._check(given)
        columns, factors, offsets, notes, missing = [], [], [], [], []
        for name in self._names:
            source, factor, offset = self._source(name, given)
            if source is None:
                missing.append(name)
            elif source != name:
                notes.append(f"{name} from {source}")
            columns.append(0 if source is None else list(given).index(source))
            factors.append(factor)
            offsets.append(offset)
        is_given = np.array([name not in missing for name in self._names])
        self._refuse_missing(missing, given, partial=partial)
        used = {given[column] for column in np.array(columns)[is_given]}
        notes += [f"{name} left out: it follows" for name in given if name not in used]
        notes += [f"{', '.join(missing)} held: not given"] if missing else []
        return Selection(
            is_given,
            np.array(columns, dtype=np.intp),
            np.array(factors),
            np.array(offsets),
            "; ".join(notes),
        )

    def _check(self, given: Sequence[str]) -> None:
        if len(set(given)) != len(given) or not given:
            raise TargetError("reference refused: names are empty or repeated")
        unknown = [n for n in given if n not in self._names and n not in self._roots]
        if unknown:
            raise TargetError(
                f"reference refused: {_first(unknown)} not controlled; accepted: "
                f"{', '.join(self._names)}, or what follows them"
            )

    def _refuse_missing(
        self, missing: Sequence[str], given: Sequence[str], *, partial: bool
    ) -> None:
        """A joint that follows one that is left out would be ignored in silence."""
        if missing and not partial:
            raise TargetError(
                f"reference refused: {missing[0]} is missing; accepted: {', '.join(self._names)}"
            )
        for name in given:
            if self._roots.get(name) in missing:
                raise TargetError(
                    f"reference refused: {name} follows {self._roots[name]} by a function that is "
                    f"not linear; give {self._roots[name]}"
                )

    def _source(self, name: str, given: Sequence[str]) -> tuple[str | None, float, float]:
        """The name that gives a controlled joint, with factor and offset; None without one."""
        if name in given:
            return name, 1.0, 0.0
        for source in given:
            root, factor, offset = self._linear.get(source, ("", 1.0, 0.0))
            if root == name:
                return source, factor, offset
        return None, 1.0, 0.0


def _first(names: Sequence[str]) -> str:
    """Some names for people, of any number and length."""
    some = ", ".join(f"{name:.64}" for name in names[:_MOST])
    return some if len(names) <= _MOST else f"{some} and {len(names) - _MOST} more"
