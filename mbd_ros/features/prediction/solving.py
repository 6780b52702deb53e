"""A program solved on finer and finer meshes, until errors between nodes are small enough."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError
from mbd_ros.features.prediction.problem import Problem
from mbd_ros.features.prediction.replay import simulation_of
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.jobs.progress import PERIOD, Say, announce
from mbd_ros.optimal_control.mesh import Mesh, bracketed, changes, is_settled, refined, with_knots
from mbd_ros.optimal_control.phase_motion import (
    PhaseMotion,
    beyond_bounds,
    errors_of,
    looked_at,
    steps_of,
)
from mbd_ros.optimal_control.problem import body_names

if TYPE_CHECKING:
    from mbd_ros.optimal_control.ipopt import Progress, Tell
    from mbd_ros.optimal_control.motion_program import Solution

_ACCURATE = 1.0e-3  # error of a motion that is a guess
_SAMPLES = 200  # of that motion
_LARGEST = 1.0e3  # times the usual sizes: a motion that goes further is no guess
_PATIENCE = 200  # iterations from a guess before another one is tried
_LOST = (  # the solver found no way, which says nothing of the program
    "Maximum_Iterations_Exceeded",
    "Search_Direction_Becomes_Too_Small",
    "Restoration_Failed",
    "Error_In_Step_Computation",
    "Invalid_Number_Detected",
)
SAVED = 0.03  # of the tolerance: what passing bounds between points may save of the cost
_PART = 0.1  # of what the worst bound of an interval saves: less does not matter
STOPPED = "User_Requested_Stop"
_LEAST = 1.0e-9  # of the usual size of a cost: less is none
_CLOSE = 1.0e-2  # error with which a solution beside a recording leads to that of another mesh
_STAYING = 40  # iterations that go to and fro
_ALIKE = 1.0e-4  # relative difference of their costs
_NEAR = 1.0e-3  # largest violation in them


def solve(problem: Problem, task: PredictTask, say: Say) -> Found:
    """Solve on the first mesh, and on refined ones.

    Args:
        problem: What is solved.
        say: Is told a line a mesh.
    """
    with interruptible() as interruption:
        found = _refined(problem, task, say, interruption)
        if found.keeps_limits or found.is_interrupted:
            return found
        say("contacts that are held would pull or slip: once more within what they can exert")
        limited = problem._replace(program=problem.program.limited())
        near, last = limited, found.solution
        if last.solved.is_good:
            near = limited._replace(
                guesses=list(last.motions), parameters=last.parameters, links=last.links
            )
        again = _refined(near, task, say, interruption)
        if near is not limited and not again.is_converged and not again.is_interrupted:
            again = _refined(limited, task, say, interruption)
        return again._replace(keeps_limits=True, iterations=found.iterations + again.iterations)


def _refined(problem: Problem, task: PredictTask, say: Say, interruption: Interruption) -> Found:
    begin = Beginning(list(problem.guesses), problem.parameters, problem.links)
    total, lines, costs = 0, list[str](), list[float]()
    has_pieces = problem.recording is None and problem.program.has_pieces
    for round_ in range(task.mesh.refinements + 1):
        watcher = _Watcher(round_, interruption, has_pieces=has_pieces)
        solution, spent = solved_from(problem, begin, task, watcher, say)
        solved = solution.solved
        total += spent
        found, looks = _judged(problem, solution, task, total, lines)
        lines.append(mesh_line(round_, solution, found.worst))
        say(lines[-1])
        if not problem.program.keeps_limits(solution):
            return found._replace(keeps_limits=False)
        costs.append(solved.cost)
        is_settled = all(one.is_settled for one in looks) or _is_same(costs, task.tolerance)
        is_done = solved.is_good and found.is_fine and is_settled
        if is_done or not (solved.is_good or watcher.is_staying):
            return found
        if interruption.is_asked:
            return found._replace(is_fine=False, is_interrupted=True)
        guesses = [
            moved(motion, next_mesh(motion.mesh, error, look, task.tolerance))
            for motion, error, look in zip(solution.motions, found.errors, looks, strict=True)
        ]
        size = max(abs(solved.cost), _LEAST * begin.cost_size)
        near = problem.recording is None or found.worst < _CLOSE
        begin = Beginning(guesses, solution.parameters, solution.links, size, near)
    return found


class Found(NamedTuple):
    """A solution, or the last iterate.

    Attributes:
        problem: What was solved.
        solution: Of the last mesh.
        errors: Relative errors between nodes, of each interval of each phase.
        is_fine: Whether the errors are within the tolerance, and no bound is passed too far.
        iterations: On all meshes.
        lines: One a mesh, for people.
        passings: Bounds that are passed between nodes, the worst one first.
        is_interrupted: Whether somebody ended it between two meshes.
        keeps_limits: Whether contacts that are held neither pull nor slip, as far as is known.
    """

    problem: Problem
    solution: Solution
    errors: list[Array]
    is_fine: bool
    iterations: int
    lines: list[str]
    passings: tuple[Passing, ...] = ()
    is_interrupted: bool = False
    keeps_limits: bool = True

    @property
    def is_converged(self) -> bool:
        """Whether conditions of optimality hold and errors are within the tolerance."""
        return self.solution.solved.is_good and self.is_fine

    @property
    def cost(self) -> float:
        """The cost."""
        return self.solution.solved.cost

    @property
    def worst(self) -> float:
        """Largest relative error between nodes."""
        return max(float(one.max(initial=0.0)) for one in self.errors)


def _judged(
    problem: Problem, solution: Solution, task: PredictTask, total: int, lines: list[str]
) -> tuple[Found, list[Look]]:
    """What there is, and what it says of the mesh that it wants."""
    pairs = zip(problem.program.phases, solution.motions, strict=True)
    errors = [error_of(*pair, solution.parameters) for pair in pairs]
    looks = [look_at(problem, i, solution, task) for i in range(len(errors))]
    every = [passing for one in looks for passing in one.passings]
    passings = tuple(sorted(every, key=lambda one: -one.severity))
    found = Found(problem, solution, errors, False, total, lines, passings)
    is_fine = found.worst <= task.tolerance and not any(one.passed.any() for one in looks)
    return found._replace(is_fine=is_fine), looks


def error_of(phase: Any, motion: PhaseMotion, p: Array) -> Array:
    """Relative error of each interval of a phase, shape (n,)."""

    def rates(shares: Array, values: dict[str, Array]) -> tuple[Array, Array]:
        times, interval = motion.begin + motion.duration * shares, motion.mesh.find(shares)[0]
        found = phase.equations.solved(values, times, p)
        spans = motion.duration * motion.mesh.widths[interval]
        return found["a"], phase.equations.calmed(values, found["w"], times, spans, p)

    return errors_of(motion, rates)


def moved(motion: PhaseMotion, mesh: Mesh) -> PhaseMotion:
    """A motion on another mesh."""
    at = motion.at(mesh.shares)
    knots = motion.at(mesh.knots[:-1])
    nodes = {key: np.vstack((knots[key], motion.nodes[key][-1])) for key in "qvz"}
    points: dict[str, Array] = {key: at[key] for key in "qvzawul"}
    points["d"] = steps_of(mesh, nodes["q"], points["q"], motion.bases)
    return PhaseMotion(mesh, motion.begin, motion.duration, nodes, points, motion.bases)


def mesh_line(round_: int, solution: Solution, worst: float) -> str:
    """What is said of a mesh."""
    intervals = sum(motion.mesh.intervals for motion in solution.motions)
    points = sum(int(motion.mesh.degrees.sum()) for motion in solution.motions)
    solved = solution.solved
    return (
        f"mesh {round_ + 1}: {intervals} intervals, {points} points, {solved.iterations} "
        f"iterations, cost {solved.cost:.12g}, error between nodes {worst:.2g}"
    )


def _is_same(costs: Sequence[float], tolerance: float) -> bool:
    """Whether the last mesh changed the cost by less than matters, wherever inputs change."""
    if len(costs) < 2:
        return False
    return abs(costs[-1] - costs[-2]) <= SAVED * tolerance * abs(costs[-1])


class _Watcher:
    """Says on a terminal how far the solver is, and ends what only goes to and fro.

    Where slopes jump at the best motion, steps go from one piece to the other for ever; another
    mesh has its points elsewhere.

    Args:
        round_: Number of the mesh.
        interruption: What ends the solver.
        has_pieces: Whether slopes of the equations may jump.

    Attributes:
        is_staying: Whether it has ended that.
    """

    def __init__(self, round_: int, interruption: Interruption, *, has_pieces: bool) -> None:
        self._round = round_
        self._interruption = interruption
        self._due = 0.0
        self._recent = deque[tuple[float, float]](maxlen=_STAYING) if has_pieces else None
        self.is_staying = False

    def __call__(self, iteration: int, progress: Progress) -> bool:
        if self._recent is not None:
            self._recent.append(progress())
            costs, violations = np.array(self._recent).T
            is_alike = np.ptp(costs) <= _ALIKE * np.abs(costs).max() and violations.max() <= _NEAR
            self.is_staying = len(costs) == _STAYING and bool(is_alike)
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + PERIOD
            cost, violation = progress()
            announce(
                f"predict: mesh {self._round + 1}, iteration {iteration}, cost {cost:.6g}, "
                f"violation {violation:.1e}"
            )
        return self._interruption.is_asked or self.is_staying


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Take SIGINT while the context lasts: Ctrl-C ends the search after an iteration.

    In other threads than the main one nothing is taken.
    """
    found = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield found
        return

    def ask(number: int, frame: object) -> None:
        found.is_asked = True

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield found
    finally:
        signal.signal(signal.SIGINT, before)


