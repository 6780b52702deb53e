"""Solution of a program on finer and finer meshes, until errors between nodes are small enough."""

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
from mbd_ros.features.prediction.replay import build_input_simulation
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.jobs.progress import PERIOD, Say, announce
from mbd_ros.optimal_control.mesh import (
    Mesh,
    bracket_changes,
    input_changes,
    insert_nodes,
    is_settled,
    refine_mesh,
)
from mbd_ros.optimal_control.phase_motion import (
    PhaseMotion,
    beyond_bounds,
    collocation_errors,
    intermediate_values,
    tangent_steps,
)
from mbd_ros.optimal_control.problem import body_names

if TYPE_CHECKING:
    from mbd_ros.optimal_control.ipopt import Progress, Tell
    from mbd_ros.optimal_control.motion_program import Solution

_ACCURATE = 1.0e-3  # error of a simulated motion that is a guess
_SAMPLES = 200  # of that motion
_LARGEST = 1.0e3  # times the sizes: a motion that goes further is no guess
_PATIENCE = 200  # iterations from a guess before another one is tried
_LOST_STATUSES = (  # failures of the solver that do not prove that there is no solution
    "Maximum_Iterations_Exceeded",
    "Search_Direction_Becomes_Too_Small",
    "Restoration_Failed",
    "Error_In_Step_Computation",
    "Invalid_Number_Detected",
)
SAVED = 0.03  # of the tolerance: share of the cost that violated bounds between points may save
_RELEVANT_SHARE = 0.1  # of what the worst bound of an interval saves: less is negligible
STOPPED = "User_Requested_Stop"
_LEAST = 1.0e-9  # of the size of the cost: smaller costs count as zero
_CLOSE = 1.0e-2  # error up to which a solution beside a recording is near that of the next mesh
_STAGNATION = 40  # iterations that oscillate
_ALIKE = 1.0e-4  # relative difference of their costs
_NEAR = 1.0e-3  # largest violation in them


def solve(problem: Problem, task: PredictTask, say: Say) -> Prediction:
    """Solve the problem on the first mesh, and on refined ones.

    Args:
        say: Receives a line for each mesh.
    """
    with catch_interrupts() as interruption:
        prediction = _solve_refined(problem, task, say, interruption)
        if prediction.keeps_limits or prediction.is_interrupted:
            return prediction
        say("held contacts would pull or slip; solving again within their friction cones")
        limited = problem._replace(program=problem.program.with_limits())
        near, last = limited, prediction.solution
        if last.solved.is_good:
            near = limited._replace(
                guesses=list(last.motions), parameters=last.parameters, links=last.links
            )
        second = _solve_refined(near, task, say, interruption)
        if near is not limited and not second.is_converged and not second.is_interrupted:
            second = _solve_refined(limited, task, say, interruption)
        return second._replace(
            keeps_limits=True, iterations=prediction.iterations + second.iterations
        )


def _solve_refined(
    problem: Problem, task: PredictTask, say: Say, interruption: Interruption
) -> Prediction:
    """Solve a problem on meshes that are refined until the errors are within the tolerance."""
    begin = InitialGuess(list(problem.guesses), problem.parameters, problem.links)
    total, lines, costs = 0, list[str](), list[float]()
    has_pieces = problem.recording is None and problem.program.has_pieces
    for round_ in range(task.mesh.refinements + 1):
        watcher = _Watcher(round_, interruption, has_pieces=has_pieces)
        solution, spent = solve_from(problem, begin, task, watcher, say)
        solved = solution.solved
        total += spent
        prediction, evaluations = _evaluate_mesh(problem, solution, task, total, lines)
        lines.append(mesh_line(round_, solution, prediction.worst))
        say(lines[-1])
        if not problem.program.keeps_limits(solution):
            return prediction._replace(keeps_limits=False)
        costs.append(solved.cost)
        is_settled = all(evaluation.is_settled for evaluation in evaluations) or _is_same(
            costs, task.tolerance
        )
        is_done = solved.is_good and prediction.is_fine and is_settled
        if is_done or not (solved.is_good or watcher.is_stagnating):
            return prediction
        if interruption.is_requested:
            return prediction._replace(is_fine=False, is_interrupted=True)
        guesses = [
            transfer_motion(motion, next_mesh(motion.mesh, error, evaluation, task.tolerance))
            for motion, error, evaluation in zip(
                solution.motions, prediction.errors, evaluations, strict=True
            )
        ]
        size = max(abs(solved.cost), _LEAST * begin.cost_size)
        near = problem.recording is None or prediction.worst < _CLOSE
        begin = InitialGuess(guesses, solution.parameters, solution.links, size, near)
    return prediction


