"""Samples of a recorded motion with velocity and acceleration."""

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbd_ros.built_scene import Scene
from mbd_ros.core.differentiation import CausalDifferentiator
from mbd_ros.core.estimation.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.core.estimation.zero_phase import zero_phase
from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.progress import progress


class Derivatives(NamedTuple):
    """Where velocity and acceleration come from.

    Attributes:
        source: given, causal or zero-phase.
        cutoff: Half-power frequency of the causal filters [Hz].
        half_width: Samples on either side of a zero-phase fit.
    """

    source: str
    cutoff: float = Tuning().cutoff
    half_width: int = 4


def observe(
    estimator: TorqueEstimator, motion: Motion, dropped: Counter[str]
) -> list[Observation]:
    """Pass a motion through the causal filters.

    Args:
        estimator: With the filters.
        motion: The motion, NaN where a joint is absent.
        dropped: Counts the samples that cannot be used, by reason.
    """
    velocity = motion.velocity
    if velocity is None:
        velocity = np.full_like(motion.position, np.nan)
    present = np.isfinite(motion.position)
    observed = []
    rows = zip(motion.stamps.tolist(), motion.position, velocity, present, strict=True)
    for row in progress(rows, len(motion.stamps), "filtering"):
        x = estimator.observe(*row)
        if isinstance(x, Observation):
            observed.append(x)
        else:
            dropped[x.value] += 1
    return observed


def causal_line(filters: CausalDifferentiator, cutoff: float) -> str:
    """How far causal derivatives lag behind the motion."""
    return (
        f"causal derivatives at {cutoff:g} Hz lag by {filters.delay:.4f} s and settle within "
        f"{filters.settling_time:.4f} s"
    )


def differentiate(
    scene: Scene, path: Path, motion: Motion, derivatives: Derivatives
) -> list[Observation]:
    """Samples of the independent joints, with the derivatives given or by zero-phase fits.

    Args:
        scene: The scene.
        path: File of the motion, for the messages.
        motion: The motion.
        derivatives: Where velocity and acceleration come from.

    Raises:
        DataError: Derivatives are to be given and are not.
    """
    n = len(scene.couplings.independent)
    position = motion.position[:, :n].copy()
    wraps = [scene.robot.joint(j).kind == "continuous" for j in scene.couplings.independent]
    position[:, wraps] = np.unwrap(position[:, wraps], axis=0)
    if derivatives.source == "given":
        velocity = _given(scene, path, motion.velocity, "velocity")
        acceleration = _given(scene, path, motion.acceleration, "acceleration")
    else:
        measured = None if motion.velocity is None else motion.velocity[:, :n]
        velocity, acceleration = zero_phase(
            motion.stamps, position, measured, half_width=derivatives.half_width
        )
    dependent = motion.position[:, n:]
    rows = zip(motion.stamps.tolist(), position, velocity, acceleration, dependent, strict=True)
    return [Observation(*row) for row in rows]


def _given(scene: Scene, path: Path, values: Array | None, field: str) -> Array:
    names = scene.couplings.independent
    lacking = [
        name
        for i, name in enumerate(names)
        if values is None or not np.isfinite(values[:, i]).all()
    ]
    if values is None or lacking:
        raise DataError(
            f"{path}: no {field} of {', '.join(lacking)}; "
            "choose --derivatives causal or zero-phase"
        )
    return values[:, : len(names)]
