"""The motion that a program begins with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError
from mbd_ros.features.prediction.modes import PhaseMode
from mbd_ros.features.prediction.recording import Recording, recorded_lines
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.optimal_control.phase_motion import BODY, PhaseMotion, steps_of

if TYPE_CHECKING:
    from mbd_ros.optimal_control.motion_phase import MotionPhase

_MOST = 30  # Newton steps that close a loop
_CLOSED = 1.0e-9  # rad or m
_LONGEST = 0.5  # rad or m of a Newton step: the guess stays on the branch that it is on
_STRIDE = 0.02  # of the duration: from one closed configuration to the next
Lines = Mapping[str, tuple[float, ...]]


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


def close_loops(equations: Any, motion: PhaseMotion, p: Array) -> None:
    """Close the loops of a guess, configurations and velocities, where that is possible.

    Args:
        equations: Of the phase, `PhaseEquations`.
        motion: The guess, which is changed.
        p: Parameters.
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
