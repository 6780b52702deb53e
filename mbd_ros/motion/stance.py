"""Unmeasured ground forces of walking: which feet stand, and how they share the load.

Forces of these contacts are unknowns of inverse dynamics. During a double support of duration T,
the force of the trailing foot decays from its initial value by these factors (smooth transition):

    along the walking direction     k1 exp(-(2 (t - T / 3) / T)^2) - 2 k2 t / T
    sideways and upwards            exp(-(2 t / T)^3),    k1 = e^(4/9), k2 = e^(-4/3) / 2

Source: L. Ren, R. K. Jones, D. Howard, J. Biomechanics 41 (2008) 2750,
doi:10.1016/j.jbiomech.2008.06.001, for the forces of walking persons.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.geometry.contact_outputs import OPEN
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DataError, SolveError
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.methods.inverse_dynamics.efforts import Mask, join_names
from mbd_ros.methods.inverse_dynamics.force_split import ForceTarget
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import Torques
from mbd_ros.methods.inverse_dynamics.stance import StanceThresholds
from mbd_ros.motion.recordings import Source, name_of, read_columns
from mbd_ros.scene.built_scene import Scene

Method = Literal["minimum-norm", "smooth"]
METHODS = get_args(Method)
_INSIDE = 0.9  # of the friction that a normal force bears: the corners of a foot differ
_AHEAD = math.exp(4.0 / 9.0), math.exp(-4.0 / 3.0) / 2.0
Solve = Callable[[int, ForceTarget | None], Torques]


class StanceTask(NamedTuple):
    """Options for estimating forces of feet on the ground that were not measured.

    Attributes:
        method: Makes the forces of unmeasured contacts unknowns, and decides between them where
            the motion does not. minimum-norm: the least efforts. smooth: the smooth transition of
            walking from one foot to the other.
        near: Thresholds of a contact, where the motion has no states of contacts.
    """

    method: Method = "minimum-norm"
    near: StanceThresholds = StanceThresholds()


def stance_of(method: str | None, gap: float | None, speed: float | None) -> StanceTask | None:
    """Return the task from the options of a command, or None without the option --stance.

    Raises:
        DataError: The method is unknown, a threshold is negative or standing without a method.
    """
    limits = {k: v for k, v in {"gap": gap, "speed": speed}.items() if v is not None}
    if method is None:
        if limits:
            raise DataError(
                f"--stance-{next(iter(limits))} is accepted together with --stance only"
            )
        return None
    if method not in METHODS:
        raise DataError(f"--stance {method}: accepted: {', '.join(METHODS)}")
    for name, value in limits.items():
        if not 0.0 <= value < np.inf:
            raise DataError(f"--stance-{name} {value:g} must be >= 0 and finite")
    return StanceTask(method, StanceThresholds()._replace(**limits))


class Ground(NamedTuple):
    """Contacts of unknown force.

    Attributes:
        task: Options.
        contacts: Names of the contacts.
        standing: Which contact features carry load, from columns of the motion, shape
            (n, features); None if they are detected from the geometry.
        by: Source of `standing`, for messages.
    """

    task: StanceTask
    contacts: tuple[str, ...]
    standing: Mask | None = None
    by: str = "geometry"

    def with_recorded_states(
        self,
        scene: Scene,
        source: Source,
        stamps: NDArray[np.int64],
        samples: NDArray[np.int64],
    ) -> Ground:
        """Return the same contacts with the contact states that a motion contains.

        The states are columns `<contact>.state`, or follow from a column `phase` if the phases of
        the scene hold contacts.

        Args:
            scene: The scene.
            source: The motion.
            stamps: Stamps of its rows [ns], ascending.
            samples: Stamps of the rows that are solved [ns].

        Raises:
            DataError: Some columns of states are missing, or the scene has no such phase.
        """
        rows = np.searchsorted(stamps, samples)
        parts = [part for part in scene.constraints if part.name in self.contacts]
        states = _states(source, parts)
        if states is not None:
            return self._replace(standing=states[rows] != OPEN, by="columns of states")
        closed = _closed_in_phases(scene, source, parts) if scene.phases else None
        return self if closed is None else self._replace(standing=closed[rows], by="phases")


def _states(source: Source, parts: Sequence[Any]) -> Array | None:
    """Return the columns of states of all features, or None if there are none."""
    names = [
        f"{part.name}.state" + (f"_{feature}" if len(part.features) > 1 else "")
        for part in parts
        for feature in part.features
    ]
    states = read_columns(source, names)
    gaps = [] if states is None else np.isnan(states).any(axis=0)
    missing = [name for name, is_bad in zip(names, gaps, strict=False) if is_bad]
    if missing:
        raise DataError(
            f"{name_of(source)}: no column {join_names(missing)}, or it has gaps; accepted: the "
            f"states of all features, or none: {join_names(names)}"
        )
    return states


def _closed_in_phases(scene: Scene, source: Source, parts: Sequence[Any]) -> Mask | None:
    """Return the features that the phase of each row keeps closed; None if that is not known."""
    plans, numbers = list(scene.phases.values()), read_columns(source, ["phase"])
    if numbers is None or not all(plan.keeps_closed for plan in plans):
        return None
    unknown = ~np.isin(numbers[:, 0], np.arange(len(plans)))
    if unknown.any():
        raise DataError(
            f"{name_of(source)}: the scene has no phase {numbers[unknown][0, 0]:g}; accepted: "
            f"0 to {len(plans) - 1}: {', '.join(plan.name for plan in plans)}"
        )
    of_phase = np.array(
        [[part.name in plan.contacts for part in parts for _ in part.features] for plan in plans]
    )
    closed: Mask = of_phase[numbers[:, 0].astype(int)]
    return closed


def ground_of(scene: Scene, task: StanceTask, known: Sequence[str], say: Say) -> Ground:
    """Return the contacts of a scene whose forces are unknown.

    Args:
        scene: The scene with its measured loads.
        task: Options.
        known: Contacts whose forces the motion contains.
        say: Function that prints remarks.

    Raises:
        DataError: The scene has no rigid contacts.
    """
    every = scene.closed_contacts
    if not every:
        raise DataError(f"{scene.name}: --stance needs a scene with rigid contacts")
    unknown = tuple(name for name in scene.unmeasured_contacts if name not in known)
    measured = [name for name in every if name not in unknown]
    if measured:
        say(f"stance: forces of {join_names(measured)} are measured")
    return Ground(task, unknown)


def standing_in(
    inverse: ClosedLoopInverseDynamics, ground: Ground, states: Sequence[tuple[State, Array]]
) -> Mask:
    """Return which features carry load in each sample, shape (n, features)."""
    assert inverse.stance is not None
    if ground.standing is not None:
        return ground.standing
    return np.array([inverse.stance.detect(x) for x, _ in states])


def stance_lines(
    inverse: ClosedLoopInverseDynamics,
    ground: Ground,
    standing: Mask,
    solved: Sequence[Torques],
    passed: str,
) -> Iterator[str]:
    """Yield remarks: how stance was detected, which feet stood, and the residual of the base."""
    feet = inverse.stance
    assert feet is not None
    stands = np.array([feet.stance_feet(row) for row in standing])
    near = ground.task.near
    by = f"gap <= {near.gap:g} L and speed along the normal <= {near.speed:g} sqrt(g L)"
    if ground.standing is not None:
        by = ground.by
    shares = ", ".join(
        f"{name} {share:.0%}" for name, share in zip(feet.feet_names, stands.mean(0), strict=True)
    )
    yield f"stance: by {by}; on the ground {shares} of the time, both or more {_several(stands)}"
    free = [any(name.endswith(".effort") for name in each.undetermined) for each in solved]
    if any(free):
        how = "smallest norm of efforts, then of forces"
        if passed:
            how = f"{passed}, else {how}"
        yield f"stance: efforts are not unique in {np.mean(free):.0%} of the samples: {how}"
    bases = np.array([np.concatenate((each.residual, each.root_residual)) for each in solved])
    if bases.shape[1]:
        weight = float(sum(y.mass for y in inverse.robot.model.inertias)) * float(
            np.linalg.norm(inverse.robot.model.gravity.linear)
        )
        largest = np.abs(bases).max()
        size = f"{largest:.3g} N or N·m, the weight is {weight:.4g} N"
        yield f"stance: residual of the base at most {size}"


def _several(stands: Mask) -> str:
    return f"{(stands.sum(axis=1) > 1).mean():.0%}"


def smooth_transitions(
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    standing: Mask,
    solved: list[Torques],
    solve: Solve,
) -> str:
    """Solve double supports again, so that the load passes smoothly from foot to foot.

    Args:
        inverse: Inverse dynamics with contacts.
        states: States and accelerations.
        standing: Which features carry load, shape (n, features).
        solved: Results; those of double supports are replaced.
        solve: Function of the index of a sample and a force target that returns the result.

    Returns:
        Remark on the number of double supports.
    """
    transition = _Transition(inverse, states, standing, solved)
    refused = 0
    for support in transition.supports:
        for i, target in transition.force_targets(support):
            try:
                solved[i] = solve(i, target)
            except SolveError:
                refused += 1
    passed = f"smooth transition in {len(transition.supports)} double supports"
    return passed + (f", without {refused} samples where cones forbid it" if refused else "")


class _Transition:
    """Double supports of a motion, and the force targets of their trailing feet.

    Args:
        inverse: Inverse dynamics with contacts.
        states: States and accelerations.
        standing: Which features carry load, shape (n, features).
        solved: Results with minimum-norm efforts.

    Attributes:
        supports: Double supports that start in the motion.
    """

    def __init__(
        self,
        inverse: ClosedLoopInverseDynamics,
        states: Sequence[tuple[State, Array]],
        standing: Mask,
        solved: Sequence[Torques],
    ) -> None:
        assert inverse.stance is not None
        self._feet, self._model = inverse.stance, inverse.robot.model
        self._states, self._standing = states, standing
        cones = inverse.constraints.cones
        slots = np.concatenate([np.r_[cone.slots] for cone in cones])
        self._forces = [each.multipliers[slots] for each in solved]
        self._mu = min(cone.mu for cone in cones)
        self._times = np.array([x.t for x, _ in states])
        stands = np.array([self._feet.stance_feet(row) for row in standing])
        self.supports = list(double_supports(self._times, stands))

    def force_targets(self, support: DoubleSupport) -> Iterator[tuple[int, ForceTarget]]:
        """Yield the target force of the trailing foot in each sample of a double support."""
        (before, samples, foot, end), times = support, self._times
        at_first = self._feet.forces(self._states[before][0])[foot].dot(self._forces[before])
        data, ends = pin.Data(self._model), (before, samples[-1])
        centres = [pin.centerOfMass(self._model, data, self._states[i][0].q).copy() for i in ends]
        direction = walking_direction(centres, self._model.gravity.linear)
        for i in samples:
            share = float((times[i] - times[before]) / (end - times[before]))
            forces = self._feet.forces(self._states[i][0])
            total = forces.sum(axis=0).dot(self._forces[i])
            others = np.delete(forces, foot, axis=0).sum(axis=0)[:, ::3]
            normal = others.dot(self._standing[i])
            normal /= np.linalg.norm(normal)
            force = trailing_force(at_first, direction, min(share, 1.0))
            yield i, ForceTarget(forces[foot], feasible_force(force, total, normal, self._mu))


class DoubleSupport(NamedTuple):
    """Samples with more than one foot on the ground, after a single support.

    Attributes:
        before: Last sample of the single support before.
        samples: Samples of the double support.
        foot: Trailing foot, which stood alone before.
        end: Time of the first sample after the double support, or of the last sample [s].
    """

    before: int
    samples: range
    foot: int
    end: float


def double_supports(times: Array, feet: NDArray[np.bool_]) -> Iterator[DoubleSupport]:
    """Yield the double supports that start in a motion.

    Args:
        times: Times of the samples [s], shape (n,).
        feet: Which feet stand, shape (n, feet).
    """
    several = feet.sum(axis=1) > 1
    starts = np.flatnonzero(several[1:] & ~several[:-1]) + 1
    for start in starts.tolist():
        before = start - 1
        if not feet[before].any():
            continue  # after a flight phase, no foot is the trailing one
        foot, after = int(np.argmax(feet[before])), np.flatnonzero(~several[start:])
        end = start + int(after[0]) if len(after) else len(times)
        last = float(times[min(end, len(times) - 1)])
        yield DoubleSupport(before, range(start, end), foot, last)


def trailing_force(force: Array, direction: Array, share: float) -> Array:
    """Return the force of the trailing foot after a fraction of the double support.

    Args:
        force: Force at the start of the double support [N], shape (3,).
        direction: Walking direction, of length 1, shape (3,).
        share: Fraction t / T, 0 .. 1.

    Returns:
        Force in the axes of `force` [N], shape (3,).
    """
    k1, k2 = _AHEAD
    along = k1 * math.exp(-((2.0 * (share - 1.0 / 3.0)) ** 2)) - 2.0 * k2 * share
    across = math.exp(-((2.0 * share) ** 3))
    ahead = direction.dot(force) * direction
    trailing: Array = along * ahead + across * (force - ahead)
    return trailing


def feasible_force(trailing: Array, total: Array, normal: Array, mu: float) -> Array:
    """Adapt the force of the trailing foot so that the force of the others is in its cone.

    Args:
        trailing: Desired force on the trailing foot [N], shape (3,).
        total: Force on all feet [N], shape (3,).
        normal: Normal of the ground below the other feet, of length 1, shape (3,).
        mu: Friction coefficient of the other feet.

    Returns:
        Force on the trailing foot [N], shape (3,).
    """
    leading = total - trailing
    push = max(float(normal.dot(leading)), 0.0)
    friction = leading - normal.dot(leading) * normal
    limit, length = _INSIDE * mu * push, float(np.linalg.norm(friction))
    if length > limit:
        friction *= limit / length
    feasible: Array = total - push * normal - friction
    return feasible


def walking_direction(positions: Sequence[Array], gravity: Array) -> Array:
    """Return the horizontal direction from the first to the last position, (3,); 0 at rest."""
    up = -gravity / (float(np.linalg.norm(gravity)) or 1.0)
    step = positions[-1] - positions[0]
    level = step - up.dot(step) * up
    length = float(np.linalg.norm(level))
    return level / length if length > 0.0 else np.zeros(3)