class Prediction(NamedTuple):
    """A solution, or the last iterate.

    Attributes:
        problem: The problem.
        solution: Solution on the last mesh.
        errors: Relative errors between nodes, of each interval of each phase.
        is_fine: Whether the errors are within the tolerance and no bound is violated too far.
        iterations: Iterations on all meshes.
        lines: Lines for people, one per mesh.
        bound_violations: Bounds that are violated between nodes, the worst one first.
        is_interrupted: Whether the user ended the search between two meshes.
        keeps_limits: Whether held contacts neither pull nor slip, as far as is known.
    """

    problem: Problem
    solution: Solution
    errors: list[Array]
    is_fine: bool
    iterations: int
    lines: list[str]
    bound_violations: tuple[BoundViolation, ...] = ()
    is_interrupted: bool = False
    keeps_limits: bool = True

    @property
    def is_converged(self) -> bool:
        """Whether conditions of optimality hold and errors are within the tolerance."""
        return self.solution.solved.is_good and self.is_fine

    @property
    def cost(self) -> float:
        """Value of the cost."""
        return self.solution.solved.cost

    @property
    def worst(self) -> float:
        """Largest relative error between nodes."""
        return max(float(error.max(initial=0.0)) for error in self.errors)


def _evaluate_mesh(
    problem: Problem, solution: Solution, task: PredictTask, total: int, lines: list[str]
) -> tuple[Prediction, list[MeshEvaluation]]:
    """Return the prediction of a mesh, and what it tells about the next mesh."""
    pairs = zip(problem.program.phases, solution.motions, strict=True)
    errors = [interval_errors(*pair, solution.parameters) for pair in pairs]
    evaluations = [evaluate_bounds(problem, i, solution, task) for i in range(len(errors))]
    violations = [
        violation for evaluation in evaluations for violation in evaluation.bound_violations
    ]
    bound_violations = tuple(sorted(violations, key=lambda violation: -violation.severity))
    prediction = Prediction(problem, solution, errors, False, total, lines, bound_violations)
    is_fine = prediction.worst <= task.tolerance and not any(
        evaluation.passed.any() for evaluation in evaluations
    )
    return prediction._replace(is_fine=is_fine), evaluations


def interval_errors(phase: Any, motion: PhaseMotion, p: Array) -> Array:
    """Return the relative error of each interval of a phase, shape (n,)."""

    def rates(shares: Array, values: dict[str, Array]) -> tuple[Array, Array]:
        times, interval = motion.begin + motion.duration * shares, motion.mesh.find(shares)[0]
        forces = phase.equations.solved(values, times, p)
        spans = motion.duration * motion.mesh.widths[interval]
        return forces["a"], phase.equations.damped_rates(values, forces["w"], times, spans, p)

    return collocation_errors(motion, rates)


def transfer_motion(motion: PhaseMotion, mesh: Mesh) -> PhaseMotion:
    """Return a motion on another mesh."""
    at = motion.at(mesh.shares)
    knots = motion.at(mesh.knots[:-1])
    nodes = {key: np.vstack((knots[key], motion.nodes[key][-1])) for key in "qvz"}
    points: dict[str, Array] = {key: at[key] for key in "qvzawul"}
    points["d"] = tangent_steps(mesh, nodes["q"], points["q"], motion.bases)
    return PhaseMotion(mesh, motion.begin, motion.duration, nodes, points, motion.bases)


def mesh_line(round_: int, solution: Solution, worst: float) -> str:
    """Return a line for people about a mesh."""
    intervals = sum(motion.mesh.intervals for motion in solution.motions)
    points = sum(int(motion.mesh.degrees.sum()) for motion in solution.motions)
    solved = solution.solved
    return (
        f"mesh {round_ + 1}: {intervals} intervals, {points} points, {solved.iterations} "
        f"iterations, cost {solved.cost:.12g}, error between nodes {worst:.2g}"
    )


