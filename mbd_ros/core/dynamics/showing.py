"""What the parts of a scene show at a state, under the names of columns."""

from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.names import label
from mbd_ros.core.outputs import Kind, Now, Output
from mbd_ros.core.parts import Part
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_NO_ROWS = slice(0, 0)


class Showing:
    """Multipliers of all rows, then the outputs of parts: constraints, then loads.

    Args:
        k: Kinematics, refreshed here where a part reads it.
        layout: All rows.
        loads: Parts without rows.

    Attributes:
        numbers: What `at` gives: scalars, and the components of vectors and poses.
    """

    def __init__(self, k: Kinematics, layout: RowLayout, loads: Sequence[Part] = ()) -> None:
        self._k = k
        every: list[tuple[Part, slice]] = [(block.part, block.slots) for block in layout.blocks]
        every += [(part, _NO_ROWS) for part in loads]
        self._asked = [(part, mine) for part, mine in every if _numbers(part)]
        self._reads = max((part.reads for part, _ in self._asked), default=Reads.NOTHING)
        multipliers = (Output(row.name, row.unit, frame=row.frame) for row in layout.rows)
        shown = (output for part, _ in self._asked for output in _numbers(part))
        self.numbers = (*multipliers, *shown)

    def at(self, x: State, u: Array, a: Array, multipliers: Array) -> Array:
        """Values of `numbers`, shape (len(numbers),), not to be written to.

        Args:
            x: State of all joints.
            u: All inputs.
            a: Accelerations of all joints, shape (nv,).
            multipliers: Of all rows, in the order of the layout.

        Raises:
            ModelError: A part shows something else than it declares; names it.
        """
        if not self._asked:
            return multipliers
        if self._reads:
            self._k.refresh(x.q, x.v, self._reads)
        found = [multipliers]
        for part, mine in self._asked:
            found += _values(part, part.show(self._k, x, u, Now(a, multipliers[mine])))
        return np.concatenate(found)


def _values(part: Part, shown: Sequence[float | Array]) -> Iterator[Array]:
    """Numbers of one part, checked against its outputs."""
    if len(shown) != len(part.outputs):
        raise ModelError(f"{part.name} shows {len(shown)} values, outputs: {len(part.outputs)}")
    for output, value in zip(part.outputs, shown, strict=True):
        if output.kind is not Kind.WRENCH:
            numbers = np.asarray(value, dtype=np.float64).reshape(-1)
            if len(numbers) != len(output.kind.value):
                raise ModelError(
                    f"{label(part, output.name)}: shows {len(numbers)} numbers, a "
                    f"{output.kind.name.lower()} has {len(output.kind.value)}"
                )
            yield numbers


def _numbers(part: Part) -> list[Output]:
    """Its outputs as scalars, without wrenches: what these are made of are numbers already."""
    return [
        output._replace(
            name="_".join(filter(None, (label(part, output.name), word))), kind=Kind.SCALAR
        )
        for output in part.outputs
        if output.kind is not Kind.WRENCH
        for word in output.kind.value
    ]
