"""Where a trial of muscles is looked for first, and again at other times."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.muscles.array_numbers import ArrayNumbers
from mbd_ros.core.muscles.contraction import Contraction, Fiber
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import Array
from mbd_ros.features.muscles.muscle_trial import Excited
from mbd_ros.features.muscles.static_optimization import Shares
from mbd_ros.features.muscles.trial_points import Points

_BISECTIONS = 30


def first_guess(muscles: Sequence[Muscle], at: Array, times: Array, static: Shares) -> Excited:
    """Excitations as activations of frames one by one, fibres at rest beside their tendons."""
    every = static.activation, static.frames.length
    activation, length = (
        np.stack([np.interp(at, times, column) for column in values.T], axis=1) for values in every
    )
    elastic = [i for i, muscle in enumerate(muscles) if muscle.is_elastic]
    fibers, speeds = np.zeros((2, len(at), len(elastic)))
    for column, i in enumerate(elastic):
        law = muscles[i].contraction
        fibers[:, column] = _at_rest(law, activation[:, i], length[:, i])
        speeds[:, column] = np.gradient(fibers[:, column], at) / law.fastest
    efforts = np.zeros((len(at), static.reserve.shape[1]))
    return Excited(activation, activation, efforts, fibers, speeds)


def _at_rest(law: Contraction, activation: Array, length: Array) -> Array:
    """Lengths at which fibres and tendons are in balance [m], by bisection."""
    k, short = ArrayNumbers, np.full_like(length, max(law.pennation.shortest, 0.1 * law.optimal))
    long = np.maximum(law.pennation.fiber(k, length - law.slack), 1.01 * short)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (short + long)
        fiber = Fiber(middle, law.cosine(k, middle), 0.0 * middle)
        along = law.active(k, activation, fiber) + law.passive(k, fiber)
        pulls = law.tendon(k, length, middle) > along * fiber.cosine
        short, long = np.where(pulls, middle, short), np.where(pulls, long, middle)
    return 0.5 * (short + long)


def moved(points: Points, found: Excited, at: Array) -> Excited:
    """What was found, at other times."""
    states = (points.states(values, at) for values in (found.activation, found.fiber_length))
    activation, fibers = states
    inputs = found.excitation, found.effort, found.fiber_speed
    excitation, effort, speed = (points.inputs(values, at) for values in inputs)
    return Excited(activation, excitation, effort, fibers, speed)
