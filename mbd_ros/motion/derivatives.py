"""Velocities and accelerations of a recorded motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import (
    POSE,
    TWIST,
    acceleration_of,
    configuration_of,
    rate_of,
    twist_of,
)
from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import Array, BodyMotion, Motion
from mbd_ros.errors import DataError
from mbd_ros.files.body_columns import ACCELERATION as ACCELERATION_WORDS
from mbd_ros.files.body_columns import POSE as POSE_WORDS
from mbd_ros.files.body_columns import TWIST as TWIST_WORDS
from mbd_ros.files.body_columns import names_of
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations, Tuning
from mbd_ros.methods.signals.differentiation import local_polynomials
from mbd_ros.scene.built_scene import Scene

OPENSIM = "opensim"
GAIT = 6.0  # [Hz], usual for recordings of gait, and in the examples of OpenSim


class Derivatives(NamedTuple):
    """Source of velocities and accelerations, with its options.

    Attributes:
        source: Where velocities and accelerations come from. given: the motion has them.
            causal: filters that lag, as in the node. zero-phase: a low-pass filter without lag.
            opensim: the filter and the splines of OpenSim, also for a .mot that has only
            positions.
        cutoff: Half-power frequency of the filters [Hz]. By default 5 Hz for causal filters, a
            frequency that is chosen from the noise of the recording and printed for zero-phase
            filters, and 6 Hz for opensim, where inf means no filter.
        half_width: Samples on either side of the local fits that replace the zero-phase filter.
            It excludes a cutoff.
    """

    source: Literal["given", "causal", "zero-phase", "opensim"] = "given"
    cutoff: float | None = None
    half_width: int | None = None

    @property
    def causal_cutoff(self) -> float:
        """Half-power frequency of the causal filters [Hz]."""
        cutoff = self.cutoff if self.source == "causal" else None
        return Tuning().cutoff if cutoff is None else cutoff

    @property
    def opensim_cutoff(self) -> float | None:
        """Half-power frequency of a pass of OpenSim's filter [Hz]; None without a filter."""
        cutoff = GAIT if self.cutoff is None else self.cutoff
        return None if cutoff == math.inf else cutoff


def differentiate(
    scene: Scene, where: str, motion: Motion, derivatives: Derivatives
) -> Differentiated:
    """Return samples of the independent coordinates with recorded derivatives, or without lag.

    Args:
        scene: The scene.
        where: Source of the motion, for messages.
        motion: The recorded motion.
        derivatives: Source of velocity and acceleration; not `causal`.

    Raises:
        DataError: The motion has no derivatives although they should be `given`, or there are too
            few samples.
    """
    if derivatives.source == OPENSIM:
        return _splined(scene, where, motion, derivatives)
    n, bodies = len(scene.couplings.independent), list(motion.bodies)
    position = motion.position[:, :n].copy()
    wraps = [scene.robot.joint(j).kind == "continuous" for j in scene.couplings.independent]
    position[:, wraps] = np.unwrap(position[:, wraps], axis=0)
    if derivatives.source == "given":
        velocity = _recorded(scene, where, position, motion.velocity, "velocity")
        acceleration = _recorded(scene, where, position, motion.acceleration, "acceleration")
        cutoff, remarks = None, []
        _check_recorded(where, bodies)
    else:
        measured = None if motion.velocity is None else motion.velocity[:, :n]
        position, velocity, acceleration, bodies, cutoff, remarks = _without_lag(
            scene.couplings.independent, motion, position, measured, derivatives
        )
    coordinates = _independent_coordinates(scene, (position, velocity, acceleration), bodies)
    samples = Observations(motion.stamps, *coordinates, motion.position[:, n:])
    return Differentiated(samples, cutoff, remarks)


def _splined(scene: Scene, where: str, motion: Motion, derivatives: Derivatives) -> Differentiated:
    """Return samples computed as in OpenSim, from positions only; they may be resampled."""
    from mbd_ros.methods.signals.opensim_splines import opensim_splines  # loads scipy

    if motion.bodies:
        names = ", ".join(body.name for body in motion.bodies)
        raise DataError(
            f"{where}: --derivatives opensim is not accepted for free bodies, here {names}"
        )
    n = len(scene.couplings.independent)
    is_known = np.isfinite(motion.position).all(axis=0)
    is_known[:n] = True
    cutoff = derivatives.opensim_cutoff
    splines = opensim_splines(motion.stamps, motion.position[:, is_known], cutoff)
    position = np.full((len(splines.stamps), len(is_known)), np.nan)
    position[:, is_known] = splines.position
    independent = (values[:, :n] for values in splines[1:])
    samples = Observations(splines.stamps, *independent, position[:, n:])
    low_pass = "no filter" if cutoff is None else f"low-pass at {cutoff:g} Hz, both ways"
    remarks = [f"opensim derivatives: {low_pass}, quintic splines"]
    if not np.array_equal(splines.stamps, motion.stamps):
        remarks.append("resampled at the smallest step of the motion, as OpenSim does")
    return Differentiated(samples, None, remarks)


def _recorded(
    scene: Scene, where: str, position: Array, values: Array | None, field: str
) -> Array:
    """Return recorded values of the independent joints, shape as `position`."""
    names = scene.couplings.independent
    if not names:
        return position
    missing = [
        name
        for i, name in enumerate(names)
        if values is None or not np.isfinite(values[:, i]).all()
    ]
    if values is None or missing:
        raise DataError(
            f"{where}: no {field} of {', '.join(missing)}; "
            "choose --derivatives causal, zero-phase or opensim"
        )
    return values[:, : len(names)]


