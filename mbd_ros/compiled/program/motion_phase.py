"""A phase of a motion in a program: its equations, bounds, conditions at ends and costs."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.program.block import Block
from mbd_ros.compiled.program.phase_costs import PhaseCosts, Reference
from mbd_ros.compiled.program.phase_equations import LETTERS, PhaseEquations
from mbd_ros.compiled.program.phase_forms import CLOSING, MOTION, PhaseForms
from mbd_ros.compiled.program.quantities import Quantities, Quantity, input_bounds, stops
from mbd_ros.compiled.program.sizes import Usual, usual_sizes
from mbd_ros.core.prediction.mesh import Numbers
from mbd_ros.core.prediction.problem import PhaseProblem, Range, Ranges
from mbd_ros.core.prediction.unknowns import PhaseMotion, Unknowns
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

START, END, PATH = "start", "end", "bounds"
_AT_NODES = "qvz"
_ROUNDING = 1.0e-9


class MotionPhase:
    """What is asked of a phase, as blocks on any mesh.

    Args:
        problem: What is asked.
        equations: Of the system of the phase.
        parameters: Numbers of the parameters among the unknowns.
        references: What is tracked.
        closes_start: Whether rows have to hold at the beginning, since nothing else makes them.

    Attributes:
        problem: As given.
        equations: As given.
        quantities: By name.
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
    ) -> None:
        self.problem, self.equations = problem, equations
        self.quantities = Quantities(equations)
        self.forms = PhaseForms(equations, parameters)
        self._parameters, self._closes_start = parameters, closes_start
        self._costs = PhaseCosts(problem, self.quantities, self.forms, references)
        self._bounds = self._ranges(problem.bounds, (*LETTERS, "p"))
        self._bounds += [(one, (0.0, np.inf)) for one in stops(equations)]
        self._start = self._ranges(problem.start, _AT_NODES)
        self._end = self._ranges(problem.end, _AT_NODES)
        self._path = self._rows_of(self._bounds, at_points=True)
        self._at_start = self._rows_of(self._start, at_points=False)
        self._at_end = self._rows_of(self._end, at_points=False)

    def bound(self, unknowns: Unknowns, lower: Array, upper: Array) -> None:
        """Write what bounds say of single unknowns."""
        system = self.equations.equations.system
        lower[unknowns.points["u"]], upper[unknowns.points["u"]] = input_bounds(system)
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
        for ranges, node in ((self._start, 0), (self._end, -1)):
            for one, (low, high) in ranges:
                if one.letter:
                    at = unknowns.nodes[one.letter][node, one.index]
                    self._refuse_outside(one.name, node, (low, high), (lower[at], upper[at]))
                    if low == high:
                        lower[at] = upper[at] = low
                    else:
                        lower[at], upper[at] = max(lower[at], low), min(upper[at], high)
        lower[unknowns.duration], upper[unknowns.duration] = self.problem.duration

    @staticmethod
    def _refuse_outside(name: str, node: int, asked: Range, bounds: Range) -> None:
        slack = _ROUNDING * (1.0 + max(map(abs, asked)))
        if asked[0] > bounds[1] + slack or asked[1] < bounds[0] - slack:
            where = "start" if node == 0 else "end"
            raise ModelError(
                f"{name} {asked[0]:g} .. {asked[1]:g} at the {where} contradicts its bounds "
                f"{bounds[0]:g} .. {bounds[1]:g}"
            )

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
        if self._derived is None:
            return found, ends[0], ends[1]
        times = self._spans(shares)
        given = [times, *(values[key].T for key in LETTERS), np.tile(p[:, None], len(shares))]
        more = self._derived.map(len(shares))(*given).full().T
        _, low, high, _ = self._path
        lower, upper = np.append(ends[0], low), np.append(ends[1], high)
        return np.hstack((found, more)), lower, upper

    def names_held(self) -> list[str]:
        """Names of the quantities of `held_between`."""
        sizes = self.equations.sizes
        counts = {"q": sizes.nq, "v": sizes.nv, "z": sizes.nz}
        own = [self.quantities.name_of(key, i) for key in counts for i in range(counts[key])]
        return own + [one.name for one, _ in self.derived_bounds]

    def _spans(self, shares: Array) -> Array:
        """Times of places, if the duration is in the middle of its range."""
        low, high = self.problem.duration
        return (shares * 0.5 * (low + high))[None, :]

    @cached_property
    def _derived(self) -> Any:
        """(t, letters, p) -> quantities of `bounds` that are no unknowns; None without any."""
        if not self.derived_bounds:
            return None
        symbols = self.equations.symbols
        given = [symbols[key] for key in ("t", *LETTERS, "p")]
        values = ca.vertcat(*(one.value for one, _ in self.derived_bounds))
        return ca.Function("derived", given, [ca.densify(values)])

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
        forms, mesh = self.forms, unknowns.mesh
        found = forms.blocks(unknowns, sizes, rows)
        points = forms.point_places(unknowns)
        if self._path is not None:
            form, lower, upper, size = self._path
            found.append(Block(PATH, form, points, mesh.shares[None], lower, upper, size))
        for name, given, node in ((START, self._at_start, 0), (END, self._at_end, mesh.intervals)):
            if given is not None:
                form, lower, upper, size = given
                places = forms.node_places(unknowns, np.array([node]))
                share = np.array([[float(node > 0)]])
                found.append(Block(name, form, places, share, lower, upper, size))
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
        found = []
        for name, (low, high) in given.items():
            for one in self.quantities.find(name):
                self._refuse_elsewhere(one, letters)
                found.append((one, (low, high)))
        return found

    def _refuse_elsewhere(self, one: Quantity, letters: Any) -> None:
        symbols = self.equations.symbols
        known = [*letters, "t", "p"]
        others = [symbols[key] for key in LETTERS if key not in known]
        if others and ca.depends_on(one.value, ca.vertcat(*others)):
            raise ModelError(f"{one.name} has no value at an end alone; accepted: in bounds")

    def _places(self, unknowns: Unknowns, one: Quantity) -> Numbers:
        if one.letter == "p":
            return self._parameters[[one.index]]
        if not one.letter:
            return np.zeros(0, dtype=np.intp)
        places = unknowns.points[one.letter][:, one.index]
        if one.letter in _AT_NODES:
            return np.concatenate((unknowns.nodes[one.letter][:, one.index], places))
        return places

    def _rows_of(self, ranges: Any, *, at_points: bool) -> Any:
        """A form of quantities that are no unknowns, its bounds and usual sizes."""
        derived = [(one, bounds) for one, bounds in ranges if not one.letter]
        if not derived:
            return None
        values = ca.vertcat(*(one.value for one, _ in derived))
        low, high = (np.array(each) for each in zip(*(b for _, b in derived), strict=True))
        finite = [np.where(np.isfinite(one), np.abs(one), 0.0) for one in (low, high)]
        size = np.maximum(np.maximum(*finite), 1.0)
        form = (self.forms.point_form if at_points else self.forms.node_form)(values)
        return form, low, high, size

    @property
    def derived_bounds(self) -> list[tuple[Quantity, Range]]:
        """Quantities of `bounds` that are no unknowns."""
        return [(one, bounds) for one, bounds in self._bounds if not one.letter]

    def row_name(self, block: str, row: int) -> str:
        """What a row of a block at points or nodes is, for messages."""
        ranges = {PATH: self._bounds, START: self._start, END: self._end}.get(block)
        if ranges is not None:
            one, (low, high) = [each for each in ranges if not each[0].letter][row]
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
