"""Samples of a recorded motion with velocity and acceleration."""

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
GAIT = 6.0  # Hz: what laboratories of gait take, and the set-ups of OpenSim's own examples


class Derivatives(NamedTuple):
    """Where velocity and acceleration come from.

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
        given = self.cutoff if self.source == "causal" else None
        return Tuning().cutoff if given is None else given

    @property
    def opensim_cutoff(self) -> float | None:
        """Half-power frequency of a pass of OpenSim's filter [Hz]; None without a filter."""
        cutoff = GAIT if self.cutoff is None else self.cutoff
        return None if cutoff == math.inf else cutoff


def differentiate(
    scene: Scene, where: str, motion: Motion, derivatives: Derivatives
) -> Differentiated:
    """Samples of the independent coordinates, with the derivatives given or without lag.

    Args:
        where: What the motion is from, for the messages.
        derivatives: Where velocity and acceleration come from.

    Raises:
        DataError: Derivatives are to be given and are not, or samples are too few.
    """
    if derivatives.source == OPENSIM:
        return _splined(scene, where, motion, derivatives)
    n, bodies = len(scene.couplings.independent), list(motion.bodies)
    position = motion.position[:, :n].copy()
    wraps = [scene.robot.joint(j).kind == "continuous" for j in scene.couplings.independent]
    position[:, wraps] = np.unwrap(position[:, wraps], axis=0)
    if derivatives.source == "given":
        velocity = _given(scene, where, position, motion.velocity, "velocity")
        acceleration = _given(scene, where, position, motion.acceleration, "acceleration")
        cutoff, remarks = None, []
        _check_given(where, bodies)
    else:
        measured = None if motion.velocity is None else motion.velocity[:, :n]
        position, velocity, acceleration, bodies, cutoff, remarks = _without_lag(
            scene.couplings.independent, motion, position, measured, derivatives
        )
    whole = _together(scene, (position, velocity, acceleration), bodies)
    samples = Observations(motion.stamps, *whole, motion.position[:, n:])
    return Differentiated(samples, cutoff, remarks)


def _splined(scene: Scene, where: str, motion: Motion, derivatives: Derivatives) -> Differentiated:
    """Samples as OpenSim has them, from positions alone; their times may be others."""
    from mbd_ros.methods.signals.opensim_splines import opensim_splines  # loads scipy

    if motion.bodies:
        names = ", ".join(body.name for body in motion.bodies)
        raise DataError(f"{where}: --derivatives opensim knows joints alone, not the free {names}")
    n = len(scene.couplings.independent)
    there = np.isfinite(motion.position).all(axis=0)
    there[:n] = True
    cutoff = derivatives.opensim_cutoff
    found = opensim_splines(motion.stamps, motion.position[:, there], cutoff)
    position = np.full((len(found.stamps), len(there)), np.nan)
    position[:, there] = found.position
    own = (values[:, :n] for values in found[1:])
    samples = Observations(found.stamps, *own, position[:, n:])
    filtered = "no filter" if cutoff is None else f"low-pass at {cutoff:g} Hz, both ways"
    said = [f"opensim derivatives: {filtered}, quintic splines"]
    if not np.array_equal(found.stamps, motion.stamps):
        said.append("resampled at the smallest step of the motion, as OpenSim does")
    return Differentiated(samples, None, said)


def _given(scene: Scene, where: str, position: Array, values: Array | None, field: str) -> Array:
    names = scene.couplings.independent
    if not names:
        return position
    lacking = [
        name
        for i, name in enumerate(names)
        if values is None or not np.isfinite(values[:, i]).all()
    ]
    if values is None or lacking:
        raise DataError(
            f"{where}: no {field} of {', '.join(lacking)}; "
            "choose --derivatives causal, zero-phase or opensim"
        )
    return values[:, : len(names)]


def _check_given(where: str, bodies: Sequence[BodyMotion]) -> None:
    """Refuse bodies whose derivatives are not there."""
    for body in bodies:
        for values, words in ((body.twist, TWIST_WORDS), (body.acceleration, ACCELERATION_WORDS)):
            if values is None or not np.isfinite(values).all():
                lacking = " and ".join(f"{body.name}.{word}" for word, _, _ in words)
                raise DataError(
                    f"{where}: no {lacking}; choose --derivatives causal or zero-phase"
                )


