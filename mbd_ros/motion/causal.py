"""Recorded motions through the causal filters of the live node, many samples at once."""

from collections import Counter

import numpy as np

from mbd_ros.core.inverse_dynamics.joint_observer import Observation, Observations, together
from mbd_ros.core.inverse_dynamics.torque_estimator import TorqueEstimator
from mbd_ros.core.kinematics.poses import TWIST
from mbd_ros.core.signals.differentiation import CausalDifferentiator
from mbd_ros.core.state import Array, Motion
from mbd_ros.jobs.progress import progress

_BLOCK, _FEW = 16_384, 256  # samples that are filtered at once, at most and at least


def observe(estimator: TorqueEstimator, motion: Motion, dropped: Counter[str]) -> Observations:
    """Pass a motion through the causal filters.

    Args:
        estimator: With the filters.
        motion: The motion, NaN where a joint is absent.
        dropped: Counts the samples that cannot be used, by reason.
    """
    blocks = _blocks(0, len(motion.stamps), _BLOCK)
    parts = []
    for block in progress(blocks, len(blocks), "filtering"):
        parts += _observed(estimator, motion, block, dropped)
    none = np.zeros((0, 0))
    return together(parts or [Observations(np.zeros(0, np.int64), none, none, none, none)])


def _blocks(begin: int, end: int, size: int) -> list[slice]:
    return [slice(i, min(i + size, end)) for i in range(begin, end, size)]


def _observed(
    estimator: TorqueEstimator, motion: Motion, block: slice, dropped: Counter[str]
) -> list[Observations]:
    """Samples of a block: all at once, else in smaller blocks, at last one by one."""
    stamps, position = motion.stamps[block], motion.position[block]
    velocity = np.full_like(position, np.nan)
    if motion.velocity is not None:
        velocity = motion.velocity[block]
    found = estimator.observe_all(stamps, position, velocity)
    if found is not None:
        return [found]
    if len(stamps) > _FEW and not motion.bodies:
        smaller = _blocks(block.start, block.stop, max(len(stamps) // 8, _FEW))
        each = [_observed(estimator, motion, part, dropped) for part in smaller]
        return [part for parts in each for part in parts]
    bodies = _body_rows(motion, block) if motion.bodies else [None] * len(stamps)
    observed = []
    rows = zip(stamps.tolist(), position, velocity, np.isfinite(position), bodies, strict=True)
    for row in rows:
        x = estimator.observe(*row)
        if isinstance(x, Observation):
            observed.append(x)
        else:
            dropped[x.value] += 1
    if not observed:
        return []
    used, *fields = (np.array(column) for column in zip(*observed, strict=True))
    return [Observations(used, *fields)]


def _body_rows(motion: Motion, block: slice) -> list[tuple[Array, Array]]:
    """Poses and twists of the free bodies, a pair a sample."""
    unknown = np.full((len(motion.stamps), TWIST), np.nan)
    poses = np.stack([body.pose for body in motion.bodies], axis=1)[block]
    twists = [unknown if body.twist is None else body.twist for body in motion.bodies]
    return list(zip(poses, np.stack(twists, axis=1)[block], strict=True))


def causal_line(filters: CausalDifferentiator, cutoff: float) -> str:
    """How far causal derivatives lag behind the motion."""
    return (
        f"causal derivatives at {cutoff:g} Hz lag by {filters.delay:.4f} s and settle within "
        f"{filters.settling_time:.4f} s"
    )