class Interruption:
    """Whether somebody asked for the end.

    Attributes:
        is_asked: Whether it was.
    """

    def __init__(self) -> None:
        self.is_asked = False


def solved_from(
    problem: Problem, begin: Beginning, task: PredictTask, tell: Tell, say: Say
) -> tuple[Solution, int]:
    """The solution from a guess, or the last iterate, and the iterations that all of it took.

    From a solution on another mesh the solver looks nearby, then further away; from a guess it
    looks for some time, then from the motion without inputs, then from the guess until the end.
    Free bodies that go where they like begin with the motion without inputs.

    Args:
        problem: What is solved.
        begin: What the program begins with.
        tell: See `MotionProgram.solve`.
        say: Is told where another guess is tried.
    """
    total = 0
    for number, (one, most, word) in enumerate(_attempts(problem, begin, task)):
        if number:
            say(f"no way found from there: once more from {word}")
        solution = problem.program.solve(
            one.guesses,
            one.parameters,
            accuracy=task.accuracy,
            cost_size=one.cost_size,
            most=most,
            is_near=one.is_near,
            links=one.links,
            has_kinks=problem.recording is not None,
            tell=tell,
        )
        total += solution.solved.iterations
        if solution.solved.status not in _LOST:
            break
    return solution, total


class Beginning(NamedTuple):
    """What a program begins with.

    Attributes:
        guesses: Of each phase.
        parameters: Values of parameters.
        links: Unknowns of what links phases; None for zeros.
        cost_size: Usual size of the cost.
        is_near: Whether that solves a program that is nearly this one.
    """

    guesses: list[PhaseMotion]
    parameters: Array
    links: Array | None = None
    cost_size: float = 1.0
    is_near: bool = False