def _is_same(costs: Sequence[float], tolerance: float) -> bool:
    """Return whether the last mesh changed the cost by a negligible amount."""
    if len(costs) < 2:
        return False
    return abs(costs[-1] - costs[-2]) <= SAVED * tolerance * abs(costs[-1])


class _Watcher:
    """Reports the progress of the solver on a terminal, and stops it if it oscillates.

    Where derivatives jump at the optimal motion, iterates oscillate between two pieces forever;
    another mesh has its points elsewhere.

    Args:
        round_: Number of the mesh.
        interruption: Request of the user to stop.
        has_pieces: Whether derivatives of the equations may jump.

    Attributes:
        is_staying: Whether the solver was stopped because it oscillates.
    """

    def __init__(self, round_: int, interruption: Interruption, *, has_pieces: bool) -> None:
        self._round = round_
        self._interruption = interruption
        self._due = 0.0
        self._recent = deque[tuple[float, float]](maxlen=_STAGNATION) if has_pieces else None
        self.is_stagnating = False

    def __call__(self, iteration: int, progress: Progress) -> bool:
        if self._recent is not None:
            self._recent.append(progress())
            costs, violations = np.array(self._recent).T
            is_alike = np.ptp(costs) <= _ALIKE * np.abs(costs).max() and violations.max() <= _NEAR
            self.is_stagnating = len(costs) == _STAGNATION and bool(is_alike)
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + PERIOD
            cost, violation = progress()
            announce(
                f"predict: mesh {self._round + 1}, iteration {iteration}, cost {cost:.6g}, "
                f"violation {violation:.1e}"
            )
        return self._interruption.is_requested or self.is_stagnating


@contextmanager
def catch_interrupts() -> Iterator[Interruption]:
    """Catch SIGINT while the context lasts: Ctrl-C ends the search after an iteration.

    Outside of the main thread, no signal is caught.
    """
    interruption = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return

    def request(number: int, frame: object) -> None:
        interruption.is_requested = True

    before = signal.signal(signal.SIGINT, request)
    try:
        yield interruption
    finally:
        signal.signal(signal.SIGINT, before)


class Interruption:
    """Request of the user to stop.

    Attributes:
        is_requested: Whether the user has requested a stop.
    """

    def __init__(self) -> None:
        self.is_requested = False


def solve_from(
    problem: Problem, begin: InitialGuess, task: PredictTask, tell: Tell, say: Say
) -> tuple[Solution, int]:
    """Return the solution from a guess, or the last iterate, and the iterations of all attempts.

    From a solution on another mesh the solver searches nearby, then further away. From a guess it
    searches for some time, then from the motion without inputs, then from the guess until the
    end. If nothing determines where free bodies go, the motion without inputs is tried first.

    Args:
        begin: Initial guess.
        tell: Callback of the solver, see `MotionProgram.solve`.
        say: Receives a line when another guess is tried.
    """
    total = 0
    for number, (guess, most, word) in enumerate(_attempts(problem, begin, task)):
        if number:
            say(f"the solver found no solution from there; trying {word}")
        solution = problem.program.solve(
            guess.guesses,
            guess.parameters,
            accuracy=task.accuracy,
            cost_size=guess.cost_size,
            most=most,
            is_near=guess.is_near,
            links=guess.links,
            has_kinks=problem.recording is not None,
            tell=tell,
        )
        total += solution.solved.iterations
        if solution.solved.status not in _LOST_STATUSES:
            break
    return solution, total


class InitialGuess(NamedTuple):
    """Initial guess of a program.

    Attributes:
        guesses: Motion of each phase.
        parameters: Values of the parameters.
        links: Unknowns of the linkages between phases; None for zeros.
        cost_size: Size of the cost.
        is_near: Whether the guess solves a program that is nearly this one.
    """

    guesses: list[PhaseMotion]
    parameters: Array
    links: Array | None = None
    cost_size: float = 1.0
    is_near: bool = False


