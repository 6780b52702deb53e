"""What is known of a trial of muscles: the motion, and what it takes."""

from collections.abc import Callable, Sequence

import numpy as np

from mbd_ros.core.inverse_dynamics.torque_estimator import Observations
from mbd_ros.core.kinematics.free_bases import IndependentCoordinates
from mbd_ros.core.muscles.array_numbers import ArrayNumbers
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.features.muscles.muscle_frames import Frames
from mbd_ros.features.muscles.muscle_trial import Trial
from mbd_ros.features.muscles.sharing_costs import sizes_of
from mbd_ros.features.muscles.static_optimization import StaticOptimization
from mbd_ros.features.muscles.trial_points import Points

_LEAST_SIZE = 1.0e-3  # of the largest force: what a coordinate that needs hardly anything counts


def known_at(
    points: Points,
    solver: StaticOptimization,
    muscles: Sequence[Muscle],
    samples: Observations,
    wrenches: Sequence[Array],
    activations: Callable[[Array], Array | None],
) -> Trial:
    """The motion at the points, by cubic splines through its samples."""
    from scipy.interpolate import CubicSpline

    times = (samples.stamps - samples.stamps[0]) * NANOSECOND
    at = points.whole
    measured = activations(samples.stamps[0] + np.round(at / NANOSECOND).astype(np.int64))
    motion = [CubicSpline(times, values)(at) for values in samples[1:4]]
    for body in IndependentCoordinates(solver.robot, solver.known.couplings).body_y:
        turn = motion[0][:, body[3:7]]
        motion[0][:, body[3:7]] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    loads = [CubicSpline(times, wrench)(at) for wrench in wrenches]
    frames, needed = solver.demand(*motion, loads)
    n = len(muscles)
    columns = frames.columns.copy()
    columns[:, :, n:] *= [reserve.optimal for reserve in solver.reserves]
    prices = solver.wishes.criterion.prices(sizes_of(muscles), frames.active, frames.fiber_speed)
    least = np.tile([float(muscle.dynamics.least) for muscle in muscles], (len(at), 1))
    stiffness, target = np.zeros_like(least), np.zeros_like(least)
    if measured is not None:
        given = np.isfinite(measured)
        target[given] = measured[given]
        if solver.wishes.measured_is_least:
            least = np.where(given, np.clip(target, least, 1.0), least)
        stiffness[given] = solver.wishes.tracking
    largest = np.abs(needed).max(axis=0, initial=0.0)
    sizes = np.maximum(largest, _LEAST_SIZE * largest.max(initial=0.0))
    return Trial(
        *(np.diff(points.knots), frames.length, *rigid_tensions(muscles, frames), columns, needed),
        *(np.where(sizes > 0.0, sizes, 1.0), np.array(prices), stiffness, target, least),
        np.array([reserve.limits for reserve in solver.reserves]).reshape(-1, 2).T,
    )


def rigid_tensions(muscles: Sequence[Muscle], frames: Frames) -> tuple[Array, Array]:
    """Tensions beside rigid tendons at full activation less those without, and these [N]."""
    k, none = ArrayNumbers, np.zeros_like(frames.length)
    strength, offset = none, none.copy()
    for i, muscle in enumerate(muscles):
        law, length, speed = muscle.contraction, frames.length[:, i], frames.speed[:, i]
        if not muscle.is_elastic:
            fiber = law.beside_rigid_tendon(k, length, speed)
            taut = (length - law.slack > law.pennation.reach) * fiber.cosine
            strength[:, i] = law.active(k, 1.0, fiber) * taut
            offset[:, i] = (law.passive(k, fiber) + law.damping(fiber)) * taut
    return strength, offset
