"""Joints that a recorded motion lacks, closed by loops."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.inverse_dynamics.loop_motion import LoopMotion, Mask
from mbd_ros.core.kinematics.free_bases import configuration_of
from mbd_ros.core.model.joints import Joint
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NANOSECOND, Array, BodyMotion, Motion, State
from mbd_ros.core.thresholds import FOLD
from mbd_ros.errors import DataError
from mbd_ros.files.recording import Recording
from mbd_ros.jobs.progress import progress
from mbd_ros.scene.built_scene import Scene


def close_loops(scene: Scene, where: str, recording: Recording) -> tuple[Recording, list[str]]:
    """A motion in which the loops have given the independent joints that nobody measured.

    Their branch is that of the initial state of the scene, followed from sample to sample.

    Args:
        scene: The scene; one without loops has all independent joints measured.
        where: Source of the motion, for the messages.
        recording: Motion of the independent, then the dependent joints, NaN where absent.

    Returns:
        The motion, and remarks.

    Raises:
        DataError: The motion lacks a joint that no loop ties to the others.
        SolveError: The initial state cannot be assembled.
    """
    names = scene.couplings.independent
    if not names:
        return recording, []
    position = recording.motion.position[:, : len(names)]
    is_there = np.isfinite(position).any(axis=0)
    if not is_there.any():
        raise DataError(f"{where}: no position of any of {', '.join(names)}")
    whole = np.isfinite(position[:, is_there]).all(axis=1)
    if not whole.any():
        raise DataError(f"{where}: no sample has all of its joints")
    if not whole.all():
        recording.dropped["the position of a joint is missing"] += int((~whole).sum())
    motion = recording.motion if whole.all() else kept_rows(recording.motion, whole)
    if is_there.all():
        return recording._replace(motion=motion), []
    joints = [scene.robot.joint(name) for name in names]
    motion, fold = _completed(scene, where, motion, joints, is_there)
    lacking = [name for name, there in zip(names, is_there, strict=True) if not there]
    said = [f"{name} is reconstructed from the loops" for name in lacking]
    return recording._replace(motion=motion), said + fold


def kept_rows(motion: Motion, rows: Mask | slice) -> Motion:
    """Some samples of a motion."""
    return motion._replace(
        **_rows(motion, rows, {"names", "bodies"}),
        bodies=tuple(body._replace(**_rows(body, rows, {"name"})) for body in motion.bodies),
    )


def _rows(whole: Motion | BodyMotion, rows: Mask | slice, others: set[str]) -> dict[str, Any]:
    """Some rows of all fields but others."""
    fields = whole._asdict().items()
    return {f: None if v is None else v[rows] for f, v in fields if f not in others}


def _completed(
    scene: Scene, where: str, motion: Motion, joints: Sequence[Joint], is_there: Mask
) -> tuple[Motion, list[str]]:
    """The motion with the independent joints that lack in it, and where its loops fold."""
    loops, robot, n = scene.closed_loop().motion, scene.robot, len(joints)
    measured = np.zeros(robot.model.nv, dtype=np.bool_)
    measured[[joint.v for joint, there in zip(joints, is_there, strict=True) if there]] = True
    measured[robot.base_v] = True
    fields, places = _fields(robot, motion, joints)
    turning = [joint.q for joint in joints if joint.kind == "continuous" and measured[joint.v]]
    fields[0][:, turning] = np.unwrap(fields[0][:, turning], axis=0)
    before, conditions = loops.start(scene.initial), []
    rows = zip(motion.stamps.tolist(), *fields, strict=True)
    for i, (stamp, q, v, a) in enumerate(progress(rows, len(motion.stamps), "closing")):
        x, a, condition = loops.complete(before, State(stamp * NANOSECOND, q, v), a, measured)
        if i == 0:
            _check_tied(where, loops, x, measured)
        before = x.q
        conditions.append(condition)
        for field, values in zip(fields, (x.q, x.v, a), strict=True):
            field[i] = values
    dependent = motion.position[:, n:]
    columns = [
        np.concatenate((field[:, at], other), axis=1)
        for field, at, other in zip(
            fields, places, (dependent, *[dependent * np.nan] * 2), strict=True
        )
    ]
    for i, given in ((1, motion.velocity), (2, motion.acceleration)):
        if given is None:
            columns[i] = None
    whole = motion._replace(**dict(zip(motion._fields[2:5], columns, strict=True)))
    return whole, _folds(motion, conditions)


def _fields(
    robot: Robot, motion: Motion, joints: Sequence[Joint]
) -> tuple[tuple[Array, Array, Array], tuple[list[int], ...]]:
    """q, v and a of all coordinates, NaN where unknown, and where the joints stand in them."""
    n, nq, nv = len(motion.stamps), robot.model.nq, robot.model.nv
    q, v, a = np.full((n, nq), np.nan), np.full((n, nv), np.nan), np.full((n, nv), np.nan)
    at_q, at_v = [joint.q for joint in joints], [joint.v for joint in joints]
    for field, at, values in zip((q, v, a), (at_q, at_v, at_v), motion[2:5], strict=True):
        if values is not None:
            field[:, at] = values[:, : len(joints)]
    for base, body in zip(robot.bases, motion.bodies, strict=True):
        q[:, base.q] = configuration_of(robot, body.pose)
        for field, values in ((v, body.twist), (a, body.acceleration)):
            if values is not None:
                field[:, base.v] = values
    return (q, v, a), (at_q, at_v, at_v)


def _folds(motion: Motion, conditions: Sequence[float]) -> list[str]:
    worst = int(np.argmax(conditions))
    if conditions[worst] <= FOLD:
        return []
    return [
        f"the loops fold near {motion.stamps[worst] * NANOSECOND:.9g} s (condition number "
        f"{conditions[worst]:.2g}): from there on what is reconstructed may be on another branch; "
        "another joint should be measured"
    ]


def _check_tied(where: str, loops: LoopMotion, x: State, measured: Mask) -> None:
    loose = loops.undetermined(x, measured)
    if loose:
        raise DataError(
            f"{where}: no position of {', '.join(loose)}, and no loop gives it from the joints "
            "that are there"
        )
