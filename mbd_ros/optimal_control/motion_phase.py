"""A phase of a motion in a program: its equations, bounds, conditions at ends and costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.defects import CLOSING, MOTION, PhaseForms
from mbd_ros.optimal_control.goals import PhaseCosts, Reference
from mbd_ros.optimal_control.limits import PATH, PathBounds, bound_sizes
from mbd_ros.optimal_control.mesh import Numbers
from mbd_ros.optimal_control.phase_equations import (
    LETTERS,
    CharacteristicSizes,
    PhaseEquations,
    characteristic_sizes,
)
from mbd_ros.optimal_control.phase_motion import PhaseMotion, Unknowns
from mbd_ros.optimal_control.problem import (
    NO_PRESCRIBED_INPUTS,
    PhaseProblem,
    PrescribedInputs,
    Range,
    Ranges,
)
from mbd_ros.optimal_control.quantities import Quantities, Quantity, input_bounds, unilateral_gaps
from mbd_ros.optimal_control.sparse_program import Block

START, END = "start", "end"
_ROUNDING = 1.0e-9
_AT_NODES = "qvz"
Limits = Sequence[tuple[Quantity, Range]]


class MotionPhase:
    """Equations, bounds, conditions and costs of a phase, as blocks on any mesh.

    Args:
        problem: Problem of the phase.
        equations: Equations of the system of the phase.
        parameters: Indices of the parameters among the unknowns.
        references: References of tracking goals.
        closes_start: Whether rows are enforced at the beginning, where nothing else does so.
        limits: Additional bounds at all times, which `with_limits` adds to the rows.
        sensors: Sensors of the scene, whose names can be used.
        prescribed: Prescribed inputs.

    Attributes:
        forms: Equations on meshes.

    Raises:
        ModelError: A quantity does not exist, or has no value where it is used.
    """

    def __init__(
        self,
        problem: PhaseProblem,
        equations: PhaseEquations,
        parameters: Numbers,
        references: Reference | None = None,
        *,
        closes_start: bool = False,
        limits: Limits = (),
        sensors: Sequence[Sensor] = (),
        prescribed: PrescribedInputs = NO_PRESCRIBED_INPUTS,
    ) -> None:
        self.problem = problem
        self.equations = equations
        self.prescribed = prescribed
        self.quantities = Quantities(equations, sensors, prescribed.places.tolist())
        self.forms = PhaseForms(equations, parameters)
        self._parameters = parameters
        self._closes_start = closes_start
        self._costs = PhaseCosts(problem, self.quantities, self.forms, references)
        self._bounds = [
            _as_bounded_row(*pair) for pair in self._ranges(problem.bounds, (*LETTERS, "p"))
        ]
        self._bounds += [(gap, (0.0, np.inf)) for gap in unilateral_gaps(equations)]
        start, end = (self._ranges(r, _AT_NODES) for r in (problem.start, problem.end))
        self._ends = EndConditions(START, start, self.forms), EndConditions(END, end, self.forms)
        self._path = PathBounds([pair for pair in self._bounds if not pair[0].letter], self.forms)
        self.limits = PathBounds(limits, self.forms)

    def with_limits(self) -> MotionPhase:
        """Return the phase with its limits among its bounds."""
        phase = copy(self)
        phase._bounds = [*self._bounds, *self.limits.bounds]
        phase._path = PathBounds([*self._path.bounds, *self.limits.bounds], self.forms)
        phase.limits = PathBounds([], self.forms)
        return phase

    def keeps_limits(self, motion: PhaseMotion, shares: Array, p: Array) -> bool:
        """Return whether a motion satisfies the limits at its points and at given shares."""
        if not self.limits.bounds:
            return True
        sets = (motion.mesh.shares, motion.points), (shares, motion.at(shares))
        return all(self.limits.holds(self._times(at), letters, p) for at, letters in sets)

    def write_bounds(self, unknowns: Unknowns, lower: Array, upper: Array) -> None:
        """Write the bounds of single unknowns.

        Raises:
            ModelError: Bounds contradict each other.
        """
        system = self.equations.equations.system
        lower[unknowns.points["u"]], upper[unknowns.points["u"]] = input_bounds(system)
        prescribed = unknowns.points["u"][:, self.prescribed.places]
        lower[prescribed] = upper[prescribed] = self.prescribed.at(unknowns.mesh.shares)
        for places in (unknowns.points["z"], unknowns.nodes["z"]):
            lower[places], upper[places] = system.internals.lower, system.internals.upper
        for quantity, (low, high) in self._bounds:
            places = self._places(unknowns, quantity)
            lower[places] = np.maximum(lower[places], low)
            upper[places] = np.minimum(upper[places], high)
            if (lower[places] > upper[places]).any():
                raise ModelError(
                    f"bounds of {quantity.name}: {low:g} .. {high:g} do not overlap with "
                    f"{lower[places].max():g} .. {upper[places].min():g}"
                )
        for conditions in self._ends:
            conditions.write(unknowns, lower, upper)
        lower[unknowns.duration], upper[unknowns.duration] = self.problem.duration

    def check(self) -> None:
        """Refuse bounds that contradict each other.

        Raises:
            ModelError: Bounds contradict each other; the message names the quantity and both.
        """
        unknowns = Unknowns(self.equations.sizes, self.problem.mesh, len(self._parameters))
        self.bounds_on(unknowns, unknowns.end)

    def bounds_on(self, unknowns: Unknowns, size: int) -> tuple[Array, Array]:
        """Return bounds of all unknowns of a program, infinite for those of other phases."""
        lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
        self.write_bounds(unknowns, lower, upper)
        return lower, upper

    def state_bounds(self, unknowns: Unknowns) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the bounds of q, v and z at points: letter -> bounds of each coordinate."""
        ends = self.bounds_on(unknowns, unknowns.end)
        places = unknowns.points
        lower, upper = ({key: end[places[key][0]] for key in "qvz"} for end in ends)
        return lower, upper

    def bounded_quantities(
        self, unknowns: Unknowns, shares: Array, values: dict[str, Array], p: Array
    ) -> tuple[Array, Array, Array]:
        """Return quantities of states with bounds, at some places, and these bounds.

        Returns:
            q, v, z, then quantities that are not unknowns, shape (m, k), lower and upper (k,).
        """
        ends = [np.concatenate([b[key] for key in "qvz"]) for b in self.state_bounds(unknowns)]
        states = np.hstack([values[key] for key in "qvz"])
        more = self._path.values(self._times(shares), values, p)
        lower, upper = np.append(ends[0], self._path.lower), np.append(ends[1], self._path.upper)
        return np.hstack((states, more)), lower, upper

    def _times(self, shares: Array) -> Array:
        """Return times of shares, for a duration in the middle of its range."""
        low, high = self.problem.duration
        return shares * 0.5 * (low + high)

    def bounded_names(self) -> list[str]:
        """Return the names of the quantities of `bounded_quantities`."""
        sizes = self.equations.sizes
        counts = {"q": sizes.nq, "v": sizes.nv, "z": sizes.nz}
        names = [self.quantities.name_of(key, i) for key in counts for i in range(counts[key])]
        return names + [quantity.name for quantity, _ in self.derived_bounds]

    def characteristic_sizes(self, motion: PhaseMotion, p: Array) -> CharacteristicSizes:
        """Return the characteristic sizes near a motion."""
        lower, upper = input_bounds(self.equations.equations.system)
        room = upper - lower
        for quantity, (low, high) in self._bounds:
            if quantity.letter == "u":
                room[quantity.index] = min(room[quantity.index], high - low)
        return characteristic_sizes(self.equations, motion, p, room)

    def state_at_end(self, ranges: Ranges, state: Array) -> Array:
        """Return the q, v and z within some ranges that are nearest to a state."""
        nearest, sizes = state.copy(), self.equations.sizes
        first = {"q": 0, "v": sizes.nq, "z": sizes.nq + sizes.nv}
        for quantity, (low, high) in self._ranges(ranges, _AT_NODES):
            if quantity.letter:
                at = first[quantity.letter] + quantity.index
                nearest[at] = min(max(nearest[at], low), high)
        return nearest

    def blocks(self, unknowns: Unknowns, sizes: Array, rows: Array) -> list[Block]:
        """Return all equations, conditions and costs on a mesh.

        Args:
            unknowns: Indices of the unknowns.
            sizes: Sizes of the unknowns.
            rows: Sizes of the equations at a point.
        """
        blocks = [*self.forms.blocks(unknowns, sizes, rows), *self._path.blocks(unknowns, sizes)]
        for conditions in self._ends:
            blocks += conditions.blocks(unknowns)
        return [*blocks, *self._closed_start(unknowns), *self._costs.blocks(unknowns)]

    def _closed_start(self, unknowns: Unknowns) -> list[Block]:
        """Return the rows that hold at the beginning, unless the state there is fixed."""
        equations, lower, upper = self.equations, *self.bounds_on(unknowns, unknowns.end)
        state = np.hstack([unknowns.nodes[key][0] for key in "qv"])
        if not (self._closes_start and equations.sizes.m and (lower < upper)[state].any()):
            return []
        form = self.forms.node_form(ca.vertcat(equations.positions, equations.velocities))
        places = self.forms.node_places(unknowns, np.array([0]))
        return [Block(CLOSING, form, places, np.zeros((1, 1)))]

    def _ranges(self, ranges: Mapping[str, Range], letters: Any) -> list[tuple[Quantity, Range]]:
        pairs = [(q, r) for name, r in ranges.items() for q in self.quantities.find(name)]
        for quantity, _ in pairs:
            self._refuse_without_value(quantity, letters)
        return pairs

    def _refuse_without_value(self, quantity: Quantity, letters: Any) -> None:
        symbols = self.equations.symbols
        known = [*letters, "t", "p"]
        others = [symbols[key] for key in LETTERS if key not in known]
        if others and ca.depends_on(quantity.value, ca.vertcat(*others)):
            raise ModelError(
                f"{quantity.name} has no value at the ends of a phase; use it in bounds instead"
            )

    def _places(self, unknowns: Unknowns, quantity: Quantity) -> Numbers:
        if quantity.letter in ("", "p"):
            return self._parameters[[quantity.index] if quantity.letter else []]
        places = unknowns.points[quantity.letter][:, quantity.index]
        if quantity.letter in _AT_NODES:
            return np.concatenate((unknowns.nodes[quantity.letter][:, quantity.index], places))
        return places

    @property
    def derived_bounds(self) -> list[tuple[Quantity, Range]]:
        """Bounded quantities that are not unknowns."""
        return self._path.bounds

    def row_name(self, block: str, row: int) -> str:
        """Return the name of a row of a block at points or nodes, for messages."""
        derived = {PATH: self._path.bounds} | {end.name: end.derived for end in self._ends}
        if block in derived:
            quantity, (low, high) = derived[block][row]
            accepted = f"{low:g}" if low == high else f"{low:g} .. {high:g}"
            return f"{quantity.name} {accepted}"
        sizes, name_of = self.equations.sizes, self.quantities.name_of
        if block == MOTION and row < sizes.nv:
            joint = name_of("v", row).removesuffix(".velocity")
            return f"equation of motion of {joint}"
        if block == MOTION and row < sizes.nv + sizes.m:
            return f"acceleration along {name_of('l', row - sizes.nv)}"
        if block == MOTION:
            return f"rate of {name_of('z', row - sizes.nv - sizes.m)}"
        return "closure of loops" if block == CLOSING else ""


