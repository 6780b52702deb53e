"""What a task says of the state at an end of a phase."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.defects import PhaseForms
from mbd_ros.optimal_control.path_bounds import usual_bounds
from mbd_ros.optimal_control.problem import Range
from mbd_ros.optimal_control.program_block import Block
from mbd_ros.optimal_control.quantities import Quantity
from mbd_ros.optimal_control.unknowns import Unknowns

START, END = "start", "end"
_ROUNDING = 1.0e-9


class EndConditions:
    """Quantities and their ranges at one end.

    Args:
        name: `START` or `END`.
        ranges: Quantities of states, and their ranges.
        forms: Of the phase.

    Attributes:
        ranges: As given.
        derived: Those of quantities that are no unknowns.
    """

    def __init__(
        self, name: str, ranges: Sequence[tuple[Quantity, Range]], forms: PhaseForms
    ) -> None:
        self.name, self.ranges = name, list(ranges)
        self.derived = [one for one in ranges if not one[0].letter]
        if self.derived:
            self._form = forms.node_form(ca.vertcat(*(one.value for one, _ in self.derived)))
        self._forms = forms

    def write(self, unknowns: Unknowns, lower: Array, upper: Array) -> None:
        """Write what they say of single unknowns into their bounds.

        Raises:
            ModelError: They contradict the bounds; names the quantity and both.
        """
        for one, (low, high) in self.ranges:
            if one.letter:
                at = unknowns.nodes[one.letter][0 if self.name == START else -1, one.index]
                self._refuse_outside(one.name, (low, high), (lower[at], upper[at]))
                if low == high:
                    lower[at] = upper[at] = low
                else:
                    lower[at], upper[at] = max(lower[at], low), min(upper[at], high)

    def blocks(self, unknowns: Unknowns) -> list[Block]:
        """Rows of quantities that are no unknowns."""
        if not self.derived:
            return []
        is_end = self.name == END
        nodes = np.array([unknowns.mesh.intervals if is_end else 0])
        low, high = np.array([bounds for _, bounds in self.derived]).T
        places, share = self._forms.node_places(unknowns, nodes), np.array([[float(is_end)]])
        size = usual_bounds(low, high)
        return [Block(self.name, self._form, places, share, low, high, size)]

    def _refuse_outside(self, name: str, asked: Range, bounds: Range) -> None:
        slack = _ROUNDING * (1.0 + max(map(abs, asked)))
        if asked[0] > bounds[1] + slack or asked[1] < bounds[0] - slack:
            raise ModelError(
                f"{name} {asked[0]:g} .. {asked[1]:g} at the {self.name} contradicts its bounds "
                f"{bounds[0]:g} .. {bounds[1]:g}"
            )