def _check_recorded(where: str, bodies: Sequence[BodyMotion]) -> None:
    """Refuse bodies without recorded derivatives."""
    for body in bodies:
        for values, fields in (
            (body.twist, TWIST_WORDS),
            (body.acceleration, ACCELERATION_WORDS),
        ):
            if values is None or not np.isfinite(values).all():
                missing = " and ".join(f"{body.name}.{field}" for field, _, _ in fields)
                raise DataError(
                    f"{where}: no {missing}; choose --derivatives causal or zero-phase"
                )


def _without_lag(
    joints: Sequence[str],
    motion: Motion,
    position: Array,
    velocity: Array | None,
    derivatives: Derivatives,
) -> tuple[Array, Array, Array, list[BodyMotion], Array | None, list[str]]:
    """Return position, velocity, acceleration, bodies, cutoff frequencies and remarks."""
    width, n, names, stamps = derivatives.half_width, len(joints), list(joints), motion.stamps
    signals = BodySignals(motion.bodies) if motion.bodies else None
    if signals is not None:
        velocity = np.full_like(position, np.nan) if velocity is None else velocity
        position = np.hstack([position, signals.position])
        velocity, names = np.hstack([velocity, signals.velocity]), names + signals.names
    if width is not None and derivatives.cutoff is not None:
        raise DataError("--half-width and --cutoff are not accepted together; give one of them")
    if width is not None:
        fitted = local_polynomials(stamps, position, velocity, half_width=width)
        fields, cutoff, remarks = (position, *fitted), None, list[str]()
    else:
        from mbd_ros.motion.cutoff import cutoff_lines
        from mbd_ros.motion.filters import zero_phase

        smooth = zero_phase(stamps, position, velocity, cutoff=derivatives.cutoff)
        is_chosen = derivatives.cutoff is None
        remarks = list(cutoff_lines(smooth.cutoff, names, is_chosen, len(stamps)))
        fields = (smooth.position, smooth.velocity, smooth.acceleration)
        cutoff = smooth.cutoff[:n]
    bodies = [] if signals is None else signals.motions(*(values[:, n:] for values in fields))
    joint_fields = (values[:, :n] for values in fields)
    return *joint_fields, bodies, cutoff, remarks


class BodySignals:
    """Poses and twists of free bodies as signals for filters without lag.

    The signals of a body are the seven numbers of its pose and, if it is measured, its twist.
    Rotations are filtered as the four numbers of a quaternion, whose length cancels afterwards; so
    a low-pass filter neither mixes axes nor needs a chart. A measured twist is differentiated
    directly.

    Args:
        bodies: Motion of the bodies; a twist with a gap counts as not measured.

    Attributes:
        names: Names of the signals.
        position: Signals, with 0 for the integral of a twist, shape (n, m).
        velocity: Rates of the signals, NaN where not measured, shape (n, m).
    """

    def __init__(self, bodies: Sequence[BodyMotion]) -> None:
        self._bodies = bodies
        self.names: list[str] = []
        positions, velocities = [], []
        for body in bodies:
            twist, rate = _measured(body), np.full_like(body.pose, np.nan)
            self.names += names_of(body.name, POSE_WORDS)
            if twist is not None:
                rate = rate_of(body.pose, twist)
                self.names += names_of(body.name, TWIST_WORDS)
            positions += [body.pose] + [np.zeros_like(t) for t in (twist,) if t is not None]
            velocities += [rate] + [t for t in (twist,) if t is not None]
        self.position, self.velocity = np.hstack(positions), np.hstack(velocities)

    def motions(self, position: Array, velocity: Array, acceleration: Array) -> list[BodyMotion]:
        """Return the motion of the bodies from filtered signals and derivatives, shape (n, m)."""
        motions, begin = [], 0
        for body in self._bodies:
            pose = slice(begin, begin + POSE)
            q, rate, second = position[:, pose], velocity[:, pose], acceleration[:, pose]
            begin += POSE
            if _measured(body) is None:
                twist, twist_rate = twist_of(q, rate), acceleration_of(q, rate, second)
            else:
                columns = slice(begin, begin + TWIST)
                twist, twist_rate = velocity[:, columns], acceleration[:, columns]
                begin += TWIST
            motions.append(BodyMotion(body.name, q, twist, twist_rate))
        return motions


def _measured(body: BodyMotion) -> Array | None:
    """Return the twist of a body if every sample has one, otherwise None."""
    return None if body.twist is None or np.isnan(body.twist).any() else body.twist


def _independent_coordinates(
    scene: Scene, joints: tuple[Array, Array, Array], bodies: Sequence[BodyMotion]
) -> tuple[Array, Array, Array]:
    """Return y, y' and y'' of joints and free bodies."""
    if not bodies:
        return joints
    c = IndependentCoordinates(scene.robot, scene.couplings)
    poses = [configuration_of(scene.robot, body.pose) for body in bodies]
    twists = [body.twist for body in bodies if body.twist is not None]
    accelerations = [body.acceleration for body in bodies if body.acceleration is not None]
    return (
        c.positions(np.hstack([joints[0], *poses])),
        c.rates(np.hstack([joints[1], *twists])),
        c.rates(np.hstack([joints[2], *accelerations])),
    )


class Differentiated(NamedTuple):
    """Samples of the independent coordinates with derivatives.

    Attributes:
        samples: The samples.
        cutoff: Cutoff frequency of the low-pass filter of each joint [Hz], shape (m,), or None.
        remarks: Remarks on how they were computed.
    """

    samples: Observations
    cutoff: Array | None
    remarks: list[str]
