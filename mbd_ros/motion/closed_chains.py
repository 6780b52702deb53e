"""Efforts and multipliers of recorded motions of mechanisms with loops."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.inverse_dynamics.power_balance import Exerted
from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.inverse_dynamics.torque_estimator import Observations
from mbd_ros.core.inverse_dynamics.torques import Torques
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.core.thresholds import TOGGLE
from mbd_ros.errors import SolveError
from mbd_ros.files.table import Column
from mbd_ros.jobs.progress import progress
from mbd_ros.motion import open_chains
from mbd_ros.motion.columns import (
    body_columns,
    carried_columns,
    force_topic,
    joint_columns,
    output_columns,
    state_topics,
    whole_bodies,
)
from mbd_ros.motion.explained_motion import Explained, Way
from mbd_ros.motion.samples import Task
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    from mbd_ros.core.inverse_dynamics.bounded_split import Wish
    from mbd_ros.motion.unmeasured_contacts import Ground


def solve(
    scene: Scene,
    where: str,
    samples: Observations,
    wrenches: Sequence[Array],
    task: Task,
    ground: "Ground | None" = None,
) -> Way:
    """Efforts and multipliers of observations.

    Args:
        scene: A scene with loops.
        where: Source of the motion, for the messages.
        samples: The observations.
        wrenches: One (n, 6) array for every load of the scene.
        task: Says whether efforts and multipliers keep their bounds.
        ground: Contacts of unknown force.

    Returns:
        Columns of all joints, of the efforts and of the multipliers, remarks, and what explains
        the motion.

    Raises:
        SolveError: The mechanism cannot be assembled, or the actuators cannot produce the motion;
            names the time.
    """
    contacts = {} if ground is None else {"contacts": ground.contacts, "near": ground.task.near}
    observed = scene.inverse_dynamics(with_bounds=task.bounds, **contacts)
    inverse, states, off = observed.inverse, [], []
    for sample in samples.each():
        t = sample.stamp * NANOSECOND
        measured, given = observed.measured(t, *sample[1:4])
        with _said(where, t):
            x, a = inverse.consistent(measured, given)
        states.append((x, a))
        moves = x.q - measured.q, x.v - measured.v, a - given
        off.append([np.abs(move).max(initial=0.0) for move in moves])
    standing = None
    if ground is not None:
        from mbd_ros.motion.transition import smooth_transitions
        from mbd_ros.motion.unmeasured_contacts import stance_lines, standing_in

        standing = standing_in(inverse, ground, states)

    def solved_at(i: int, wish: "Wish | None" = None) -> Torques:
        here = None if standing is None else standing[i]
        with _said(where, states[i][0].t):
            return inverse.solve(*states[i], [load[i] for load in wrenches], here, wish)

    solved = [solved_at(i) for i in progress(range(len(states)), len(states), "solving")]
    remarks = list(_remarks(np.max(off, axis=0), samples.stamps, solved))
    if ground is not None and standing is not None:
        passed = ""
        if ground.task.method == "smooth":
            passed = smooth_transitions(inverse, states, standing, solved, solved_at)
        remarks += stance_lines(inverse, ground, standing, solved, passed)
    columns = _columns(scene, inverse, states, solved)
    return Way(columns, remarks, _explained(inverse, states, solved))


def _explained(
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    solved: Sequence[Torques],
) -> Explained:
    """Motions with what explains them."""

    def motions() -> Iterator[tuple[State, Array, Exerted]]:
        for (x, a), each in zip(states, solved, strict=True):
            efforts = inverse.columns(x).dot(each.tau)
            yield x, a, Exerted(efforts, inverse.carried(each), each.multipliers)

    return Explained(inverse.constraints, inverse.efforts.names, len(states), motions)


def _columns(
    scene: Scene,
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    solved: Sequence[Torques],
) -> list[Column]:
    """Columns of motions, each with its accelerations, and of what was solved for."""
    q, v, a = (np.array(each) for each in zip(*((x.q, x.v, a) for x, a in states), strict=True))
    joints = scene.robot.joints
    at_q, at_v = [joint.q for joint in joints], [joint.v for joint in joints]
    effort = np.array([each.tau for each in solved])
    showing = _showing(scene, inverse.constraints.parts)
    u = Loads(scene.robot.model.nv, scene.forces, scene.actuators).idle
    shown = [
        showing.at(x, u, a, each.multipliers) for (x, a), each in zip(states, solved, strict=True)
    ]
    driven, free = (
        [scene.robot.joint(name) for name in names]
        for names in (inverse.efforts.names, inverse.carriers)
    )
    carried = np.array([each.carried for each in solved]).reshape(len(solved), -1)
    return [
        *joint_columns(joints, "position", q[:, at_q]),
        *joint_columns(joints, "velocity", v[:, at_v]),
        *joint_columns(joints, "acceleration", a[:, at_v]),
        *joint_columns(driven, "effort", effort),
        *joint_columns(free, "residual", carried),
        *body_columns(scene.robot, whole_bodies(scene.robot, q, v, a)),
        *carried_columns(scene.robot, np.array([each.residual for each in solved])),
        *output_columns(showing.numbers, np.array(shown)),
    ]


@contextmanager
def _said(where: str, t: float) -> Iterator[None]:
    """Errors of a sample name source and time."""
    try:
        yield
    except SolveError as error:
        raise SolveError(f"{where}: at {t:.9g} s: {error}") from error


def topics(scene: Scene, contacts: Collection[str] = ()) -> dict[str, Any]:
    """Topics of a bag, see `files.bags.bag_streams`."""
    rows = scene.closed_loop(contacts=contacts).constraints.rows
    states = state_topics(scene.robot, ("position", "velocity"))
    return {**open_chains.topics(scene), **force_topic(rows), **states}


def _showing(scene: Scene, constraints: Sequence[Constraint]) -> Showing:
    """What parts show of a motion; `constraints` in the order of the multipliers."""
    return Showing(Kinematics(scene.robot), RowLayout(constraints), scene.forces)


def _remarks(off: Array, stamps: np.ndarray, solved: Sequence[Torques]) -> Iterator[str]:
    yield (
        f"moved onto the constraints by at most {off[0]:.3g} rad or m, {off[1]:.3g} per s, "
        f"{off[2]:.3g} per s^2"
    )
    widest = max(solved, key=lambda each: each.null_space)
    if widest.undetermined:
        yield (
            f"null space of dimension {widest.null_space}: {listed(widest.undetermined)} are "
            "not determined, smallest norm taken"
        )
    worst = int(np.argmax([each.condition for each in solved]))
    condition = solved[worst].condition
    if condition > TOGGLE:
        yield (
            f"condition number {condition:.2g} at {stamps[worst] * NANOSECOND:.9g} s: near a "
            "toggle, multipliers are unreliable there"
        )