def _attempts(
    problem: Problem, begin: InitialGuess, task: PredictTask
) -> Iterator[tuple[InitialGuess, int, str]]:
    """Yield guesses, largest numbers of iterations, and names of the guesses."""
    most = task.iterations
    patience = min(_PATIENCE, most)
    if begin.is_near:
        yield begin, patience, ""
        yield begin._replace(is_near=False), most, "a wider search on this mesh"
        return
    if most <= patience or problem.recording is not None:
        yield begin, most, ""
        return
    first_guess, drifts = (begin, patience, "the given guess"), _drifts(problem, task)
    if not drifts:
        yield first_guess
    without_inputs = unactuated_motion(problem)
    if without_inputs is not None:
        yield begin._replace(guesses=without_inputs), patience, "the motion without inputs"
    if drifts:
        yield first_guess
    yield begin, most, "the given guess for longer"


def _drifts(problem: Problem, task: PredictTask) -> bool:
    """Return whether no bound or guess determines where free bodies go."""
    if task.guess or task.guess_file is not None:
        return False
    phase = problem.program.phases[0]
    bodies = {name for base in problem.scene.robot.bases for name in body_names(base.name)}
    names = (end.name for name in phase.problem.end for end in phase.quantities.find(name))
    return bool(bodies) and bodies.isdisjoint(names)


def unactuated_motion(problem: Problem) -> list[PhaseMotion] | None:
    """Simulate the motion without inputs from the beginning of the guess.

    Returns:
        The motion, which satisfies the equations of motion; None if the scene has phases, the task
        has several phases or a recording, or the motion diverges.
    """
    if len(problem.guesses) > 1 or problem.scene.phases or problem.recording is not None:
        return None
    (guess,) = problem.guesses
    idle = np.array(problem.modes[0].system.loads.idle, dtype=np.float64)
    points = {**guess.points, "u": np.tile(idle, (len(guess.points["u"]), 1))}
    still = guess._replace(points=points)
    simulation = build_input_simulation(problem.scene, [still], _ACCURATE, _SAMPLES)
    first = State(guess.begin, *(guess.nodes[key][0] for key in "qvz"))
    x = simulation.system.expand(first)
    x = x._replace(mode=problem.modes[0].mode) if problem.modes[0].mode else x
    states = [simulation.system.reduce(x)]
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            states += [simulation.system.reduce(at) for at in simulation.run(x, guess.duration)]
    except MbdError:
        return None
    sampled = {key: np.array([getattr(x, key) for x in states]) for key in "qvz"}
    if not all(np.abs(values).max(initial=0.0) < _LARGEST for values in sampled.values()):
        return None
    times = np.array([x.t for x in states])
    return [_write_samples(still, (times - guess.begin) / guess.duration, sampled)]


def _write_samples(motion: PhaseMotion, shares: Array, sampled: dict[str, Array]) -> PhaseMotion:
    """Return a motion with sampled positions, velocities and internal states."""
    nodes, points = dict(motion.nodes), dict(motion.points)
    for at, values in ((motion.mesh.knots, nodes), (motion.mesh.shares, points)):
        for key, samples in sampled.items():
            columns = [np.interp(at, shares, column) for column in samples.T]
            values[key] = np.array(columns).reshape(-1, len(at)).T
    for q, _ in motion.bases:
        for values in (nodes, points):
            quaternion = values["q"][:, q + 3 : q + 7]
            quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    points["d"] = tangent_steps(motion.mesh, nodes["q"], points["q"], motion.bases)
    return motion._replace(nodes=nodes, points=points)


def evaluate_bounds(
    problem: Problem, number: int, solution: Solution, task: PredictTask
) -> MeshEvaluation:
    """Evaluate the bounds of a phase between its points.

    Bounds of states are violated too far where that is more than `accepted_violation`, or where it
    saves more than a share of the tolerance of the cost, by the multipliers of the bounds.
    """
    from mbd_ros.optimal_control.active_bounds import bound_status, initial_status, path_forces

    phase, motion = problem.program.phases[number], solution.motions[number]
    unknowns, solved = solution.unknowns[number], solution.solved
    status, nu = bound_status(phase, number, solution), motion.points["u"].shape[1]
    knots = input_changes(motion.mesh, status, motion.points["u"])
    shares, values = intermediate_values(motion)
    bounded = phase.bounded_quantities(unknowns, shares, values, solution.parameters)
    off = beyond_bounds(*bounded)
    places = np.hstack([unknowns.points[letter] for letter in "qvz"])
    sizes = 1.0 + np.abs(solved.x[places]).max(axis=0, initial=0.0)
    sizes = np.append(sizes, 1.0 + np.abs(bounded[0][:, len(sizes) :]).max(axis=0, initial=0.0))
    pulls = np.hstack((np.abs(solved.bound_forces[places]), path_forces(solution, number)))
    pulls = np.add.reduceat(pulls, motion.mesh.first_points[:-1], axis=0)
    saved = pulls * off / (abs(solved.cost) or 1.0)
    passed = (off / sizes > accepted_violation(task)) | _costly_violations(
        saved, SAVED * task.tolerance
    )
    return MeshEvaluation(
        knots,
        status[:, nu:],
        initial_status(phase, number, solution),
        passed,
        _violations(phase, motion, bounded, sizes, saved, task),
        is_settled(motion.mesh, knots),
    )


