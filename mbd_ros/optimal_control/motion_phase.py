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
from mbd_ros.optimal_control.limits import PATH, PathBounds, usual_bounds
from mbd_ros.optimal_control.mesh import Numbers
from mbd_ros.optimal_control.phase_equations import LETTERS, PhaseEquations, Usual, usual_sizes
from mbd_ros.optimal_control.phase_motion import PhaseMotion, Unknowns
from mbd_ros.optimal_control.problem import NONE_GIVEN, GivenInputs, PhaseProblem, Range, Ranges
from mbd_ros.optimal_control.quantities import Quantities, Quantity, input_bounds, stops
from mbd_ros.optimal_control.sparse_program import Block

START, END = "start", "end"
_ROUNDING = 1.0e-9
_AT_NODES = "qvz"
Limits = Sequence[tuple[Quantity, Range]]


class MotionPhase:
    """What is asked of a phase, as blocks on any mesh.

    Args:
        problem: What is asked.
        equations: Of the system of the phase.
        parameters: Numbers of the parameters among the unknowns.
        references: What is tracked.
        closes_start: Whether rows have to hold at the beginning, since nothing else makes them.
        limits: Bounds besides those of the problem, all the time, that `limited` adds.
        sensors: Of the scene, for names of what they measure.
        given: Inputs that are known over time.

    Attributes:
        forms: Equations on meshes.

    Raises:
        ModelError: A quantity that is not there, or has no value where it is asked for.
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
        given: GivenInputs = NONE_GIVEN,
    ) -> None:
        self.problem, self.equations, self.given = problem, equations, given
        self.quantities = Quantities(equations, sensors, given.places.tolist())
        self.forms = PhaseForms(equations, parameters)
        self._parameters, self._closes_start = parameters, closes_start
        self._costs = PhaseCosts(problem, self.quantities, self.forms, references)
        self._bounds = [_as_row(*one) for one in self._ranges(problem.bounds, (*LETTERS, "p"))]
        self._bounds += [(one, (0.0, np.inf)) for one in stops(equations)]
        start, end = (self._ranges(one, _AT_NODES) for one in (problem.start, problem.end))
        self._ends = EndConditions(START, start, self.forms), EndConditions(END, end, self.forms)
        self._path = PathBounds([one for one in self._bounds if not one[0].letter], self.forms)
        self.limits = PathBounds(limits, self.forms)

    def limited(self) -> MotionPhase:
        """The phase with its limits among its bounds."""
        found = copy(self)
        found._bounds = [*self._bounds, *self.limits.bounds]
        found._path = PathBounds([*self._path.bounds, *self.limits.bounds], self.forms)
        found.limits = PathBounds([], self.forms)
        return found

    def keeps_limits(self, motion: PhaseMotion, shares: Array, p: Array) -> bool:
        """Whether a motion keeps the limits at its points and some places between them."""
        if not self.limits.bounds:
            return True
        sets = (motion.mesh.shares, motion.points), (shares, motion.at(shares))
        return all(self.limits.holds(self._times(at), letters, p) for at, letters in sets)

    def bound(self, unknowns: Unknowns, lower: Array, upper: Array) -> None:
        """Write what bounds say of single unknowns."""
        system = self.equations.equations.system
        lower[unknowns.points["u"]], upper[unknowns.points["u"]] = input_bounds(system)
        given = unknowns.points["u"][:, self.given.places]
        lower[given] = upper[given] = self.given.at(unknowns.mesh.shares)
        for places in (unknowns.points["z"], unknowns.nodes["z"]):
            lower[places], upper[places] = system.internals.lower, system.internals.upper
        for one, (low, high) in self._bounds:
            places = self._places(unknowns, one)
            lower[places] = np.maximum(lower[places], low)
            upper[places] = np.minimum(upper[places], high)
            if (lower[places] > upper[places]).any():
                raise ModelError(
                    f"bounds of {one.name}: {low:g} .. {high:g} leave nothing of "
                    f"{lower[places].max():g} .. {upper[places].min():g}"
                )
        for conditions in self._ends:
            conditions.write(unknowns, lower, upper)
        lower[unknowns.duration], upper[unknowns.duration] = self.problem.duration

    def check(self) -> None:
        """Refuse bounds that contradict each other.

        Raises:
            ModelError: Names the quantity and both.
        """
        unknowns = Unknowns(self.equations.sizes, self.problem.mesh, len(self._parameters))
        self.bounds_on(unknowns, unknowns.end)

    def bounds_on(self, unknowns: Unknowns, size: int) -> tuple[Array, Array]:
        """Bounds of all unknowns of a program, infinite for those of others."""
        lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
        self.bound(unknowns, lower, upper)
        return lower, upper

    def state_bounds(self, unknowns: Unknowns) -> tuple[dict[str, Array], dict[str, Array]]:
        """Bounds of q, v and z at points: letter -> of each coordinate."""
        ends = self.bounds_on(unknowns, unknowns.end)
        of = unknowns.points
        lower, upper = ({key: one[of[key][0]] for key in "qvz"} for one in ends)
        return lower, upper

    def held_between(
        self, unknowns: Unknowns, shares: Array, values: dict[str, Array], p: Array
    ) -> tuple[Array, Array, Array]:
        """Quantities of states that have bounds at some places, and these bounds.

        Returns:
            q, v, z, then quantities that are no unknowns, shape (m, k), lower and upper (k,).
        """
        ends = [np.concatenate([one[key] for key in "qvz"]) for one in self.state_bounds(unknowns)]
        found = np.hstack([values[key] for key in "qvz"])
        more = self._path.values(self._times(shares), values, p)
        lower, upper = np.append(ends[0], self._path.lower), np.append(ends[1], self._path.upper)
        return np.hstack((found, more)), lower, upper

    def _times(self, shares: Array) -> Array:
        """Of places, if the duration is in the middle of its range."""
        low, high = self.problem.duration
        return shares * 0.5 * (low + high)

    def names_held(self) -> list[str]:
        """Names of the quantities of `held_between`."""
        sizes = self.equations.sizes
        counts = {"q": sizes.nq, "v": sizes.nv, "z": sizes.nz}
        own = [self.quantities.name_of(key, i) for key in counts for i in range(counts[key])]
        return own + [one.name for one, _ in self.derived_bounds]

    def usual(self, motion: PhaseMotion, p: Array) -> Usual:
        """Usual sizes near a motion."""
        lower, upper = input_bounds(self.equations.equations.system)
        room = upper - lower
        for one, (low, high) in self._bounds:
            if one.letter == "u":
                room[one.index] = min(room[one.index], high - low)
        return usual_sizes(self.equations, motion, p, room)

    def state_at_end(self, given: Ranges, usual: Array) -> Array:
        """q, v and z within some ranges, near usual values."""
        found, sizes = usual.copy(), self.equations.sizes
        first = {"q": 0, "v": sizes.nq, "z": sizes.nq + sizes.nv}
        for one, (low, high) in self._ranges(given, _AT_NODES):
            if one.letter:
                at = first[one.letter] + one.index
                found[at] = min(max(found[at], low), high)
        return found

    def blocks(self, unknowns: Unknowns, sizes: Array, rows: Array) -> list[Block]:
        """All equations, conditions and costs on a mesh.

        Args:
            unknowns: Where the unknowns stand.
            sizes: Their usual sizes.
            rows: Usual sizes of the equations at a point.
        """
        found = [*self.forms.blocks(unknowns, sizes, rows), *self._path.blocks(unknowns, sizes)]
        for conditions in self._ends:
            found += conditions.blocks(unknowns)
        return [*found, *self._closed_start(unknowns), *self._costs.blocks(unknowns)]

    def _closed_start(self, unknowns: Unknowns) -> list[Block]:
        """Rows that hold at the beginning, where it is not given as a whole."""
        equations, lower, upper = self.equations, *self.bounds_on(unknowns, unknowns.end)
        state = np.hstack([unknowns.nodes[key][0] for key in "qv"])
        if not (self._closes_start and equations.sizes.m and (lower < upper)[state].any()):
            return []
        form = self.forms.node_form(ca.vertcat(equations.positions, equations.velocities))
        places = self.forms.node_places(unknowns, np.array([0]))
        return [Block(CLOSING, form, places, np.zeros((1, 1)))]

    def _ranges(self, given: Mapping[str, Range], letters: Any) -> list[tuple[Quantity, Range]]:
        pairs = ((one, r) for name, r in given.items() for one in self.quantities.find(name))
        found = list(pairs)
        for one, _ in found:
            self._refuse_elsewhere(one, letters)
        return found

    def _refuse_elsewhere(self, one: Quantity, letters: Any) -> None:
        symbols = self.equations.symbols
        known = [*letters, "t", "p"]
        others = [symbols[key] for key in LETTERS if key not in known]
        if others and ca.depends_on(one.value, ca.vertcat(*others)):
            raise ModelError(f"{one.name} has no value at an end alone; accepted: in bounds")

    def _places(self, unknowns: Unknowns, one: Quantity) -> Numbers:
        if one.letter in ("", "p"):
            return self._parameters[[one.index] if one.letter else []]
        places = unknowns.points[one.letter][:, one.index]
        if one.letter in _AT_NODES:
            return np.concatenate((unknowns.nodes[one.letter][:, one.index], places))
        return places

    @property
    def derived_bounds(self) -> list[tuple[Quantity, Range]]:
        """Quantities of `bounds` that are no unknowns."""
        return self._path.bounds

    def row_name(self, block: str, row: int) -> str:
        """What a row of a block at points or nodes is, for messages."""
        derived = {PATH: self._path.bounds} | {one.name: one.derived for one in self._ends}
        if block in derived:
            one, (low, high) = derived[block][row]
            accepted = f"{low:g}" if low == high else f"{low:g} .. {high:g}"
            return f"{one.name} {accepted}"
        sizes, name_of = self.equations.sizes, self.quantities.name_of
        if block == MOTION and row < sizes.nv:
            joint = name_of("v", row).removesuffix(".velocity")
            return f"equation of motion of {joint}"
        if block == MOTION and row < sizes.nv + sizes.m:
            return f"acceleration along {name_of('l', row - sizes.nv)}"
        if block == MOTION:
            return f"rate of {name_of('z', row - sizes.nv - sizes.m)}"
        return "closure of loops" if block == CLOSING else ""


def _as_row(one: Quantity, bounds: Range) -> tuple[Quantity, Range]:
    """A multiplier as a quantity that is no unknown: its bounds hold between points too."""
    return (one._replace(letter="", index=-1) if one.letter == "l" else one), bounds


class EndConditions:
    """Quantities and their ranges at one end.

    Args:
        name: `START` or `END`.
        ranges: Quantities of states, and their ranges.

    Attributes:
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
