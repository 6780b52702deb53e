"""The optimal control program of a scene and a task, and its initial guess."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.features.prediction.modes import (
    DrivenScene,
    PhaseMode,
    add_drives,
    build_linkages,
    build_phase_modes,
    consistent_start,
    midpoints,
)
from mbd_ros.features.prediction.recording import (
    Recording,
    References,
    add_recording,
    guess_lines_from_file,
    prescribed_inputs,
)
from mbd_ros.features.prediction.smooth_scene import (
    with_fitted_paths,
    with_smooth_muscles,
    wrapping_paths,
)
from mbd_ros.features.prediction.task import PhaseTask, PredictTask
from mbd_ros.methods.projection.coupled_joints import independent_limits
from mbd_ros.optimal_control.mesh import MOST_INTERVALS, uniform_mesh
from mbd_ros.optimal_control.phase_motion import BODY, PhaseMotion, tangent_steps
from mbd_ros.optimal_control.problem import PhaseProblem, Range, body_names
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.describe.scene_summary import coordinate_names, velocity_names

if TYPE_CHECKING:
    from mbd_ros.optimal_control.motion_phase import MotionPhase
    from mbd_ros.optimal_control.motion_program import MotionProgram

_MOST_STEPS = 30  # Newton steps that close a loop
_CLOSED = 1.0e-9  # rad or m
_LONGEST = 0.5  # rad or m: longest Newton step, so that the guess stays on its branch
_STRIDE = 0.02  # of the duration: distance of closed configurations
Lines = Mapping[str, tuple[float, ...]]
_SHARES = np.linspace(0.0, 1.0, 200)  # of a recording, where ranges of joints are evaluated
_MARGIN = 0.5  # rad or m: range of a joint without limits beyond the values in a task
TracedTask = tuple[Scene, PredictTask, tuple[str, ...]]
_UNIT_TOLERANCE = 1.0e-2  # deviation of the norm of a quaternion that rounding of digits may cause
_FEW = 10  # intervals of the first mesh
_INTERVALS_PER_SECOND = 25  # the same beside a recording


class Problem(NamedTuple):
    """An optimal control program with its initial guess.

    Attributes:
        scene: The scene, with inputs that drive it.
        program: The program.
        guesses: Initial motion of each phase.
        parameters: Initial values of the parameters.
        modes: Systems of the phases.
        links: Initial unknowns of the linkages, such as impulses; None for zeros.
        recording: Recorded motion; None without one.
        changes: Lines about differences of the scene from the given one.
        residuals: Names of the wrenches that drive free bases.
    """

    scene: Scene
    program: MotionProgram
    guesses: list[PhaseMotion]
    parameters: Any
    modes: list[PhaseMode]
    links: Any = None
    recording: Recording | None = None
    changes: tuple[str, ...] = ()
    residuals: tuple[str, ...] = ()


def build_problem(scene: Scene, task: PredictTask) -> Problem:
    """Build the program of a task.

    Raises:
        SceneError: The task does not fit the scene; the message names file and key.
        Untraceable: A part has no symbolic form; the message names it.
    """
    from mbd_ros.optimal_control.motion_program import MotionProgram, Parameter

    where = task.source or scene.name
    bounded = [key for phase in task.phases for key in phase.bounds]
    scene, residuals = add_drives(scene, task.driven_by, bounded)
    scene, task, recording = add_recording(scene, task)
    scene, task, changes = make_traceable(scene, task, recording)
    names = list(task.parameters)
    values = midpoints(task)
    try:
        modes = build_phase_modes(scene, task)
        first = consistent_start(scene, modes[0])
        if recording is not None:
            first = first._replace(t=recording.begin)
        phases = _phases(DrivenScene(scene, residuals), task, modes, first, recording)
        for phase in phases:
            phase.check()
        linkages = build_linkages(scene, task, modes, phases)
        guesses = build_guesses(phases, first, task, recording, modes)
    except ModelError as error:
        raise SceneError(f"{where}: predict: {error}") from error
    pairs = zip(names, values, strict=True)
    parameters = [Parameter(name, task.parameters[name], value) for name, value in pairs]
    program = MotionProgram(phases, parameters, first.t, linkages)
    for phase, guess in zip(phases, guesses, strict=True):
        close_loops(phase.equations, guess, values)
    more = {"recording": recording, "changes": changes, "residuals": residuals}
    return Problem(scene, program, guesses, values, modes, **more)


def make_traceable(
    scene: Scene, task: PredictTask, recording: Recording | None = None
) -> TracedTask:
    """Make a scene twice differentiable, with the muscles of the task, and adapt the task.

    Polynomials replace paths with wrapping, since a numerical search cannot be differentiated.

    Args:
        recording: Recorded motion; None without one.

    Returns:
        Scene, task with bounds of joints within which polynomials hold, and a line per change.

    Raises:
        SceneError: Muscles or paths cannot be replaced.
    """
    lines = list[str]()
    if task.muscles is not None:
        scene, line = with_smooth_muscles(scene, task.muscles)
        lines.append(line)
    if not wrapping_paths(scene):
        return scene, task, tuple(lines)
    limits = dict(_limits(scene, task, recording))
    scene, more, joints = with_fitted_paths(scene, limits)
    fitted = {f"{name}.position": limits[name] for name in sorted(joints)}
    phases = tuple(replace(p, bounds={**p.bounds, **fitted}) for p in task.phases)
    return scene, replace(task, phases=phases), (*lines, *more)


def _limits(
    scene: Scene, task: PredictTask, recording: Recording | None
) -> Iterator[tuple[str, Range]]:
    """Yield ranges of independent joints: bounds of the task, limits, or near named values."""
    q = np.atleast_2d(scene.initial.q)
    if recording is not None:
        q = recording.motion(recording.begin + recording.duration * _SHARES)[0]
    lower, upper = independent_limits(scene.robot, scene.couplings)
    places = {int(v): i for i, v in enumerate(scene.couplings.v_index)}
    for joint in scene.robot.joints:
        if joint.v not in places:
            continue
        index, name = places[joint.v], f"{joint.name}.position"
        named = [*q[:, joint.q].tolist(), *_named_values(task, name)]
        near = min(named) - _MARGIN, max(named) + _MARGIN
        low, high = lower[index], upper[index]
        for phase in task.phases:
            for key, (least, most) in phase.bounds.items():
                if fnmatchcase(name, key):
                    low, high = least, most
        yield (
            joint.name,
            (
                float(low) if np.isfinite(low) else near[0],
                float(high) if np.isfinite(high) else near[1],
            ),
        )


def _named_values(task: PredictTask, name: str) -> Iterator[float]:
    """Yield values of a quantity that a task names, at ends and in its guess."""
    for phase in task.phases:
        for ranges in (phase.start, phase.end):
            for key, limits in ranges.items():
                if fnmatchcase(name, key):
                    yield from (limit for limit in limits if np.isfinite(limit))
    for key, lines in task.guess.items():
        if fnmatchcase(name, key):
            yield from lines


def _phases(
    driven_scene: DrivenScene,
    task: PredictTask,
    modes: Sequence[PhaseMode],
    first: State,
    recording: Recording | None,
) -> list[MotionPhase]:
    from mbd_ros.optimal_control.limits import contact_limits
    from mbd_ros.optimal_control.motion_phase import MotionPhase
    from mbd_ros.optimal_control.phase_equations import PhaseEquations, without_redundant_rows
    from mbd_ros.scene.runs.compiling import traced

    scene, names, phases = driven_scene.scene, list(task.parameters), list[MotionPhase]()
    begin, motion_file = first.t, task.recording.motion if task.recording else None
    references = References(scene, recording, motion_file, begin)
    for i, (mode, phase) in enumerate(zip(modes, task.phases, strict=True)):
        plain = PhaseEquations(traced(scene, mode.system, names, mode.mode).equations)
        equations = without_redundant_rows(plain, first, midpoints(task))
        start = dict(phase.start)
        if i == 0 and not task.start_free:
            start = {**_initial_state_ranges(scene, mode.system, first, phase.start), **start}
        problem = _problem_of_phase(scene, task, phase, start)
        numbers = np.arange(len(names), dtype=np.intp)
        is_open = i == 0 and not task.periodic and not task.symmetric
        shortest, longest = problem.duration
        middle = 0.5 * (shortest + longest) if np.isfinite(longest) else 0.0
        more: dict[str, Any] = {
            "references": references.shifted(begin),
            "closes_start": is_open,
            "sensors": scene.sensors,
            "limits": contact_limits(equations, mode.demands, equations.symbols["l"], task.grip),
            "prescribed": prescribed_inputs(driven_scene, phase.bounds, recording, begin, middle),
        }
        phases.append(MotionPhase(problem, equations, numbers, **more))
        begin += middle
    return phases


def _initial_state_ranges(
    scene: Scene, system: System, first: State, named_ranges: Mapping[str, Range]
) -> dict[str, Range]:
    """Return the initial state of the scene as ranges, except for what a task names."""
    names = integrated_names(scene, len(first.v))
    x, joints = system.expand(first), {joint.name: joint for joint in scene.robot.joints}
    independent = [joints[name] for name in names if name in joints]
    pairs = [(f"{joint.name}.position", x.q[joint.q]) for joint in independent]
    pairs += [(f"{joint.name}.velocity", x.v[joint.v]) for joint in independent]
    for base in scene.robot.bases:
        pose = x.q[base.q].copy()
        pose[:3] += scene.robot.origin
        pairs += list(zip(body_names(base.name), (*pose, *x.v[base.v]), strict=True))
    pairs += list(zip(scene.internals.names, first.z, strict=True))
    return {
        name: (float(value), float(value))
        for name, value in pairs
        if not any(fnmatchcase(name, key) for key in named_ranges)
    }


def integrated_names(scene: Scene, nv: int) -> list[str]:
    """Return the names of the velocities that a system integrates: independent ones, or all."""
    if nv < scene.robot.model.nv:
        return coordinate_names(scene.robot, scene.couplings)
    return velocity_names(scene.robot, range(nv))


def _problem_of_phase(
    scene: Scene, task: PredictTask, phase: PhaseTask, start: Mapping[str, Range]
) -> PhaseProblem:
    assert phase.duration is not None  # given by the task or by the recording
    bounds = {**_default_bounds(scene, phase.bounds), **phase.bounds}
    mesh = uniform_mesh(task.mesh.scheme, _degree(task), _intervals(task, phase.duration))
    bodies = [base.name for base in scene.robot.bases]
    start, end = (with_unit_quaternions(ranges, bodies) for ranges in (start, phase.end))
    return PhaseProblem(phase.phase, phase.duration, bounds, start, end, phase.goals, mesh)


def _default_bounds(scene: Scene, named_ranges: Mapping[str, Range]) -> dict[str, Range]:
    """Return the limits of joints, inputs and internal states that a task does not replace."""
    limits = dict[str, Range]()
    joints = {joint.name: joint for joint in scene.robot.joints}
    has_inherited_limits = not any(part.law.is_rigid for part in scene.constraints)
    lower, upper = independent_limits(scene.robot, scene.couplings)
    names = coordinate_names(scene.robot, scene.couplings)
    for name, low, high in zip(names, lower, upper, strict=True):
        if name not in joints:
            continue
        joint = joints[name]
        inherited = low, high
        limits[f"{name}.position"] = (
            inherited if has_inherited_limits else (joint.lower, joint.upper)
        )
        limits[f"{name}.velocity"] = (-joint.max_velocity, joint.max_velocity)
    return {
        name: bounds
        for name, bounds in limits.items()
        if np.isfinite(bounds).any() and not any(fnmatchcase(name, key) for key in named_ranges)
    }


def _degree(task: PredictTask) -> int:
    return 3 if task.mesh.scheme == "hermite_simpson" else task.mesh.degree


def _intervals(task: PredictTask, duration: Range) -> int:
    """Return the number of intervals of the first mesh, which is larger beside a recording."""
    if task.mesh.intervals is not None:
        return task.mesh.intervals
    if task.recording is None:
        return _FEW
    count = max(_FEW, round(_INTERVALS_PER_SECOND * 0.5 * sum(duration)))
    if count > MOST_INTERVALS:
        source = f"{_INTERVALS_PER_SECOND} per second of the recording"
        raise SceneError(
            f"{task.source}: predict.mesh.intervals: {count} ({source}) is above the accepted "
            f"{MOST_INTERVALS}; give intervals, or shorter times of the recording"
        )
    return count


def with_unit_quaternions(
    named_ranges: Mapping[str, Range], bodies: Sequence[str]
) -> dict[str, Range]:
    """Return ranges at an end, with quaternions of norm 1 where all four numbers are given.

    Raises:
        ModelError: Four numbers are no orientation.
    """
    normalized = dict(named_ranges)
    for body in bodies:
        names = [f"{body}.orientation.{axis}" for axis in "xyzw"]
        ranges = [normalized.get(name, (-math.inf, math.inf)) for name in names]
        if any(low != high for low, high in ranges):
            continue
        values = [low for low, _ in ranges]
        size = math.hypot(*values)
        if abs(size - 1.0) > _UNIT_TOLERANCE:
            raise ModelError(
                f"{body}.orientation: a quaternion (x, y, z, w) must have norm 1, not {size:g}"
            )
        pairs = zip(names, values, strict=True)
        normalized |= {name: (value / size, value / size) for name, value in pairs}
    return normalized


def build_guesses(
    phases: Sequence[MotionPhase],
    first: State,
    task: PredictTask,
    recording: Recording | None = None,
    modes: Sequence[PhaseMode] = (),
) -> list[PhaseMotion]:
    """Build the initial motions: straight lines between the ends of phases, or those of the task.

    Args:
        first: Initial state of the scene, as integrated.
        recording: Recorded motion, which replaces straight lines.
        modes: Systems of the phases.

    Raises:
        ModelError: The guess names a quantity that is not an unknown.
    """
    state, t, motions = np.concatenate((first.q, first.v, first.z)), first.t, list[PhaseMotion]()
    parts, lines = np.linspace(0.0, 1.0, len(phases) + 1), dict(task.guess)
    if task.guess_file is not None:
        lines |= guess_lines_from_file(phases[0].quantities, task.guess_file)
    for i, phase in enumerate(phases):
        motion = _straight_motion(phase, state, t)
        if recording is not None:
            write_recording(phase, modes[i].system, motion, recording)
        _write_lines(phase, motion, lines, (parts[i], parts[i + 1]))
        _equilibrate_fibers(phase, motion, lines)
        motions.append(motion)
        t += motion.duration
        state = np.concatenate([motion.nodes[key][-1] for key in "qvz"])
    return motions


def _straight_motion(phase: MotionPhase, state: Any, begin: float) -> PhaseMotion:
    problem, sizes, mesh = phase.problem, phase.equations.sizes, phase.problem.mesh
    low, high = problem.duration
    duration = 0.5 * (low + high) if np.isfinite(high) else 2.0 * low
    start = phase.state_at_end(problem.start, state)
    finish = phase.state_at_end(problem.end, start)
    nodes, points = dict[str, Any](), dict[str, Any]()
    for shares, values in ((mesh.knots, nodes), (mesh.shares, points)):
        states = start + shares[:, None] * (finish - start)
        cuts = [sizes.nq, sizes.nq + sizes.nv]
        values["q"], values["v"], values["z"] = np.split(states, cuts, axis=1)
    m = len(mesh.shares)
    widths = {"a": sizes.nv, "w": sizes.nz, "u": sizes.nu, "l": sizes.m}
    points |= {key: np.zeros((m, width)) for key, width in widths.items()}
    points["d"] = np.zeros((m + mesh.intervals, 6 * len(sizes.bases)))
    motion = PhaseMotion(mesh, begin, duration, nodes, points, sizes.bases)
    if sizes.bases:
        _move_bodies(phase, motion)
    return motion


def _move_bodies(phase: MotionPhase, motion: PhaseMotion) -> None:
    """Let free bodies screw between their poses at the ends, or continue as they start."""
    ends = (end for name in phase.problem.end for end in phase.quantities.find(name))
    named = {end.index for end in ends if end.letter == "q"}
    for at_q, at_v in motion.bases:
        q, v = slice(at_q, at_q + 7), slice(at_v, at_v + 6)
        first, last = _unit(motion.nodes["q"][0, q]), _unit(motion.nodes["q"][-1, q])
        twist = motion.nodes["v"][0, v].copy()
        if named.intersection(range(at_q, at_q + 7)):
            twist = BODY.difference(first, last) / motion.duration
        for shares, values in (
            (motion.mesh.knots, motion.nodes),
            (motion.mesh.shares, motion.points),
        ):
            steps = shares[:, None] * motion.duration * twist
            values["q"][:, q] = [BODY.integrate(first, step) for step in steps]
            values["v"][:, v] = twist
    steps = tangent_steps(motion.mesh, motion.nodes["q"], motion.points["q"], motion.bases)
    motion.points["d"][:] = steps


def _unit(pose: Any) -> Any:
    """Return the pose with a quaternion of norm 1; the identity replaces a zero quaternion."""
    size = float(np.linalg.norm(pose[3:]))
    return np.append(pose[:3], pose[3:] / size if size > 0.0 else [0.0, 0.0, 0.0, 1.0])


def _write_lines(
    phase: MotionPhase, motion: PhaseMotion, lines: Lines, part: tuple[float, float]
) -> None:
    """Write lines of a guess into a motion, with the velocities that belong to them.

    Args:
        motion: Guess of the phase, which is changed.
        lines: Quantity -> values at equally spaced times of the entire motion.
        part: Shares of the entire motion at which the phase begins and ends.
    """
    flat = {int(i): int(j) for i, j in phase.equations.flat}
    ends = (motion.mesh.knots, motion.nodes), (motion.mesh.shares, motion.points)
    for name, values in lines.items():
        places = np.linspace(0.0, 1.0, len(values))
        for quantity in phase.quantities.find(name):
            if not quantity.letter or quantity.letter == "p":
                raise ModelError(f"guess: {quantity.name} is not an unknown of the motion")
            velocity = f"{quantity.name.removesuffix('position')}velocity"
            for shares, arrays in ends:
                if quantity.letter not in arrays:
                    continue
                at = part[0] + shares * (part[1] - part[0])
                arrays[quantity.letter][:, quantity.index] = np.interp(at, places, values)
                index = quantity.index
                if quantity.letter == "q" and index in flat and velocity not in lines:
                    distinct, inverse = np.unique(at, return_inverse=True)
                    slope = np.gradient(np.interp(distinct, places, values), distinct)[inverse]
                    slope *= part[1] - part[0]
                    arrays["v"][:, flat[index]] = slope / motion.duration


def _equilibrate_fibers(phase: MotionPhase, motion: PhaseMotion, lines: Lines) -> None:
    """Put fibres of muscles with elastic tendons into equilibrium, unless lines name them."""
    system = phase.equations.equations.system
    parts = [part for part in system.internals.parts if getattr(part, "is_elastic", False)]
    named = (quantity for name in lines for quantity in phase.quantities.find(name))
    given = {quantity.index for quantity in named if quantity.letter == "z"}
    free = [part.z.stop - 1 for part in parts if part.z.stop - 1 not in given]
    if not free:
        return
    nodes, u = motion.nodes, np.array(system.loads.idle, dtype=np.float64)
    for i, z in enumerate(nodes["z"]):
        z[free] = np.nan
        x = State(motion.begin, nodes["q"][i], nodes["v"][i], z)
        nodes["z"][i] = system.at_rest(x, u)
    for index in free:
        lengths = nodes["z"][:, index]
        motion.points["z"][:, index] = np.interp(motion.mesh.shares, motion.mesh.knots, lengths)


def write_recording(
    phase: MotionPhase, system: System, motion: PhaseMotion, recording: Recording
) -> None:
    """Write a recorded motion and the minimum-norm inputs that produce it into a guess.

    Args:
        motion: Guess of the phase, which is changed.
    """
    mesh, nodes, points = motion.mesh, motion.nodes, motion.points
    for shares, arrays in ((mesh.knots, nodes), (mesh.shares, points)):
        times = motion.begin + motion.duration * shares
        for key, values in _integrated_motion(system, recording, times).items():
            if key in arrays:
                arrays[key][:] = values
    if motion.bases:
        points["d"][:] = tangent_steps(mesh, nodes["q"], points["q"], motion.bases)
    prescribed = phase.prescribed
    points["u"][:, prescribed.places] = prescribed.at(mesh.shares)
    p = np.zeros(phase.equations.symbols["p"].numel())
    times = motion.begin + motion.duration * mesh.shares
    for key, values in phase.equations.minimum_norm_inputs(
        points, times, p, prescribed.places
    ).items():
        points[key][:] = values


def _integrated_motion(system: System, recording: Recording, times: Array) -> dict[str, Array]:
    """Return positions, velocities and accelerations as integrated: letters q, v, a."""
    states = []
    for t, q, v, a in zip(times, *recording.motion(times), strict=True):
        x = State(float(t), q, v)
        y = system.reduce(x)
        states.append((y.q, y.v, system.reduce(x._replace(v=a)).v))
    columns = zip(*states, strict=True)
    return {key: np.array(values) for key, values in zip("qva", columns, strict=True)}


def close_loops(equations: Any, motion: PhaseMotion, p: Array) -> None:
    """Close the loops of a guess, in configurations and velocities, where that is possible.

    Args:
        equations: Equations of the phase.
        motion: Guess of the phase, which is changed.
    """
    q, shares = motion.nodes["q"], np.concatenate((motion.mesh.knots, motion.mesh.shares))
    transfer_motion = np.abs(q - q[0]).max(axis=0) > 0.0
    flat = equations.flat
    free = np.array([j for i, j in flat if not transfer_motion[i]], dtype=np.intp)
    of_q = {int(j): int(i) for i, j in flat}
    if not equations.sizes.mg or not len(free):
        return
    places = [of_q[int(j)] for j in free]
    fine = np.unique(np.concatenate((shares, np.arange(0.0, 1.0, _STRIDE))))
    closed = np.empty((len(fine), q.shape[1]))
    for i in range(q.shape[1]):
        closed[:, i] = np.interp(fine, motion.mesh.knots, q[:, i])
    follower = closed[0, places].copy()
    speeds = np.empty((len(fine), motion.nodes["v"].shape[1]))
    for i, row in enumerate(closed):
        row[places] = follower
        t = motion.begin + motion.duration * fine[i]
        _close_configuration(equations, t, row, free, places, p)
        follower = row[places].copy()
        columns = motion.nodes["v"].T
        v = np.array([np.interp(fine[i], motion.mesh.knots, column) for column in columns])
        v[free] = 0.0
        _, _, rate, J = equations.rows_at(t, row, v, p)
        v[free] -= np.linalg.lstsq(J[:, free], rate, rcond=None)[0]
        speeds[i] = v
    for at, arrays in ((motion.mesh.knots, motion.nodes), (motion.mesh.shares, motion.points)):
        rows = np.searchsorted(fine, at)
        arrays["q"][:, places] = closed[rows][:, places]
        arrays["v"][:, free] = speeds[rows][:, free]


def _close_configuration(
    equations: Any, t: float, q: Array, free: Array, places: list[int], p: Array
) -> None:
    """Close a configuration by Newton's method on some coordinates, with minimum-norm steps."""
    still = np.zeros(equations.sizes.nv)
    for _ in range(_MOST_STEPS):
        g, J, _, _ = equations.rows_at(t, q, still, p)
        if np.abs(g).max(initial=0.0) < _CLOSED:
            return
        step = np.linalg.lstsq(J[:, free], -g, rcond=None)[0]
        size = float(np.abs(step).max(initial=0.0))
        q[places] += step * min(1.0, _LONGEST / max(size, _LONGEST))