def _as_bounded_row(quantity: Quantity, bounds: Range) -> tuple[Quantity, Range]:
    """Return a multiplier as a derived quantity, since its bounds also hold between points."""
    is_multiplier = quantity.letter == "l"
    return (quantity._replace(letter="", index=-1) if is_multiplier else quantity), bounds


class EndConditions:
    """Ranges of quantities at one end of a phase.

    Args:
        name: `START` or `END`.
        ranges: Quantities of states, and their ranges.

    Attributes:
        derived: Quantities that are not unknowns, and their ranges.
    """

    def __init__(
        self, name: str, ranges: Sequence[tuple[Quantity, Range]], forms: PhaseForms
    ) -> None:
        self.name = name
        self.ranges = list(ranges)
        self.derived = [pair for pair in ranges if not pair[0].letter]
        if self.derived:
            self._form = forms.node_form(ca.vertcat(*(q.value for q, _ in self.derived)))
        self._forms = forms

    def write(self, unknowns: Unknowns, lower: Array, upper: Array) -> None:
        """Write the ranges of single unknowns into their bounds.

        Raises:
            ModelError: A range contradicts the bounds; the message names the quantity and both.
        """
        for quantity, (low, high) in self.ranges:
            if quantity.letter:
                node = 0 if self.name == START else -1
                at = unknowns.nodes[quantity.letter][node, quantity.index]
                self._refuse_outside(quantity.name, (low, high), (lower[at], upper[at]))
                if low == high:
                    lower[at] = upper[at] = low
                else:
                    lower[at], upper[at] = max(lower[at], low), min(upper[at], high)

    def blocks(self, unknowns: Unknowns) -> list[Block]:
        """Return the rows of quantities that are not unknowns."""
        if not self.derived:
            return []
        is_end = self.name == END
        nodes = np.array([unknowns.mesh.intervals if is_end else 0])
        low, high = np.array([bounds for _, bounds in self.derived]).T
        places, share = self._forms.node_places(unknowns, nodes), np.array([[float(is_end)]])
        size = bound_sizes(low, high)
        return [Block(self.name, self._form, places, share, low, high, size)]

    def _refuse_outside(self, name: str, range_: Range, bounds: Range) -> None:
        slack = _ROUNDING * (1.0 + max(map(abs, range_)))
        if range_[0] > bounds[1] + slack or range_[1] < bounds[0] - slack:
            raise ModelError(
                f"{name} {range_[0]:g} .. {range_[1]:g} at the {self.name} contradicts its bounds "
                f"{bounds[0]:g} .. {bounds[1]:g}"
            )
