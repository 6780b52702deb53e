"""Contacts whose forces nobody measured: unknowns of inverse dynamics."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.geometry.contact_outputs import OPEN
from mbd_ros.core.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.inverse_dynamics.standing import Nearness
from mbd_ros.core.inverse_dynamics.torques import Torques
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DataError
from mbd_ros.jobs.lines import Say
from mbd_ros.motion.recordings import Source, name_of, read_columns
from mbd_ros.motion.samples import Observed
from mbd_ros.scene.built_scene import Scene

Mask = NDArray[np.bool_]
METHODS = ("minimum-norm", "smooth")


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
        by: What says so.
    """

    task: StanceTask
    contacts: tuple[str, ...]
    given: Mask | None = None
    by: str = "geometry"

    def told(self, scene: Scene, source: Source, observed: Observed) -> "Ground":
        """The same with what columns of a motion say of the features.

        `<contact>.state` says it of each, `phase` by the contacts of a phase where these are
        held.

        Raises:
            DataError: Some columns of states are there and others are not, or a phase that the
                scene does not have; names these.
        """
        rows = np.searchsorted(observed.motion.stamps, observed.samples.stamps)
        parts = [part for part in scene.constraints if part.name in self.contacts]
        states = _states(source, parts)
        if states is not None:
            return self._replace(given=states[rows] != OPEN, by="columns of states")
        held = _held(scene, source, parts) if scene.phases else None
        return self if held is None else self._replace(given=held[rows], by="phases")


def _states(source: Source, parts: Sequence[Any]) -> Array | None:
    """Columns of states of all features; None where there is none of them."""
    names = [
        f"{part.name}.state" + (f"_{feature}" if len(part.features) > 1 else "")
        for part in parts
        for feature in part.features
    ]
    states = read_columns(source, names)
    gaps = [] if states is None else np.isnan(states).any(axis=0)
    lacking = [name for name, bad in zip(names, gaps, strict=False) if bad]
    if lacking:
        raise DataError(
            f"{name_of(source)}: no column {listed(lacking)}, or it has gaps; accepted: the "
            f"states of all features, or none: {listed(names)}"
        )
    return states


def _held(scene: Scene, source: Source, parts: Sequence[Any]) -> Mask | None:
    """Features that the phase of each row holds; None without phases, or where some hold none."""
    plans, numbers = list(scene.phases.values()), read_columns(source, ["phase"])
    if numbers is None or not all(plan.held for plan in plans):
        return None
    unknown = ~np.isin(numbers[:, 0], np.arange(len(plans)))
    if unknown.any():
        raise DataError(
            f"{name_of(source)}: phase {numbers[unknown][0, 0]:g} is none of the scene; accepted: "
            f"0 to {len(plans) - 1}: {', '.join(plan.name for plan in plans)}"
        )
    of_phase = np.array(
        [[part.name in plan.contacts for part in parts for _ in part.features] for plan in plans]
    )
    held: Mask = of_phase[numbers[:, 0].astype(int)]
    return held


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
