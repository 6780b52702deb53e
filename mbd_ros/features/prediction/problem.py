"""A scene and a task -> a program and the guess that it begins with."""

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
    Driven,
    PhaseMode,
    driven,
    linkages_of,
    middles,
    modes_of,
    started,
)
from mbd_ros.features.prediction.recording import (
    Recording,
    References,
    given_inputs,
    recorded,
    recorded_lines,
)
from mbd_ros.features.prediction.smooth_scene import (
    with_fitted_paths,
    with_smooth_muscles,
    wrapping,
)
from mbd_ros.features.prediction.task import PhaseTask, PredictTask
from mbd_ros.methods.projection.coupled_joints import independent_limits
from mbd_ros.optimal_control.mesh import MOST_INTERVALS, uniform_mesh
from mbd_ros.optimal_control.phase_motion import BODY, PhaseMotion, steps_of
from mbd_ros.optimal_control.problem import PhaseProblem, Range, body_names
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.describe.scene_summary import coordinate_names, velocity_names

if TYPE_CHECKING:
    from mbd_ros.optimal_control.motion_phase import MotionPhase
    from mbd_ros.optimal_control.motion_program import MotionProgram

_MOST = 30  # Newton steps that close a loop
_CLOSED = 1.0e-9  # rad or m
_LONGEST = 0.5  # rad or m of a Newton step: the guess stays on the branch that it is on
_STRIDE = 0.02  # of the duration: from one closed configuration to the next
Lines = Mapping[str, tuple[float, ...]]
_SHARES = np.linspace(0.0, 1.0, 200)  # of a recording, where its joints are looked at
_BESIDE = 0.5  # rad or m beyond what a task names of a joint without limits
Changed = tuple[Scene, PredictTask, tuple[str, ...]]
_OFF = 1.0e-2  # of the size of a quaternion: what rounding of digits may leave
_FEW = 10  # intervals of the first mesh
_A_SECOND = 25  # intervals a second beside a recording


