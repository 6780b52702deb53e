"""Contacts whose forces nobody measured: unknowns of inverse dynamics."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.geometry.contact_show import OPEN
from mbd_ros.core.inverse.bounded_split import Wish
from mbd_ros.core.inverse.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.inverse.double_support import (
    DoubleSupport,
    direction_of_way,
    double_supports,
    kept_force,
    possible_force,
)
from mbd_ros.core.inverse.reach import listed
from mbd_ros.core.inverse.standing import Nearness
from mbd_ros.core.inverse.torques import Torques
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DataError, SolveError
from mbd_ros.files.recordings import Source, name_of, read_columns
from mbd_ros.jobs.inverse.observed import Observed
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene

Mask = NDArray[np.bool_]
METHODS = ("minimum-norm", "smooth")
Solve = Callable[[int, Wish | None], Torques]


class StanceTask(NamedTuple):
    """What is asked of feet on the ground.

    Attributes:
        method: One of `METHODS`: what decides where a motion does not.
        near: What counts as on the ground, where the motion has no states of contacts.
    """

    method: str = METHODS[0]
    near: Nearness = Nearness()


class Ground(NamedTuple):
    """Contacts of unknown force.

    Attributes:
        task: What is asked.
        contacts: Their names.
        given: Which features stand, as columns of the motion say, shape (n, features); None for
            what geometry says.
    """

    task: StanceTask
    contacts: tuple[str, ...]
    given: Mask | None = None

    def with_states(self, scene: Scene, source: Source, observed: Observed) -> "Ground":
        """The same with what columns `<contact>.state` of a motion say of its features.

        Raises:
            DataError: Some of these columns are there and others are not; names these.
        """
        parts = [part for part in scene.constraints if part.name in self.contacts]
        names = [
            f"{part.name}.state" + (f"_{feature}" if len(part.features) > 1 else "")
            for part in parts
            for feature in part.features
        ]
        states = read_columns(source, names)
        if states is None:
            return self
        gaps = np.isnan(states).any(axis=0)
        lacking = [name for name, bad in zip(names, gaps, strict=True) if bad]
        if lacking:
            raise DataError(
                f"{name_of(source)}: no column {listed(lacking)}, or it has gaps; accepted: the "
                f"states of all features, or none: {listed(names)}"
            )
        rows = np.searchsorted(observed.motion.stamps, observed.samples.stamps)
        return self._replace(given=states[rows] != OPEN)


def stance_task(method: str | None, gap: float | None, speed: float | None) -> StanceTask | None:
    """The task of the options of a command; None where none is asked for.

    Raises:
        DataError: An unknown method, thresholds below 0, or thresholds alone.
    """
    given = {"gap": gap, "speed": speed}
    limits = {name: value for name, value in given.items() if value is not None}
    if method is None:
        if limits:
            raise DataError(f"--stance-{next(iter(limits))} goes with --stance")
        return None
    if method not in METHODS:
        raise DataError(f"--stance {method}: accepted: {', '.join(METHODS)}")
    for name, value in limits.items():
        if not 0.0 <= value < np.inf:
            raise DataError(f"--stance-{name} {value:g} must be >= 0 and finite")
    return StanceTask(method, Nearness()._replace(**limits))


def ground_of(scene: Scene, task: StanceTask, known: Sequence[str], say: Say) -> Ground:
    """The contacts of unknown force of a scene.

    Args:
        scene: The scene, with the loads that somebody measured.
        task: What is asked.
        known: Contacts whose forces the motion carries.
        say: Is told what is known.

    Raises:
        DataError: The scene has no rigid contacts.
    """
    every = scene.closed_contacts
    if not every:
        raise DataError(f"{scene.name}: --stance: no rigid contacts; accepted: a scene with some")
    unknown = tuple(name for name in scene.unmeasured_contacts if name not in known)
    measured = [name for name in every if name not in unknown]
    if measured:
        say(f"stance: forces of {listed(measured)} are measured")
    return Ground(task, unknown)


def standing_in(
    inverse: ClosedLoopInverseDynamics, ground: Ground, states: Sequence[tuple[State, Array]]
) -> Mask:
    """Which features stand in each sample, shape (n, features)."""
    assert inverse.standing is not None
    if ground.given is not None:
        return ground.given
    return np.array([inverse.standing.at(x) for x, _ in states])


def smooth_transitions(
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    standing: Mask,
    solved: list[Torques],
    solve: Solve,
) -> str:
    """Solve double supports again, so that the load passes on smoothly.

    Args:
        inverse: The solver.
        states: Motion and accelerations.
        standing: Which features stand, shape (n, features).
        solved: Results, some of which are replaced.
        solve: Number of a sample and a wish -> its result.

    Returns:
        How many there are, in words.
    """
    transition = _Transition(inverse, states, standing, solved)
    refused = 0
    for support in transition.supports:
        for i, wish in transition.wishes(support):
            try:
                solved[i] = solve(i, wish)
            except SolveError:
                refused += 1
    passed = f"smooth transition in {len(transition.supports)} double supports"
    return passed + (f", without {refused} samples where cones forbid it" if refused else "")


class _Transition:
    """Double supports of a motion that was solved with the least efforts.

    Args:
        inverse: The solver.
        states: Motion and accelerations.
        standing: Which features stand, shape (n, features).
        solved: Their results.

    Attributes:
        supports: Those that begin in the motion.
    """

    def __init__(
        self,
        inverse: ClosedLoopInverseDynamics,
        states: Sequence[tuple[State, Array]],
        standing: Mask,
        solved: Sequence[Torques],
    ) -> None:
        assert inverse.standing is not None
        self._feet, self._model = inverse.standing, inverse.robot.model
        self._states, self._standing = states, standing
        cones = inverse.constraints.cones
        slots = np.concatenate([np.r_[cone.slots] for cone in cones])
        self._forces = [each.multipliers[slots] for each in solved]
        self._mu = min(cone.mu for cone in cones)
        self._times = np.array([x.t for x, _ in states])
        stands = np.array([self._feet.standing_feet(row) for row in standing])
        self.supports = list(double_supports(self._times, stands))

    def wishes(self, support: DoubleSupport) -> Iterator[tuple[int, Wish]]:
        """The force of the trailing foot in each sample of a double support."""
        (before, samples, foot, end), times = support, self._times
        at_first = self._feet.forces(self._states[before][0])[foot].dot(self._forces[before])
        data, ends = pin.Data(self._model), (before, samples[-1])
        centres = [pin.centerOfMass(self._model, data, self._states[i][0].q).copy() for i in ends]
        way = direction_of_way(centres, self._model.gravity.linear)
        for i in samples:
            share = float((times[i] - times[before]) / (end - times[before]))
            forces = self._feet.forces(self._states[i][0])
            total = forces.sum(axis=0).dot(self._forces[i])
            others = np.delete(forces, foot, axis=0).sum(axis=0)[:, ::3]
            normal = others.dot(self._standing[i])
            normal /= np.linalg.norm(normal)
            kept = kept_force(at_first, way, min(share, 1.0))
            yield i, Wish(forces[foot], possible_force(kept, total, normal, self._mu))


def stance_lines(
    inverse: ClosedLoopInverseDynamics,
    ground: Ground,
    standing: Mask,
    solved: Sequence[Torques],
    passed: str,
) -> Iterator[str]:
    """What decided, who stood, and what the forces leave."""
    feet = inverse.standing
    assert feet is not None
    stands = np.array([feet.standing_feet(row) for row in standing])
    near = ground.task.near
    by = f"gap <= {near.gap:g} L and speed along the normal <= {near.speed:g} sqrt(g L)"
    if ground.given is not None:
        by = "columns of states"
    shares = ", ".join(
        f"{name} {share:.0%}" for name, share in zip(feet.feet_names, stands.mean(0), strict=True)
    )
    yield f"stance: by {by}; on the ground {shares} of the time, both or more {_several(stands)}"
    free = [any(name.endswith(".effort") for name in each.undetermined) for each in solved]
    if any(free):
        how = "smallest norm of efforts, then of forces"
        if passed:
            how = f"{passed}, else {how}"
        yield f"stance: efforts are not determined in {np.mean(free):.0%} of the samples: {how}"
    bases = np.array([np.concatenate((each.residual, each.carried)) for each in solved])
    if bases.shape[1]:
        weight = float(sum(y.mass for y in inverse.robot.model.inertias)) * float(
            np.linalg.norm(inverse.robot.model.gravity.linear)
        )
        largest = np.abs(bases).max()
        size = f"{largest:.3g} N or N·m, the weight is {weight:.4g} N"
        yield f"stance: residual of the base at most {size}"


def _several(stands: Mask) -> str:
    return f"{(stands.sum(axis=1) > 1).mean():.0%}"
