"""Program of a motion: phases with the linkages between them; and its solution as motions."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.ipopt import KINKED, PIECEWISE, SolverResult, Tell, solve
from mbd_ros.optimal_control.motion_phase import MotionPhase
from mbd_ros.optimal_control.phase_equations import LETTERS
from mbd_ros.optimal_control.phase_motion import PhaseMotion, Unknowns, intermediate_values
from mbd_ros.optimal_control.problem import Range
from mbd_ros.optimal_control.sparse_program import Block, Form, SparseProgram

NARROWEST = 1.0e-3  # of its width: the least that a moving node leaves of an interval
_NODES = "qvz"
_REDUNDANT_ROWS = {"perturb_always_cd": "yes"}  # IPOPT option for redundant conditions


class MotionProgram:
    """Program of a motion on any meshes.

    Args:
        phases: The phases, in order.
        parameters: Unknown numbers of the scene, which are the first unknowns.
        begin: Time at which the first phase begins [s].
        linkages: Linkages between ends of phases.
    """

    def __init__(
        self,
        phases: Sequence[MotionPhase],
        parameters: Sequence[Parameter] = (),
        begin: float = 0.0,
        linkages: Sequence[Linkage] = (),
    ) -> None:
        self.phases = tuple(phases)
        self.parameters = tuple(parameters)
        self._begin = begin
        self._linkages = tuple(linkages)

    def solve(
        self,
        guesses: Sequence[PhaseMotion],
        parameters: Array,
        *,
        accuracy: float = 1.0e-9,
        cost_size: float = 1.0,
        most: int = 1000,
        is_near: bool = False,
        links: Array | None = None,
        has_kinks: bool = False,
        tell: Tell | None = None,
    ) -> Solution:
        """Solve the program on the meshes of the guesses.

        Args:
            guesses: Initial motion of each phase.
            parameters: Initial values of the parameters.
            accuracy: Tolerance of the conditions of optimality, for scaled unknowns.
            cost_size: Characteristic size of the cost.
            most: Largest number of iterations.
            is_near: Whether the guesses solve a program that is nearly this one.
            links: Initial unknowns of the linkages; None for zeros.
            has_kinks: Whether derivatives of the equations may jump.
            tell: Callback after each iteration, as for `ipopt.solve`.
        """
        assembly = self.assemble(guesses, parameters, cost_size, links)
        program, guess, all_unknowns, (lower, upper) = assembly
        more: dict[str, Any] = {"accuracy": accuracy, "most": most, "is_near": is_near}
        more["options"] = dict(_REDUNDANT_ROWS) if self._linkages and not is_near else {}
        if self.has_pieces and not is_near:
            more["options"] |= PIECEWISE
        more["options"] |= KINKED if has_kinks else {}
        solved = solve(program, guess, lower, upper, tell=tell, **more)
        motions = tuple(read_motion(solved.x, unknowns) for unknowns in all_unknowns)
        values = solved.x[: len(self.parameters)]
        link_values = solved.x[all_unknowns[-1].end :]
        return Solution(motions, values, solved, program, tuple(all_unknowns), link_values)

    @property
    def has_pieces(self) -> bool:
        """Whether derivatives of the equations may jump, because couplings are piecewise."""
        return any(phase.equations.has_pieces for phase in self.phases)

    def with_limits(self) -> MotionProgram:
        """Return the program with the limits of all phases and linkages among its rows."""
        phases = [phase.with_limits() for phase in self.phases]
        linkages = [linkage.with_limits() for linkage in self._linkages]
        return MotionProgram(phases, self.parameters, self._begin, linkages)

    def keeps_limits(self, solution: Solution) -> bool:
        """Return whether a solution satisfies the limits that are not rows of the program."""
        first, p = 0, solution.parameters
        for linkage in self._linkages:
            link_values = solution.links[first : first + linkage.count]
            if not linkage.keeps_limits(link_values):
                return False
            first += linkage.count
        pairs = zip(self.phases, solution.motions, strict=True)
        return all(
            phase.keeps_limits(motion, intermediate_values(motion)[0], p)
            for phase, motion in pairs
        )

    def assemble(
        self,
        guesses: Sequence[PhaseMotion],
        parameters: Array,
        cost_size: float,
        links: Array | None = None,
    ) -> tuple[SparseProgram, Array, list[Unknowns], tuple[Array, Array]]:
        """Return the program on the meshes of guesses, the guess, the unknowns and bounds."""
        all_unknowns = self._number_unknowns(guesses)
        guess = np.zeros(all_unknowns[-1].end)
        guess[: len(parameters)] = parameters
        for unknowns, motion in zip(all_unknowns, guesses, strict=True):
            write_motion(guess, unknowns, motion)
        sizes = np.ones(all_unknowns[-1].end)
        sizes[: len(parameters)] = np.maximum(np.abs(parameters), 1.0e-6)
        rows = list[Array]()
        for phase, unknowns, motion in zip(self.phases, all_unknowns, guesses, strict=True):
            usual = phase.characteristic_sizes(motion, np.asarray(parameters))
            usual.write(sizes, unknowns)
            rows.append(usual.rows)
        blocks, end = self._blocks(all_unknowns, sizes, rows)
        guess = np.append(guess, np.zeros(end - len(guess)) if links is None else links)
        sizes = np.append(sizes, np.ones(end - len(sizes)))
        lower, upper = self._bounds(all_unknowns, end)
        known = np.where(lower == upper, lower, np.nan)
        program = SparseProgram(blocks, sizes, known, cost_size)
        return program, np.clip(guess, lower, upper), all_unknowns, (lower, upper)

    def _number_unknowns(self, guesses: Sequence[PhaseMotion]) -> list[Unknowns]:
        numbered, first = list[Unknowns](), len(self.parameters)
        for phase, motion in zip(self.phases, guesses, strict=True):
            numbered.append(Unknowns(phase.equations.sizes, motion.mesh, first))
            first = numbered[-1].end
        return numbered

    def _blocks(
        self, all_unknowns: Sequence[Unknowns], sizes: Array, rows: Sequence[Array]
    ) -> tuple[list[Block], int]:
        blocks = list[Block]()
        for phase, unknowns, usual in zip(self.phases, all_unknowns, rows, strict=True):
            blocks += phase.blocks(unknowns, sizes, usual)
            if unknowns.mesh.free.any():
                blocks += moving_knots(unknowns)
        for before, following in itertools.pairwise(all_unknowns):
            places = np.array([[before.begin, before.duration, following.begin]]).T
            blocks.append(Block("times", _following(), places))
        end = all_unknowns[-1].end
        for linkage in self._linkages:
            more, end = linkage.blocks(all_unknowns, end)
            blocks += more
        return blocks, end

    def _bounds(self, all_unknowns: Sequence[Unknowns], end: int) -> tuple[Array, Array]:
        lower, upper = np.full(end, -np.inf), np.full(end, np.inf)
        for i, parameter in enumerate(self.parameters):
            lower[i], upper[i] = parameter.bounds
        for i, (phase, unknowns) in enumerate(zip(self.phases, all_unknowns, strict=True)):
            bound_widths(unknowns, lower, upper)
            if i == 0:
                lower[unknowns.begin] = upper[unknowns.begin] = self._begin
            phase.write_bounds(unknowns, lower, upper)
        return lower, upper


class Parameter(NamedTuple):
    """An unknown number of the scene.

    Attributes:
        name: Name as `Scene.with_` accepts it.
        bounds: Least and largest value.
        value: Initial value.
    """

    name: str
    bounds: Range
    value: float


class Linkage(Protocol):
    """Conditions that link ends of phases.

    Attributes:
        count: Number of unknowns of the linkage itself.
    """

    count: int

    def blocks(self, all_unknowns: Sequence[Unknowns], first: int) -> tuple[list[Block], int]:
        """Return blocks of rows, and the number after the unknowns that begin with `first`."""

    def with_limits(self) -> Linkage:
        """Return the linkage with the limits of impulses among its rows."""

    def keeps_limits(self, link_values: Array) -> bool:
        """Return whether the unknowns of the linkage satisfy these limits."""


def read_motion(x: Array, unknowns: Unknowns) -> PhaseMotion:
    """Read the motion of a phase from the unknowns of a program."""
    mesh = unknowns.mesh._replace(widths=x[unknowns.widths])
    nodes = {letter: x[unknowns.nodes[letter]] for letter in _NODES}
    points = {letter: x[unknowns.points[letter]] for letter in LETTERS}
    points["d"] = x[unknowns.steps]
    bases = unknowns.sizes.bases
    return PhaseMotion(mesh, x[unknowns.begin], x[unknowns.duration], nodes, points, bases)


def write_motion(x: Array, unknowns: Unknowns, motion: PhaseMotion) -> None:
    """Write a motion into the unknowns of a program, for the same mesh."""
    for letter in _NODES:
        x[unknowns.nodes[letter]] = motion.nodes[letter]
    for letter in LETTERS:
        x[unknowns.points[letter]] = motion.points[letter]
    x[unknowns.begin], x[unknowns.duration] = motion.begin, motion.duration
    x[unknowns.widths] = motion.mesh.widths
    if unknowns.steps.size:
        x[unknowns.steps] = motion.points["d"]


def moving_knots(unknowns: Unknowns) -> list[Block]:
    """Return rows that keep the sum of the intervals between fixed nodes."""
    blocks, run = list[Block](), list[int]()
    for i, moves in enumerate(unknowns.mesh.free):
        run.append(i)
        if not moves and len(run) > 1:
            x = ca.SX.sym("w", len(run))
            total = float(unknowns.mesh.widths[run].sum())
            form = Form(x, ca.SX(0, 1), ca.sum1(x))
            blocks.append(Block("knots", form, unknowns.widths[run][:, None], None, total, total))
        run = run if moves else []
    return blocks


def _following() -> Form:
    begin, T, after = (ca.SX.sym(name) for name in ("b", "T", "a"))
    return Form(ca.vertcat(begin, T, after), ca.SX(0, 1), after - begin - T)


def bound_widths(unknowns: Unknowns, lower: Array, upper: Array) -> None:
    """Write bounds of the widths: fixed, except beside nodes that may move."""
    mesh, free = unknowns.mesh, unknowns.mesh.free
    lower[unknowns.widths] = upper[unknowns.widths] = mesh.widths
    beside: NDArray[np.bool_] = free | np.concatenate(([False], free[:-1]))
    moving = np.flatnonzero(beside)
    lower[unknowns.widths[moving]] = NARROWEST * mesh.widths[moving]
    upper[unknowns.widths[moving]] = 1.0


class Solution(NamedTuple):
    """Solution of a program, or its last iterate.

    Attributes:
        motions: Motion of each phase.
        parameters: Values of the parameters.
        solved: Result of the solver.
        program: The program.
        unknowns: Indices of the unknowns of each phase.
        links: Unknowns of the linkages, such as impulses.
    """

    motions: tuple[PhaseMotion, ...]
    parameters: Array
    solved: SolverResult
    program: SparseProgram
    unknowns: tuple[Unknowns, ...]
    links: Array
