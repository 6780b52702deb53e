"""Samples of a recorded motion with velocity and acceleration."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.estimation.differentiation import CausalDifferentiator
from mbd_ros.core.estimation.local_polynomials import local_polynomials
from mbd_ros.core.estimation.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.files.table import Table
from mbd_ros.jobs.progress import progress
from mbd_ros.scene.built_scene import Scene


class Derivatives(NamedTuple):
    """Where velocity and acceleration come from.

    Attributes:
        source: given, causal or zero-phase.
        cutoff: Half-power frequency of the filters [Hz]; None: that of the live node for causal
            ones, for zero-phase what each joint's recording asks for.
        half_width: Samples on either side of a local zero-phase fit, in place of a cut-off.
    """

    source: str
    cutoff: float | None = None
    half_width: int | None = None

    @property
    def causal_cutoff(self) -> float:
        """Half-power frequency of the causal filters [Hz]."""
        given = self.cutoff if self.source == "causal" else None
        return Tuning().cutoff if given is None else given


class Differentiated(NamedTuple):
    """Samples of the independent joints, and their origin.

    Attributes:
        samples: The samples.
        cutoff: Of the low-pass of each joint [Hz], shape (m,); None without one.
        remarks: Remarks on them, for people.
    """

    samples: list[Observation]
    cutoff: Array | None
    remarks: list[str]


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
    scene: Scene, where: str, motion: Motion, derivatives: Derivatives
) -> Differentiated:
    """Samples of the independent joints, with the derivatives given or without lag.

    Args:
        scene: The scene.
        where: What the motion is from, for the messages.
        motion: The motion.
        derivatives: Where velocity and acceleration come from.

    Raises:
        DataError: Derivatives are to be given and are not, or samples are too few.
    """
    n = len(scene.couplings.independent)
    position = motion.position[:, :n].copy()
    wraps = [scene.robot.joint(j).kind == "continuous" for j in scene.couplings.independent]
    position[:, wraps] = np.unwrap(position[:, wraps], axis=0)
    if derivatives.source == "given":
        velocity = _given(scene, where, motion.velocity, "velocity")
        acceleration = _given(scene, where, motion.acceleration, "acceleration")
        cutoff, remarks = None, []
    else:
        measured = None if motion.velocity is None else motion.velocity[:, :n]
        position, velocity, acceleration, cutoff, remarks = _without_lag(
            scene.couplings.independent, motion.stamps, position, measured, derivatives
        )
    dependent = motion.position[:, n:]
    rows = zip(motion.stamps.tolist(), position, velocity, acceleration, dependent, strict=True)
    return Differentiated([Observation(*row) for row in rows], cutoff, remarks)


def _without_lag(
    names: Sequence[str],
    stamps: NDArray[np.int64],
    position: Array,
    velocity: Array | None,
    derivatives: Derivatives,
) -> tuple[Array, Array, Array, Array | None, list[str]]:
    """Position, velocity, acceleration, cut-off of each joint, and remarks."""
    width = derivatives.half_width
    if width is not None and derivatives.cutoff is not None:
        raise DataError("--half-width and --cutoff: zero-phase derivatives take one of them")
    if width is not None:
        fitted = local_polynomials(stamps, position, velocity, half_width=width)
        return position, *fitted, None, []
    from mbd_ros.jobs.inverse.zero_phase import cutoff_lines, zero_phase

    found = zero_phase(stamps, position, velocity, cutoff=derivatives.cutoff)
    said = cutoff_lines(found.cutoff, names, derivatives.cutoff is None, len(stamps))
    return *found, list(said)


def unexplained(motion: Motion, table: Table, cutoff: Array) -> Iterator[str]:
    """How far the torques are off the measured ones, both behind the low-pass of the motion.

    Args:
        motion: With the measured efforts; joints without are left out.
        table: With the torques.
        cutoff: Of the low-pass of each of the first joints of the motion [Hz].
    """
    names = motion.names[: len(cutoff)]
    driven = [name.removesuffix(".effort") for name in table if name.endswith(".effort")]
    pairs = [(names.index(name), name) for name in driven if name in names]
    if motion.effort is None or table.rows != len(motion.stamps):
        return
    effort = motion.effort
    pairs = [(j, name) for j, name in pairs if np.isfinite(effort[:, j]).all()]
    if not pairs:
        return
    from mbd_ros.jobs.inverse.zero_phase import low_passed

    theirs, ours = (list(column) for column in zip(*pairs, strict=True))
    known, found = (
        low_passed(motion.stamps, values, cutoff[theirs])
        for values in (
            effort[:, theirs],
            np.column_stack([table[f"{name}.effort"] for name in ours]),
        )
    )
    unit = np.abs([known, found]).max()  # squares of the efforts themselves may overflow
    if known.any() and np.isfinite(unit):
        total, off = (float(np.linalg.norm(tau / unit)) for tau in (known, found - known))
        share = 100.0 * off / total
        yield (
            f"off the measured effort by {share:.3g} % (norm of differences over norm of efforts, "
            "all behind the same low-pass)"
        )


def _given(scene: Scene, where: str, values: Array | None, field: str) -> Array:
    names = scene.couplings.independent
    lacking = [
        name
        for i, name in enumerate(names)
        if values is None or not np.isfinite(values[:, i]).all()
    ]
    if values is None or lacking:
        raise DataError(
            f"{where}: no {field} of {', '.join(lacking)}; "
            "choose --derivatives causal or zero-phase"
        )
    return values[:, : len(names)]