def _without_lag(
    joints: Sequence[str],
    motion: Motion,
    position: Array,
    velocity: Array | None,
    derivatives: Derivatives,
) -> tuple[Array, Array, Array, list[BodyMotion], Array | None, list[str]]:
    """Position, velocity, acceleration of joints; bodies; cut-off of each joint, and remarks."""
    width, n, names, stamps = derivatives.half_width, len(joints), list(joints), motion.stamps
    signals = BodySignals(motion.bodies) if motion.bodies else None
    if signals is not None:
        velocity = np.full_like(position, np.nan) if velocity is None else velocity
        position = np.hstack([position, signals.position])
        velocity, names = np.hstack([velocity, signals.velocity]), names + signals.names
    if width is not None and derivatives.cutoff is not None:
        raise DataError("--half-width and --cutoff: zero-phase derivatives take one of them")
    if width is not None:
        fitted = local_polynomials(stamps, position, velocity, half_width=width)
        whole, cutoff, said = (position, *fitted), None, list[str]()
    else:
        from mbd_ros.motion.cutoff import cutoff_lines
        from mbd_ros.motion.filters import zero_phase

        *found, cutoffs = zero_phase(stamps, position, velocity, cutoff=derivatives.cutoff)
        chosen = derivatives.cutoff is None
        said = list(cutoff_lines(cutoffs, names, chosen, len(stamps)))
        whole, cutoff = (found[0], found[1], found[2]), cutoffs[:n]
    bodies = [] if signals is None else signals.motions(*(values[:, n:] for values in whole))
    own = (values[:, :n] for values in whole)
    return *own, bodies, cutoff, said


class BodySignals:
    """Free bodies of a recording as signals that are filtered without lag.

    Each body is the seven numbers of its pose, then its twist where that is measured.

    A rotation is followed by the numbers of its quaternion, whose length counts out afterwards: a
    low-pass mixes no axes and needs no chart. A measured twist is differentiated as it is.

    Args:
        bodies: Their motion; a twist with a gap counts as not measured.

    Attributes:
        names: Of the signals.
        position: Signals, 0 in place of the integral of a twist, shape (n, m).
        velocity: Their rates, NaN where not measured, same shape.
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
        """Motion of the bodies from the filtered signals and their derivatives, shape (n, m)."""
        found, at = [], 0
        for body in self._bodies:
            pose = slice(at, at + POSE)
            q, rate, second = position[:, pose], velocity[:, pose], acceleration[:, pose]
            at += POSE
            if _measured(body) is None:
                twist, push = twist_of(q, rate), acceleration_of(q, rate, second)
            else:
                own = slice(at, at + TWIST)
                twist, push = velocity[:, own], acceleration[:, own]
                at += TWIST
            found.append(BodyMotion(body.name, q, twist, push))
        return found


def _measured(body: BodyMotion) -> Array | None:
    """Its twist where every sample has one."""
    return None if body.twist is None or np.isnan(body.twist).any() else body.twist


def _together(
    scene: Scene, joints: tuple[Array, Array, Array], bodies: Sequence[BodyMotion]
) -> tuple[Array, Array, Array]:
    """y, y' and y'' of joints and free bodies."""
    if not bodies:
        return joints
    c = IndependentCoordinates(scene.robot, scene.couplings)
    poses = [configuration_of(scene.robot, body.pose) for body in bodies]
    twists = [body.twist for body in bodies if body.twist is not None]
    pushes = [body.acceleration for body in bodies if body.acceleration is not None]
    return (
        c.positions(np.hstack([joints[0], *poses])),
        c.rates(np.hstack([joints[1], *twists])),
        c.rates(np.hstack([joints[2], *pushes])),
    )


class Differentiated(NamedTuple):
    """Samples of the independent coordinates, and their origin.

    Attributes:
        cutoff: Of the low-pass of each joint [Hz], shape (m,); None without one.
        remarks: Remarks on them, for people.
    """

    samples: Observations
    cutoff: Array | None
    remarks: list[str]