def _attempts(
    problem: Problem, begin: Beginning, task: PredictTask
) -> Iterator[tuple[Beginning, int, str]]:
    """What is begun with, at most so many iterations, and what that is called."""
    most = task.iterations
    some = min(_PATIENCE, most)
    if begin.is_near:
        yield begin, some, ""
        yield begin._replace(is_near=False), most, "a wider search on this mesh"
        return
    if most <= some or problem.recording is not None:
        yield begin, most, ""
        return
    given, drifts = (begin, some, "the given guess"), _drifts(problem, task)
    if not drifts:
        yield given
    by_itself = passive(problem)
    if by_itself is not None:
        yield begin._replace(guesses=by_itself), some, "the motion without inputs"
    if drifts:
        yield given
    yield begin, most, "the given guess, for longer"


def _drifts(problem: Problem, task: PredictTask) -> bool:
    """Whether free bodies go where nothing but their motion says, so that no line leads there."""
    if task.guess or task.guess_file is not None:
        return False
    phase = problem.program.phases[0]
    bodies = {name for base in problem.scene.robot.bases for name in body_names(base.name)}
    found = (one.name for name in phase.problem.end for one in phase.quantities.find(name))
    return bool(bodies) and bodies.isdisjoint(found)


def passive(problem: Problem) -> list[PhaseMotion] | None:
    """The motion without inputs from the beginning of the guess: its equations hold exactly.

    Args:
        problem: Of one phase of a scene without phases and recording; else there is None.
    """
    if len(problem.guesses) > 1 or problem.scene.phases or problem.recording is not None:
        return None
    (guess,) = problem.guesses
    idle = np.array(problem.modes[0].system.loads.idle, dtype=np.float64)
    points = {**guess.points, "u": np.tile(idle, (len(guess.points["u"]), 1))}
    still = guess._replace(points=points)
    simulation = simulation_of(problem.scene, [still], _ACCURATE, _SAMPLES)
    first = State(guess.begin, *(guess.nodes[key][0] for key in "qvz"))
    x = simulation.system.expand(first)
    x = x._replace(mode=problem.modes[0].mode) if problem.modes[0].mode else x
    states = [simulation.system.reduce(x)]
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            states += [simulation.system.reduce(at) for at in simulation.run(x, guess.duration)]
    except MbdError:
        return None
    sampled = {key: np.array([getattr(one, key) for one in states]) for key in "qvz"}
    if not all(np.abs(one).max(initial=0.0) < _LARGEST for one in sampled.values()):
        return None
    times = np.array([one.t for one in states])
    return [_written(still, (times - guess.begin) / guess.duration, sampled)]