class Problem(NamedTuple):
    """What is solved.

    Attributes:
        scene: The scene, driven.
        guesses: Of each phase.
        parameters: Values to begin with.
        modes: The systems of the phases.
        links: Unknowns of what links phases, such as impulses; None for zeros.
        recording: Of the motion; None without one.
        changes: What the scene has otherwise than the one that was given, a line each.
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


def problem_of(scene: Scene, task: PredictTask) -> Problem:
    """The program of a task.

    Raises:
        SceneError: Names file and key.
        Untraceable: Names a part that has no symbolic form.
    """
    from mbd_ros.optimal_control.motion_program import MotionProgram, Parameter

    where, bounded = task.source or scene.name, [key for one in task.phases for key in one.bounds]
    scene, residuals = driven(scene, task.driven_by, bounded)
    scene, task, recording = recorded(scene, task)
    scene, task, changes = traceable(scene, task, recording)
    names = list(task.parameters)
    values = middles(task)
    try:
        modes = modes_of(scene, task)
        first = started(scene, modes[0])
        if recording is not None:
            first = first._replace(t=recording.begin)
        phases = _phases(Driven(scene, residuals), task, modes, first, recording)
        for phase in phases:
            phase.check()
        linkages = linkages_of(scene, task, modes, phases)
        guesses = guesses_of(phases, first, task, recording, modes)
    except ModelError as error:
        raise SceneError(f"{where}: predict: {error}") from error
    pairs = zip(names, values, strict=True)
    parameters = [Parameter(name, task.parameters[name], value) for name, value in pairs]
    program = MotionProgram(phases, parameters, first.t, linkages)
    for phase, guess in zip(phases, guesses, strict=True):
        close_loops(phase.equations, guess, values)
    more = {"recording": recording, "changes": changes, "residuals": residuals}
    return Problem(scene, program, guesses, values, modes, **more)


def traceable(scene: Scene, task: PredictTask, recording: Recording | None = None) -> Changed:
    """A scene with derivatives of every order, and the task for it.

    It has the muscles of the task, and polynomials in place of paths that wrap: what is searched
    for has no symbols.

    Args:
        recording: Of the motion; None without one.

    Returns:
        Scene, task with bounds of joints within which polynomials hold, and a line a change.

    Raises:
        SceneError: Muscles or paths that cannot be replaced.
    """
    lines = list[str]()
    if task.muscles is not None:
        scene, line = with_smooth_muscles(scene, task.muscles)
        lines.append(line)
    if not wrapping(scene):
        return scene, task, tuple(lines)
    limits = dict(_limits(scene, task, recording))
    scene, more, joints = with_fitted_paths(scene, limits)
    held = {f"{name}.position": limits[name] for name in sorted(joints)}
    phases = tuple(replace(one, bounds={**one.bounds, **held}) for one in task.phases)
    return scene, replace(task, phases=phases), (*lines, *more)


def _limits(
    scene: Scene, task: PredictTask, recording: Recording | None
) -> Iterator[tuple[str, Range]]:
    """Ranges of independent joints: bounds of the task, else limits, else near what is named."""
    q = np.atleast_2d(scene.initial.q)
    if recording is not None:
        q = recording.motion(recording.begin + recording.duration * _SHARES)[0]
    lower, upper = independent_limits(scene.robot, scene.couplings)
    places = {int(v): i for i, v in enumerate(scene.couplings.v_index)}
    for joint in scene.robot.joints:
        if joint.v not in places:
            continue
        at, name = places[joint.v], f"{joint.name}.position"
        named = [*q[:, joint.q].tolist(), *_named(task, name)]
        near = min(named) - _BESIDE, max(named) + _BESIDE
        low, high = lower[at], upper[at]
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


def _named(task: PredictTask, name: str) -> Iterator[float]:
    """Values that a task has of a quantity, at ends and in its guess."""
    for phase in task.phases:
        for given in (phase.start, phase.end):
            for key, values in given.items():
                if fnmatchcase(name, key):
                    yield from (one for one in values if np.isfinite(one))
    for key, lines in task.guess.items():
        if fnmatchcase(name, key):
            yield from lines


def _phases(
    given: Driven,
    task: PredictTask,
    modes: Sequence[PhaseMode],
    first: State,
    recording: Recording | None,
) -> list[MotionPhase]:
    from mbd_ros.optimal_control.limits import held_limits
    from mbd_ros.optimal_control.motion_phase import MotionPhase
    from mbd_ros.optimal_control.phase_equations import PhaseEquations, independent
    from mbd_ros.scene.runs.compiling import traced

    scene, names, found = given.scene, list(task.parameters), list[MotionPhase]()
    begin, motion_file = first.t, task.recording.motion if task.recording else None
    references = References(scene, recording, motion_file, begin)
    for i, (mode, asked) in enumerate(zip(modes, task.phases, strict=True)):
        plain = PhaseEquations(traced(scene, mode.system, names, mode.mode).equations)
        equations = independent(plain, first, middles(task))
        start = dict(asked.start)
        if i == 0 and not task.start_free:
            start = {**_start_of(scene, mode.system, first, asked.start), **start}
        problem = _problem_of_phase(scene, task, asked, start)
        numbers = np.arange(len(names), dtype=np.intp)
        is_open = i == 0 and not task.periodic and not task.symmetric
        shortest, longest = problem.duration
        middle = 0.5 * (shortest + longest) if np.isfinite(longest) else 0.0
        more: dict[str, Any] = {
            "references": references.since(begin),
            "closes_start": is_open,
            "sensors": scene.sensors,
            "limits": held_limits(equations, mode.demands, equations.symbols["l"], task.grip),
            "given": given_inputs(given, asked.bounds, recording, begin, middle),
        }
        found.append(MotionPhase(problem, equations, numbers, **more))
        begin += middle
    return found


def _start_of(
    scene: Scene, system: System, first: State, given: Mapping[str, Range]
) -> dict[str, Range]:
    """The state in which the scene starts, but for what a task names."""
    names = integrated_names(scene, len(first.v))
    x, joints = system.expand(first), {joint.name: joint for joint in scene.robot.joints}
    own = [joints[name] for name in names if name in joints]
    pairs = [(f"{joint.name}.position", x.q[joint.q]) for joint in own]
    pairs += [(f"{joint.name}.velocity", x.v[joint.v]) for joint in own]
    for base in scene.robot.bases:
        pose = x.q[base.q].copy()
        pose[:3] += scene.robot.origin
        pairs += list(zip(body_names(base.name), (*pose, *x.v[base.v]), strict=True))
    pairs += list(zip(scene.internals.names, first.z, strict=True))
    return {
        name: (float(value), float(value))
        for name, value in pairs
        if not any(fnmatchcase(name, key) for key in given)
    }


def integrated_names(scene: Scene, nv: int) -> list[str]:
    """Names of the velocities that a system integrates: independent ones, or all."""
    if nv < scene.robot.model.nv:
        return coordinate_names(scene.robot, scene.couplings)
    return velocity_names(scene.robot, range(nv))


def _problem_of_phase(
    scene: Scene, task: PredictTask, asked: PhaseTask, start: Mapping[str, Range]
) -> PhaseProblem:
    assert asked.duration is not None  # a recording says it, or the task does
    bounds = {**_usual_bounds(scene, asked.bounds), **asked.bounds}
    mesh = uniform_mesh(task.mesh.scheme, _degree(task), _intervals(task, asked.duration))
    bodies = [base.name for base in scene.robot.bases]
    start, end = (with_unit_turns(one, bodies) for one in (start, asked.end))
    return PhaseProblem(asked.phase, asked.duration, bounds, start, end, asked.goals, mesh)


def _usual_bounds(scene: Scene, given: Mapping[str, Range]) -> dict[str, Range]:
    """Limits of joints, which a task may replace, and of inputs and internal states."""
    found = dict[str, Range]()
    joints = {joint.name: joint for joint in scene.robot.joints}
    kept = not any(part.law.is_rigid for part in scene.constraints)
    lower, upper = independent_limits(scene.robot, scene.couplings)
    names = coordinate_names(scene.robot, scene.couplings)
    for name, low, high in zip(names, lower, upper, strict=True):
        if name not in joints:
            continue
        one = joints[name]
        found[f"{name}.position"] = (low, high) if kept else (one.lower, one.upper)
        found[f"{name}.velocity"] = (-one.max_velocity, one.max_velocity)
    return {
        name: bounds
        for name, bounds in found.items()
        if np.isfinite(bounds).any() and not any(fnmatchcase(name, key) for key in given)
    }


def _degree(task: PredictTask) -> int:
    return 3 if task.mesh.scheme == "hermite_simpson" else task.mesh.degree


def _intervals(task: PredictTask, duration: Range) -> int:
    """Of the first mesh: near a recording from the beginning, or few."""
    if task.mesh.intervals is not None:
        return task.mesh.intervals
    if task.recording is None:
        return _FEW
    count = max(_FEW, round(_A_SECOND * 0.5 * sum(duration)))
    if count > MOST_INTERVALS:
        lasting = f"{_A_SECOND} a second of the recording"
        raise SceneError(
            f"{task.source}: predict.mesh.intervals: {count}, {lasting}, accepted are "
            f"{MOST_INTERVALS}; give intervals, or times of the recording"
        )
    return count


def with_unit_turns(given: Mapping[str, Range], bodies: Sequence[str]) -> dict[str, Range]:
    """Ranges at an end, with quaternions of size 1 where all four numbers are given.

    Raises:
        ModelError: Four numbers that are no orientation.
    """
    found = dict(given)
    for body in bodies:
        names = [f"{body}.orientation.{axis}" for axis in "xyzw"]
        ranges = [found.get(name, (-math.inf, math.inf)) for name in names]
        if any(low != high for low, high in ranges):
            continue
        values = [low for low, _ in ranges]
        size = math.hypot(*values)
        if abs(size - 1.0) > _OFF:
            raise ModelError(
                f"{body}.orientation: a quaternion (x, y, z, w) of size {size:g}, accepted: 1"
            )
        found |= {name: (one / size, one / size) for name, one in zip(names, values, strict=True)}
    return found


def guesses_of(
    phases: Sequence[MotionPhase],
    first: State,
    task: PredictTask,
    recording: Recording | None = None,
    modes: Sequence[PhaseMode] = (),
) -> list[PhaseMotion]:
    """Straight lines from the start to the end of each phase, and what a task says instead.

    Args:
        first: Where the scene starts, in what is integrated.
        recording: Of the motion, which takes the place of straight lines.
        modes: The systems of the phases.

    Raises:
        ModelError: A guess of what is no unknown.
    """
    found, state, t = list[PhaseMotion](), np.concatenate((first.q, first.v, first.z)), first.t
    parts, lines = np.linspace(0.0, 1.0, len(phases) + 1), dict(task.guess)
    if task.guess_file is not None:
        lines |= recorded_lines(phases[0].quantities, task.guess_file)
    for i, phase in enumerate(phases):
        motion = _straight(phase, state, t)
        if recording is not None:
            write_recorded(phase, modes[i].system, motion, recording)
        _write_lines(phase, motion, lines, (parts[i], parts[i + 1]))
        _let_fibers_rest(phase, motion, lines)
        found.append(motion)
        t += motion.duration
        state = np.concatenate([motion.nodes[key][-1] for key in "qvz"])
    return found


def _straight(phase: MotionPhase, state: Any, begin: float) -> PhaseMotion:
    problem, sizes, mesh = phase.problem, phase.equations.sizes, phase.problem.mesh
    low, high = problem.duration
    duration = 0.5 * (low + high) if np.isfinite(high) else 2.0 * low
    start = phase.state_at_end(problem.start, state)
    finish = phase.state_at_end(problem.end, start)
    nodes, points = dict[str, Any](), dict[str, Any]()
    for at, found in ((mesh.knots, nodes), (mesh.shares, points)):
        whole = start + at[:, None] * (finish - start)
        cuts = [sizes.nq, sizes.nq + sizes.nv]
        found["q"], found["v"], found["z"] = np.split(whole, cuts, axis=1)
    m = len(mesh.shares)
    widths = {"a": sizes.nv, "w": sizes.nz, "u": sizes.nu, "l": sizes.m}
    points |= {key: np.zeros((m, width)) for key, width in widths.items()}
    points["d"] = np.zeros((m + mesh.intervals, 6 * len(sizes.bases)))
    motion = PhaseMotion(mesh, begin, duration, nodes, points, sizes.bases)
    if sizes.bases:
        _move_bodies(phase, motion)
    return motion


def _move_bodies(phase: MotionPhase, motion: PhaseMotion) -> None:
    """Let free bodies screw from pose to pose; as they start where nothing says their end."""
    ends = (one for name in phase.problem.end for one in phase.quantities.find(name))
    named = {one.index for one in ends if one.letter == "q"}
    for at_q, at_v in motion.bases:
        q, v = slice(at_q, at_q + 7), slice(at_v, at_v + 6)
        first, last = _unit(motion.nodes["q"][0, q]), _unit(motion.nodes["q"][-1, q])
        twist = motion.nodes["v"][0, v].copy()
        if named.intersection(range(at_q, at_q + 7)):
            twist = BODY.difference(first, last) / motion.duration
        for shares, found in (
            (motion.mesh.knots, motion.nodes),
            (motion.mesh.shares, motion.points),
        ):
            steps = shares[:, None] * motion.duration * twist
            found["q"][:, q] = [BODY.integrate(first, step) for step in steps]
            found["v"][:, v] = twist
    steps = steps_of(motion.mesh, motion.nodes["q"], motion.points["q"], motion.bases)
    motion.points["d"][:] = steps


def _unit(pose: Any) -> Any:
    """The pose with a quaternion of size 1; without a turn where it has no size."""
    size = float(np.linalg.norm(pose[3:]))
    return np.append(pose[:3], pose[3:] / size if size > 0.0 else [0.0, 0.0, 0.0, 1.0])


def _write_lines(
    phase: MotionPhase, motion: PhaseMotion, lines: Lines, part: tuple[float, float]
) -> None:
    """Put lines of a guess in place, with the velocities that belong to them.

    Args:
        motion: Its guess, which is changed.
        lines: Quantity -> values at equal times of the whole motion.
        part: Where in the whole motion the phase is.
    """
    flat = {int(i): int(j) for i, j in phase.equations.flat}
    ends = (motion.mesh.knots, motion.nodes), (motion.mesh.shares, motion.points)
    for name, values in lines.items():
        places = np.linspace(0.0, 1.0, len(values))
        for one in phase.quantities.find(name):
            if not one.letter or one.letter == "p":
                raise ModelError(f"guess: {one.name} is no unknown of the motion")
            velocity = f"{one.name.removesuffix('position')}velocity"
            for shares, found in ends:
                if one.letter not in found:
                    continue
                at = part[0] + shares * (part[1] - part[0])
                found[one.letter][:, one.index] = np.interp(at, places, values)
                if one.letter == "q" and one.index in flat and velocity not in lines:
                    once, which = np.unique(at, return_inverse=True)
                    slope = np.gradient(np.interp(once, places, values), once)[which]
                    slope *= part[1] - part[0]
                    found["v"][:, flat[one.index]] = slope / motion.duration


def _let_fibers_rest(phase: MotionPhase, motion: PhaseMotion, lines: Lines) -> None:
    """Put fibres beside elastic tendons in balance along the guess, but where lines say more."""
    system = phase.equations.equations.system
    parts = [one for one in system.internals.parts if getattr(one, "is_elastic", False)]
    every = (one for name in lines for one in phase.quantities.find(name))
    given = {one.index for one in every if one.letter == "z"}
    free = [one.z.stop - 1 for one in parts if one.z.stop - 1 not in given]
    if not free:
        return
    nodes, u = motion.nodes, np.array(system.loads.idle, dtype=np.float64)
    for i, z in enumerate(nodes["z"]):
        z[free] = np.nan
        x = State(motion.begin, nodes["q"][i], nodes["v"][i], z)
        nodes["z"][i] = system.at_rest(x, u)
    for at in free:
        lengths = nodes["z"][:, at]
        motion.points["z"][:, at] = np.interp(motion.mesh.shares, motion.mesh.knots, lengths)


def write_recorded(
    phase: MotionPhase, system: System, motion: PhaseMotion, recording: Recording
) -> None:
    """Put a recorded motion in place, and the least inputs that lead along it.

    Args:
        motion: The guess, which is changed.
    """
    mesh, nodes, points = motion.mesh, motion.nodes, motion.points
    for shares, found in ((mesh.knots, nodes), (mesh.shares, points)):
        times = motion.begin + motion.duration * shares
        for key, values in _reduced(system, recording, times).items():
            if key in found:
                found[key][:] = values
    if motion.bases:
        points["d"][:] = steps_of(mesh, nodes["q"], points["q"], motion.bases)
    given = phase.given
    points["u"][:, given.places] = given.at(mesh.shares)
    p = np.zeros(phase.equations.symbols["p"].numel())
    times = motion.begin + motion.duration * mesh.shares
    for key, values in phase.equations.pushed(points, times, p, given.places).items():
        points[key][:] = values


def _reduced(system: System, recording: Recording, times: Array) -> dict[str, Array]:
    """Positions, velocities and accelerations of what is integrated: letters q, v, a."""
    states = []
    for t, q, v, a in zip(times, *recording.motion(times), strict=True):
        x = State(float(t), q, v)
        y = system.reduce(x)
        states.append((y.q, y.v, system.reduce(x._replace(v=a)).v))
    return {key: np.array(one) for key, one in zip("qva", zip(*states, strict=True), strict=True)}


def close_loops(equations: Any, motion: PhaseMotion, p: Array) -> None:
    """Close the loops of a guess, configurations and velocities, where that is possible.

    Args:
        equations: Of the phase, `PhaseEquations`.
        motion: The guess, which is changed.
    """
    q, shares = motion.nodes["q"], np.concatenate((motion.mesh.knots, motion.mesh.shares))
    moved = np.abs(q - q[0]).max(axis=0) > 0.0
    flat = equations.flat
    free = np.array([j for i, j in flat if not moved[i]], dtype=np.intp)
    of_q = {int(j): int(i) for i, j in flat}
    if not equations.sizes.mg or not len(free):
        return
    places = [of_q[int(j)] for j in free]
    fine = np.unique(np.concatenate((shares, np.arange(0.0, 1.0, _STRIDE))))
    whole = np.empty((len(fine), q.shape[1]))
    for i in range(q.shape[1]):
        whole[:, i] = np.interp(fine, motion.mesh.knots, q[:, i])
    follower = whole[0, places].copy()
    speeds = np.empty((len(fine), motion.nodes["v"].shape[1]))
    for i, row in enumerate(whole):
        row[places] = follower
        t = motion.begin + motion.duration * fine[i]
        _closed(equations, t, row, free, places, p)
        follower = row[places].copy()
        v = np.array([np.interp(fine[i], motion.mesh.knots, one) for one in motion.nodes["v"].T])
        v[free] = 0.0
        _, _, rate, J = equations.rows_at(t, row, v, p)
        v[free] -= np.linalg.lstsq(J[:, free], rate, rcond=None)[0]
        speeds[i] = v
    for at, found in ((motion.mesh.knots, motion.nodes), (motion.mesh.shares, motion.points)):
        rows = np.searchsorted(fine, at)
        found["q"][:, places], found["v"][:, free] = whole[rows][:, places], speeds[rows][:, free]


def _closed(equations: Any, t: float, q: Array, free: Array, places: list[int], p: Array) -> None:
    """Newton's method on some coordinates; the nearest ones where rows do not determine them."""
    still = np.zeros(equations.sizes.nv)
    for _ in range(_MOST):
        g, J, _, _ = equations.rows_at(t, q, still, p)
        if np.abs(g).max(initial=0.0) < _CLOSED:
            return
        step = np.linalg.lstsq(J[:, free], -g, rcond=None)[0]
        size = float(np.abs(step).max(initial=0.0))
        q[places] += step * min(1.0, _LONGEST / max(size, _LONGEST))
