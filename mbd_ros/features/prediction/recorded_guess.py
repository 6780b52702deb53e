"""A recorded motion as what a search begins with, and the inputs that it takes."""

from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.features.prediction.recording import Recording
from mbd_ros.optimal_control.unknowns import PhaseMotion, steps_of

if TYPE_CHECKING:
    from mbd_ros.optimal_control.motion_phase import MotionPhase


def write_recorded(
    phase: "MotionPhase", system: System, motion: PhaseMotion, recording: Recording
) -> None:
    """Put a recorded motion in place, and the least inputs that lead along it.

    Args:
        phase: The phase.
        system: Its system.
        motion: The guess, which is changed.
        recording: The recording.
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