class MeshEvaluation(NamedTuple):
    """Evaluation of a solution that determines the next mesh.

    Attributes:
        knots: Shares of the duration at which bounds of inputs change.
        status: Status of bounds of states at the points.
        begins: Status of bounds of states at the first node of each interval.
        passed: Which intervals violate which bounds of states too far between points, (n, k).
        bound_violations: Bounds that are violated at all, the worst one first.
        is_settled: Whether every change of inputs is at a node that could move.
    """

    knots: list[float]
    status: Any
    begins: Any
    passed: Any
    bound_violations: list[BoundViolation]
    is_settled: bool


class BoundViolation(NamedTuple):
    """Violation of a bound between nodes.

    Attributes:
        name: Name of the quantity.
        side: -1 for the lower bound, 1 for the upper one.
        bound: The bound.
        time: Time of the largest violation [s].
        by: Largest violation.
        relative: Largest violation relative to 1 + the largest value.
        saved: Share of the cost that all violations of this bound save.
        severity: Ratio to what is accepted; above 1 is too far.
    """

    name: str
    side: int
    bound: float
    time: float
    by: float
    relative: float
    saved: float
    severity: float


def accepted_violation(task: PredictTask) -> float:
    """Return the accepted violation of a bound between nodes, relative to 1 + the largest value.

    Near a bound whose multiplier is nearly zero, a solution varies by the root of the accuracy of
    the solver, on any mesh. The cost that this saves is compared with the tolerance separately.
    """
    return max(task.tolerance, math.sqrt(task.accuracy))


def _costly_violations(saved: Array, most: float) -> Any:
    """Return which bounds save too much in which intervals, shape (n, k)."""
    per_interval = saved.sum(axis=1, keepdims=True)
    if per_interval.sum() <= most:
        return np.zeros(saved.shape, dtype=np.bool_)
    rising = np.argsort(per_interval[:, 0])
    is_negligible = np.cumsum(per_interval[rising, 0]) <= most / 2.0
    matters = saved > _RELEVANT_SHARE * saved.max(axis=1, keepdims=True)
    matters[rising[is_negligible]] = False
    return matters


def _violations(
    phase: Any, motion: Any, bounded: Any, sizes: Array, saved: Array, task: PredictTask
) -> list[BoundViolation]:
    """Return the violated bounds, the worst one first."""
    values, lower, upper = bounded
    off = np.maximum(np.maximum(lower - values, values - upper), 0.0)
    shares, _ = intermediate_values(motion)
    violations = list[BoundViolation]()
    for k, name in enumerate(phase.bounded_names()):
        i = int(off[:, k].argmax())
        if off[i, k] > 0.0:
            side = 1 if values[i, k] > upper[k] else -1
            bound = float(upper[k] if side > 0 else lower[k])
            time = float(motion.begin + motion.duration * shares[i])
            by, cost = float(off[i, k]), float(saved[:, k].sum())
            relative = by / float(sizes[k])
            severity = max(relative / accepted_violation(task), cost / (SAVED * task.tolerance))
            violations.append(
                BoundViolation(name, side, bound, time, by, relative, cost, severity)
            )
    return sorted(violations, key=lambda violation: -violation.severity)


def next_mesh(mesh: Mesh, errors: Array, evaluation: MeshEvaluation, tolerance: float) -> Mesh:
    """Return a mesh on which errors are smaller."""
    if evaluation.passed.any():
        wanted = evaluation.passed | (errors > tolerance)[:, None]
        return bracket_changes(mesh, evaluation.status, evaluation.begins, wanted)
    return insert_nodes(refine_mesh(mesh, errors, tolerance), evaluation.knots)
