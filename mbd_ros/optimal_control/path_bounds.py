"""Bounds all the time of quantities that are no unknowns, as rows of a program."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.defects import PhaseForms
from mbd_ros.optimal_control.phase_equations import LETTERS
from mbd_ros.optimal_control.problem import Range
from mbd_ros.optimal_control.program_block import Block
from mbd_ros.optimal_control.quantities import Quantity
from mbd_ros.optimal_control.unknowns import Unknowns

PATH = "bounds"


class PathBounds:
    """Quantities, their bounds, and what they are at points and between them.

    Args:
        bounds: Quantities and their ranges.
        forms: Of the phase.

    Attributes:
        bounds: As given.
        lower: Shape (k,).
        upper: Shape (k,).
    """

    def __init__(self, bounds: Sequence[tuple[Quantity, Range]], forms: PhaseForms) -> None:
        self.bounds, self._forms = list(bounds), forms
        self.lower, self.upper = np.array([one for _, one in bounds]).reshape(-1, 2).T
        self._size = usual_bounds(self.lower, self.upper)

    def blocks(self, unknowns: Unknowns, sizes: Array) -> list[Block]:
        """The rows at all points of a mesh.

        Args:
            unknowns: Where the unknowns stand.
            sizes: Their usual sizes.
        """
        if not self.bounds:
            return []
        places, shares = self._forms.point_places(unknowns), unknowns.mesh.shares[None]
        size = np.maximum(self._size, self._of_forces(sizes[unknowns.points["l"][0]]))
        return [Block(PATH, self._form, places, shares, self.lower, self.upper, size)]

    def values(self, times: Array, letters: dict[str, Array], p: Array) -> Array:
        """The quantities at some places, shape (m, k).

        Args:
            times: [s], shape (m,).
            letters: Letter -> values, shape (m, ..).
            p: Parameters.
        """
        if not self.bounds:
            return np.zeros((len(times), 0))
        given = [times[None, :], *(letters[key].T for key in LETTERS)]
        given.append(np.tile(p[:, None], len(times)))
        found: Array = self._function.map(len(times))(*given).full().T
        return found

    def holds(self, times: Array, letters: dict[str, Array], p: Array) -> bool:
        """Whether the bounds are kept at all of some places, given as for `values`."""
        found = self.values(times, letters, p)
        return bool(((self.lower <= found) & (found <= self.upper)).all())

    @cached_property
    def _values(self) -> Any:
        return ca.vertcat(*(one.value for one, _ in self.bounds))

    @cached_property
    def _form(self) -> Any:
        return self._forms.point_form(self._values)

    @cached_property
    def _function(self) -> Any:
        symbols = self._forms.phase.symbols
        given = [symbols[key] for key in ("t", *LETTERS, "p")]
        return ca.Function("derived", given, [ca.densify(self._values)])

    def _of_forces(self, multipliers: Array) -> Array:
        """What multipliers of their usual sizes add up to, 0 where they do not count."""
        symbols = self._forms.phase.symbols
        slopes = ca.jacobian(self._values, symbols["l"])
        if not slopes.nnz():
            return np.zeros(len(self.bounds))
        others = [symbols[key] for key in ("t", *"qvzawu", "p")]
        given = [symbols["l"], *others]
        function = ca.Function("slopes", given, [ca.densify(slopes)])
        ones = [np.ones(int(one.numel())) for one in others]
        found: Array = np.abs(function(multipliers, *ones).full()) @ multipliers
        return found


def usual_bounds(lower: Array, upper: Array) -> Array:
    """Usual sizes of quantities by their bounds, 1 at least, shape (k,)."""
    ends = [np.where(np.isfinite(one), np.abs(one), 0.0) for one in (lower, upper)]
    return np.maximum(np.maximum(*ends), 1.0)