def _written(motion: PhaseMotion, shares: Array, sampled: dict[str, Array]) -> PhaseMotion:
    nodes, points = dict(motion.nodes), dict(motion.points)
    for at, found in ((motion.mesh.knots, nodes), (motion.mesh.shares, points)):
        for key, values in sampled.items():
            columns = [np.interp(at, shares, one) for one in values.T]
            found[key] = np.array(columns).reshape(-1, len(at)).T
    for q, _ in motion.bases:
        for found in (nodes, points):
            turn = found["q"][:, q + 3 : q + 7]
            turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    points["d"] = steps_of(motion.mesh, nodes["q"], points["q"], motion.bases)
    return motion._replace(nodes=nodes, points=points)


def look_at(problem: Problem, number: int, solution: Solution, task: PredictTask) -> Look:
    """Look at the bounds of a phase.

    Bounds of states are passed too far where that is more than `accepted_passing`, or where it
    saves more than a share of the tolerance of the cost, by the multipliers of the bounds.
    """
    from mbd_ros.optimal_control.active_bounds import begins_of, path_forces, status_of

    phase, motion = problem.program.phases[number], solution.motions[number]
    unknowns, solved = solution.unknowns[number], solution.solved
    status, nu = status_of(phase, number, solution), motion.points["u"].shape[1]
    knots = changes(motion.mesh, status, motion.points["u"])
    shares, values = looked_at(motion)
    held = phase.held_between(unknowns, shares, values, solution.parameters)
    off = beyond_bounds(*held)
    places = np.hstack([unknowns.points[letter] for letter in "qvz"])
    sizes = 1.0 + np.abs(solved.x[places]).max(axis=0, initial=0.0)
    sizes = np.append(sizes, 1.0 + np.abs(held[0][:, len(sizes) :]).max(axis=0, initial=0.0))
    pulls = np.hstack((np.abs(solved.bound_forces[places]), path_forces(solution, number)))
    pulls = np.add.reduceat(pulls, motion.mesh.first_points[:-1], axis=0)
    saved = pulls * off / (abs(solved.cost) or 1.0)
    passed = (off / sizes > accepted_passing(task)) | _saving(saved, SAVED * task.tolerance)
    return Look(
        knots,
        status[:, nu:],
        begins_of(phase, number, solution),
        passed,
        _passings(phase, motion, held, sizes, saved, task),
        is_settled(motion.mesh, knots),
    )


