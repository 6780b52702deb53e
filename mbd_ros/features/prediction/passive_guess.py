"""The motion that a scene has by itself as a guess: without inputs its equations hold exactly."""

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError
from mbd_ros.features.prediction.problem import Problem
from mbd_ros.features.prediction.replay import simulation_of
from mbd_ros.optimal_control.unknowns import PhaseMotion, steps_of

_ACCURATE = 1.0e-3  # error of a motion that is a guess
_SAMPLES = 200
_LARGEST = 1.0e3  # times the usual sizes: a motion that goes further is no guess


def passive(problem: Problem) -> list[PhaseMotion] | None:
    """The motion from the beginning of the guess without inputs; None where there is none.

    Args:
        problem: Of one phase of a scene without phases and recording.
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
