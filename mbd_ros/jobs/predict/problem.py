"""A scene and a task -> a program and the guess that it begins with."""

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.prediction.mesh import Mesh, uniform_mesh
from mbd_ros.core.prediction.problem import PhaseProblem, Range
from mbd_ros.core.prediction.unknowns import PhaseMotion
from mbd_ros.core.projection.independent_limits import independent_limits
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.jobs.predict.closed_guess import close
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.coordinate_names import coordinate_names, velocity_names
from mbd_ros.scene.predict_task import PhaseTask, PredictTask

if TYPE_CHECKING:
    from mbd_ros.compiled.program.motion_program import MotionProgram


class Problem(NamedTuple):
    """What is solved.

    Attributes:
        scene: The scene, driven.
        program: The program.
        guesses: Of each phase.
        parameters: Values to begin with.
    """

    scene: Scene
    program: "MotionProgram"
    guesses: list[PhaseMotion]
    parameters: Any


def driven(scene: Scene) -> Scene:
    """The scene; one without any inputs gets an ideal drive in every independent joint."""
    if scene.inputs.names:
        return scene
    joints = [one.name for one in scene.robot.joints if one.name in scene.couplings.independent]
    return scene.with_(actuators=[{"type": "ideal", "joints": joints, "name": "drives"}])


def problem_of(scene: Scene, task: PredictTask) -> Problem:
    """The program of a task.

    Raises:
        SceneError: Names file and key.
        Untraceable: Names a part that has no symbolic form.
    """
    from mbd_ros.compiled.program.motion_phase import MotionPhase
    from mbd_ros.compiled.program.motion_program import MotionProgram, Parameter
    from mbd_ros.compiled.program.phase_equations import PhaseEquations
    from mbd_ros.scene.symbolic_parts import traced

    scene = driven(scene)
    system = scene.system()
    first = scene.simulation().start(scene.initial)
    where = task.source or scene.name
    names = list(task.parameters)
    values = np.array([_value(scene, name, task.parameters[name]) for name in names])
    numbers = np.arange(len(names), dtype=np.intp)
    mesh = uniform_mesh(task.mesh.scheme, _degree(task), task.mesh.intervals)
    try:
        equations = PhaseEquations(traced(scene, system, names, scene.initial.mode).equations)
        problem = _phase_problem(scene, task, task.phases[0], first, mesh)
        phase = MotionPhase(problem, equations, numbers)
    except ModelError as error:
        raise SceneError(f"{where}: predict: {error}") from error
    pairs = zip(names, values, strict=True)
    parameters = [Parameter(name, task.parameters[name], value) for name, value in pairs]
    program = MotionProgram([phase], parameters)
    guess = first_guess(phase, first, task.guess)
    close(equations, guess, values)
    return Problem(scene, program, [guess], values)


def _degree(task: PredictTask) -> int:
    return 3 if task.mesh.scheme == "hermite_simpson" else task.mesh.degree


def _value(scene: Scene, name: str, bounds: Range) -> float:
    """Where a parameter begins: in the middle of its range."""
    return 0.5 * (bounds[0] + bounds[1])


def _phase_problem(
    scene: Scene, task: PredictTask, phase: PhaseTask, first: State, mesh: Mesh
) -> PhaseProblem:
    bounds = {**_usual_bounds(scene, phase.bounds), **phase.bounds}
    start = {} if task.start_free else _start_of(scene, first, phase.start)
    return PhaseProblem(
        phase.phase,
        phase.duration,
        bounds,
        {**start, **phase.start},
        phase.end,
        phase.goals,
        mesh,
    )


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


def _start_of(scene: Scene, first: State, given: Mapping[str, Range]) -> dict[str, Range]:
    """The state in which the scene starts, but for what a task names."""
    names = integrated_names(scene, len(first.v))
    pairs = [(f"{name}.velocity", value) for name, value in zip(names, first.v, strict=True)]
    joints = {joint.name: joint for joint in scene.robot.joints}
    q = scene.system().expand(first).q
    pairs += [(f"{n}.position", q[joints[n].q]) for n in names if n in joints]
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


def first_guess(phase: Any, first: State, lines: Mapping[str, tuple[float, ...]]) -> PhaseMotion:
    """Straight lines from start to end, at rest in inputs.

    Args:
        phase: The phase, a `MotionPhase`.
        first: Where the scene starts, in what is integrated.
        lines: Quantity -> values at equal times.
    """
    problem, sizes = phase.problem, phase.equations.sizes
    mesh = problem.mesh
    low, high = problem.duration
    duration = 0.5 * (low + high) if np.isfinite(high) else 2.0 * low
    begin = phase.state_at_end(problem.start, np.concatenate((first.q, first.v, first.z)))
    finish = phase.state_at_end(problem.end, begin)
    nq, nv = sizes.nq, sizes.nv
    knots, shares = mesh.knots, mesh.shares
    nodes, points = dict[str, Any](), dict[str, Any]()
    for at, found in ((knots, nodes), (shares, points)):
        whole = begin + at[:, None] * (finish - begin)
        found["q"], found["v"], found["z"] = np.split(whole, [nq, nq + nv], axis=1)
    m = len(shares)
    points |= {
        "a": np.zeros((m, nv)),
        "w": np.zeros((m, sizes.nz)),
        "u": np.zeros((m, sizes.nu)),
        "l": np.zeros((m, sizes.m)),
        "d": np.zeros((m + mesh.intervals, 6 * len(sizes.bases))),
    }
    motion = PhaseMotion(mesh, 0.0, duration, nodes, points, sizes.bases)
    _write_lines(phase, motion, lines)
    return motion


def _write_lines(phase: Any, motion: PhaseMotion, lines: Mapping[str, tuple[float, ...]]) -> None:
    """Put lines of a guess in place, with the velocities that belong to them."""
    flat = {int(i): int(j) for i, j in phase.equations.flat}
    for name, values in lines.items():
        places = np.linspace(0.0, 1.0, len(values))
        for one in phase.quantities.find(name):
            if not one.letter:
                raise ModelError(f"guess: {one.name} is no unknown of the program")
            for at, found in (
                (motion.mesh.knots, motion.nodes),
                (motion.mesh.shares, motion.points),
            ):
                if one.letter not in found:
                    continue
                found[one.letter][:, one.index] = np.interp(at, places, values)
                velocity = f"{one.name.removesuffix('position')}velocity"
                if one.letter == "q" and one.index in flat and velocity not in lines:
                    slope = np.gradient(np.interp(at, places, values), at)
                    found["v"][:, flat[one.index]] = slope / motion.duration
