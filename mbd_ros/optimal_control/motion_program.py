"""Phases of a motion, with what links them, as one program; its solution as motions."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.ipopt import KINKED, PIECEWISE, Solved, Tell, solve
from mbd_ros.optimal_control.motion_phase import MotionPhase
from mbd_ros.optimal_control.phase_equations import LETTERS
from mbd_ros.optimal_control.phase_motion import PhaseMotion, Unknowns, looked_at
from mbd_ros.optimal_control.problem import Range
from mbd_ros.optimal_control.sparse_program import Block, Form, SparseProgram

NARROWEST = 1.0e-3  # of its width: what a node that moves leaves of an interval
_NODES = "qvz"
_TWICE = {"perturb_always_cd": "yes"}  # conditions that depend on each other do no harm


class MotionProgram:
    """A motion as a program on any meshes.

    Args:
        phases: The phases, in order; their parameters are the first unknowns.
        begin: Time at which the first phase begins [s].
        linkages: What links ends of phases.
    """

    def __init__(
        self,
        phases: Sequence[MotionPhase],
        parameters: Sequence[Parameter] = (),
        begin: float = 0.0,
        linkages: Sequence[Linkage] = (),
    ) -> None:
        self.phases, self.parameters = tuple(phases), tuple(parameters)
        self._begin, self._linkages = begin, tuple(linkages)

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
        """Solve on the meshes of guesses.

        Args:
            parameters: Values to begin with.
            accuracy: Of the conditions of optimality, in usual sizes.
            cost_size: Usual size of the cost.
            most: Largest number of iterations.
            is_near: Whether the guesses solve a program that is nearly this one.
            links: Unknowns of the linkages to begin with; None for zeros.
            has_kinks: Whether slopes of the equations may jump.
            tell: See `ipopt.solve`.
        """
        assembled = self.assembled(guesses, parameters, cost_size, links)
        program, guess, every, (lower, upper) = assembled
        more: dict[str, Any] = {"accuracy": accuracy, "most": most, "is_near": is_near}
        more["options"] = dict(_TWICE) if self._linkages and not is_near else {}
        if self.has_pieces and not is_near:
            more["options"] |= PIECEWISE
        more["options"] |= KINKED if has_kinks else {}
        solved = solve(program, guess, lower, upper, tell=tell, **more)
        motions = tuple(read(solved.x, unknowns) for unknowns in every)
        found = solved.x[: len(self.parameters)]
        own = solved.x[every[-1].end :]
        return Solution(motions, found, solved, program, tuple(every), own)

    @property
    def has_pieces(self) -> bool:
        """Whether slopes of the equations may jump, since couplings are made of pieces."""
        return any(phase.equations.has_pieces for phase in self.phases)

    def limited(self) -> MotionProgram:
        """The program with all limits of phases and linkages among its rows."""
        phases = [one.limited() for one in self.phases]
        linkages = [one.limited() for one in self._linkages]
        return MotionProgram(phases, self.parameters, self._begin, linkages)

    def keeps_limits(self, solution: Solution) -> bool:
        """Whether a solution keeps the limits that it did not know."""
        first, p = 0, solution.parameters
        for linkage in self._linkages:
            own = solution.links[first : first + linkage.count]
            if not linkage.keeps_limits(own):
                return False
            first += linkage.count
        pairs = zip(self.phases, solution.motions, strict=True)
        return all(phase.keeps_limits(one, looked_at(one)[0], p) for phase, one in pairs)

    def assembled(
        self,
        guesses: Sequence[PhaseMotion],
        parameters: Array,
        cost_size: float,
        links: Array | None = None,
    ) -> tuple[SparseProgram, Array, list[Unknowns], tuple[Array, Array]]:
        """The program on the meshes of guesses, the guess, the unknowns and their bounds."""
        every = self._numbered(guesses)
        guess = np.zeros(every[-1].end)
        guess[: len(parameters)] = parameters
        for unknowns, motion in zip(every, guesses, strict=True):
            written(guess, unknowns, motion)
        sizes = np.ones(every[-1].end)
        sizes[: len(parameters)] = np.maximum(np.abs(parameters), 1.0e-6)
        rows = list[Array]()
        for phase, unknowns, motion in zip(self.phases, every, guesses, strict=True):
            usual = phase.usual(motion, np.asarray(parameters))
            usual.write(sizes, unknowns)
            rows.append(usual.rows)
        blocks, end = self._blocks(every, sizes, rows)
        guess = np.append(guess, np.zeros(end - len(guess)) if links is None else links)
        sizes = np.append(sizes, np.ones(end - len(sizes)))
        lower, upper = self._bounds(every, end)
        known = np.where(lower == upper, lower, np.nan)
        program = SparseProgram(blocks, sizes, known, cost_size)
        return program, np.clip(guess, lower, upper), every, (lower, upper)

    def _numbered(self, guesses: Sequence[PhaseMotion]) -> list[Unknowns]:
        found, first = list[Unknowns](), len(self.parameters)
        for phase, motion in zip(self.phases, guesses, strict=True):
            found.append(Unknowns(phase.equations.sizes, motion.mesh, first))
            first = found[-1].end
        return found

    def _blocks(
        self, every: Sequence[Unknowns], sizes: Array, rows: Sequence[Array]
    ) -> tuple[list[Block], int]:
        found = list[Block]()
        for phase, unknowns, usual in zip(self.phases, every, rows, strict=True):
            found += phase.blocks(unknowns, sizes, usual)
            if unknowns.mesh.free.any():
                found += moving_knots(unknowns)
        for one, following in itertools.pairwise(every):
            places = np.array([[one.begin, one.duration, following.begin]]).T
            found.append(Block("times", _following(), places))
        end = every[-1].end
        for linkage in self._linkages:
            more, end = linkage.blocks(every, end)
            found += more
        return found, end

    def _bounds(self, every: Sequence[Unknowns], end: int) -> tuple[Array, Array]:
        lower, upper = np.full(end, -np.inf), np.full(end, np.inf)
        for i, one in enumerate(self.parameters):
            lower[i], upper[i] = one.bounds
        for i, (phase, unknowns) in enumerate(zip(self.phases, every, strict=True)):
            bound_widths(unknowns, lower, upper)
            if i == 0:
                lower[unknowns.begin] = upper[unknowns.begin] = self._begin
            phase.bound(unknowns, lower, upper)
        return lower, upper


class Parameter(NamedTuple):
    """A number of the scene that is unknown.

    Attributes:
        name: As `Scene.with_` takes it.
        bounds: Least and largest value.
        value: To begin with.
    """

    name: str
    bounds: Range
    value: float


class Linkage(Protocol):
    """What links ends of phases.

    Attributes:
        count: Unknowns of its own.
    """

    count: int

    def blocks(self, every: Sequence[Unknowns], first: int) -> tuple[list[Block], int]:
        """Blocks of rows, and the number after their own unknowns, which begin with `first`."""

    def limited(self) -> Linkage:
        """With what impulses have to keep among the rows."""

    def keeps_limits(self, own: Array) -> bool:
        """Whether its own unknowns keep that."""


def read(x: Array, unknowns: Unknowns) -> PhaseMotion:
    """The motion of some unknowns."""
    mesh = unknowns.mesh._replace(widths=x[unknowns.widths])
    nodes = {letter: x[unknowns.nodes[letter]] for letter in _NODES}
    points = {letter: x[unknowns.points[letter]] for letter in LETTERS}
    points["d"] = x[unknowns.steps]
    bases = unknowns.sizes.bases
    return PhaseMotion(mesh, x[unknowns.begin], x[unknowns.duration], nodes, points, bases)


def written(x: Array, unknowns: Unknowns, motion: PhaseMotion) -> None:
    """Write a motion on the mesh of some unknowns into these."""
    for letter in _NODES:
        x[unknowns.nodes[letter]] = motion.nodes[letter]
    for letter in LETTERS:
        x[unknowns.points[letter]] = motion.points[letter]
    x[unknowns.begin], x[unknowns.duration] = motion.begin, motion.duration
    x[unknowns.widths] = motion.mesh.widths
    if unknowns.steps.size:
        x[unknowns.steps] = motion.points["d"]


def moving_knots(unknowns: Unknowns) -> list[Block]:
    """Intervals between nodes that stand keep their sum."""
    found, run = list[Block](), list[int]()
    for i, moves in enumerate(unknowns.mesh.free):
        run.append(i)
        if not moves and len(run) > 1:
            x = ca.SX.sym("w", len(run))
            total = float(unknowns.mesh.widths[run].sum())
            form = Form(x, ca.SX(0, 1), ca.sum1(x))
            found.append(Block("knots", form, unknowns.widths[run][:, None], None, total, total))
        run = run if moves else []
    return found


def _following() -> Form:
    begin, T, after = (ca.SX.sym(name) for name in ("b", "T", "a"))
    return Form(ca.vertcat(begin, T, after), ca.SX(0, 1), after - begin - T)


def bound_widths(unknowns: Unknowns, lower: Array, upper: Array) -> None:
    """Write bounds of the widths: fixed, but beside nodes that may move."""
    mesh, free = unknowns.mesh, unknowns.mesh.free
    lower[unknowns.widths] = upper[unknowns.widths] = mesh.widths
    beside: NDArray[np.bool_] = free | np.concatenate(([False], free[:-1]))
    moving = np.flatnonzero(beside)
    lower[unknowns.widths[moving]] = NARROWEST * mesh.widths[moving]
    upper[unknowns.widths[moving]] = 1.0


class Solution(NamedTuple):
    """What was found.

    Attributes:
        motions: Of each phase.
        parameters: Values of the parameters.
        solved: What the solver leaves.
        program: What was solved.
        unknowns: Of each phase.
        links: Unknowns of the linkages, such as impulses.
    """

    motions: tuple[PhaseMotion, ...]
    parameters: Array
    solved: Solved
    program: SparseProgram
    unknowns: tuple[Unknowns, ...]
    links: Array