class Look(NamedTuple):
    """What a solution says of the mesh that it wants.

    Attributes:
        knots: Where bounds of inputs change, as shares of the duration.
        status: Of bounds of states at the points.
        begins: The same at the first node of each interval.
        passed: Which intervals pass which bounds of states too far between their points, (n, k).
        passings: Bounds that are passed at all, the worst one first.
        is_settled: Whether every change of inputs is at a node that could move.
    """

    knots: list[float]
    status: Any
    begins: Any
    passed: Any
    passings: list[Passing]
    is_settled: bool


class Passing(NamedTuple):
    """A bound that is passed between nodes.

    Attributes:
        side: -1 for the lower bound, 1 for the upper one.
        time: Where it is passed furthest [s].
        by: How far there.
        relative: The same, relative to 1 + the largest value.
        saved: What all passing of this bound saves, of the cost.
        severity: The same, relative to what is accepted: too far above 1.
    """

    name: str
    side: int
    bound: float
    time: float
    by: float
    relative: float
    saved: float
    severity: float


def accepted_passing(task: PredictTask) -> float:
    """How far a bound may be passed between nodes, relative to 1 + the largest value.

    Next to a bound whose multiplier is nearly zero a solution wavers by the root of the accuracy
    of the solver, on any mesh. What it saves is held against the tolerance apart from this.
    """
    return max(task.tolerance, math.sqrt(task.accuracy))


def _saving(saved: Array, most: float) -> Any:
    """Which bounds save too much in which intervals, shape (n, k)."""
    of_each = saved.sum(axis=1, keepdims=True)
    if of_each.sum() <= most:
        return np.zeros(saved.shape, dtype=np.bool_)
    rising = np.argsort(of_each[:, 0])
    is_left = np.cumsum(of_each[rising, 0]) <= most / 2.0
    matters = saved > _PART * saved.max(axis=1, keepdims=True)
    matters[rising[is_left]] = False
    return matters


def _passings(
    phase: Any, motion: Any, held: Any, sizes: Array, saved: Array, task: PredictTask
) -> list[Passing]:
    """Bounds that are passed, the worst one first."""
    values, lower, upper = held
    off = np.maximum(np.maximum(lower - values, values - upper), 0.0)
    shares, _ = looked_at(motion)
    found = list[Passing]()
    for k, name in enumerate(phase.names_held()):
        i = int(off[:, k].argmax())
        if off[i, k] > 0.0:
            side = 1 if values[i, k] > upper[k] else -1
            bound = float(upper[k] if side > 0 else lower[k])
            time = float(motion.begin + motion.duration * shares[i])
            by, cost = float(off[i, k]), float(saved[:, k].sum())
            relative = by / float(sizes[k])
            severity = max(relative / accepted_passing(task), cost / (SAVED * task.tolerance))
            found.append(Passing(name, side, bound, time, by, relative, cost, severity))
    return sorted(found, key=lambda one: -one.severity)


def next_mesh(mesh: Mesh, errors: Array, look: Look, tolerance: float) -> Mesh:
    """A mesh on which errors are smaller."""
    if look.passed.any():
        wanted = look.passed | (errors > tolerance)[:, None]
        return bracketed(mesh, look.status, look.begins, wanted)
    return with_knots(refined(mesh, errors, tolerance), look.knots)
