"""A motion to look at: states of all joints, and the columns that came with them."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError
from mbd_ros.motion.recordings import Source, name_of, read_columns, read_motion
from mbd_ros.scene.built_scene import Scene

BALANCE = ("energy", "drift.position", "drift.velocity")
_MOST = 200_000  # samples


class ViewedMotion(NamedTuple):
    """States over time.

    Attributes:
        times: From the first sample on [s], shape (n,).
        states: Of all joints, one a sample.
        accelerations: Of all joints, 0 where unknown, shape (n, nv).
        efforts: Measured or computed effort of each joint, NaN where unknown, shape (n, joints).
        multipliers: Of all rows, shape (n, m); None where the source does not give them all.
        balance: Columns of `BALANCE`, NaN where the source has none, shape (n, 3).
        remarks: What people should know.
    """

    times: Array
    states: list[State]
    accelerations: Array
    efforts: Array
    multipliers: Array | None
    balance: Array
    remarks: tuple[str, ...]


def viewed_motion(
    scene: Scene, source: Source, rows: tuple[str, ...], topic: str = "/joint_states"
) -> ViewedMotion:
    """Read a motion for a scene; dependent joints follow their couplings.

    Args:
        source: Result, file or bag.
        rows: Names of the columns of all multipliers.
        topic: JointState topic of a bag.

    Raises:
        DataError: A file that cannot be read, or without a position of an independent joint.
    """
    robot = scene.robot
    motion = read_motion(
        source,
        [joint.name for joint in robot.joints],
        topic=topic,
        required=scene.couplings.independent,
        bodies={base.name: base.frame for base in robot.bases},
        members=robot.members,
        sliding=robot.prismatic_joints,
    ).motion
    count = len(motion.stamps)
    if not 0 < count <= _MOST:
        raise DataError(f"{name_of(source)}: {count} samples, accepted are 1 .. {_MOST}")
    q, v, a = (np.zeros((n, count)) for n in (robot.model.nq, robot.model.nv, robot.model.nv))
    q[:] = robot.neutral()[:, None]
    for target, values, entries in (
        (q, motion.position, [joint.q for joint in robot.joints]),
        (v, motion.velocity, [joint.v for joint in robot.joints]),
        (a, motion.acceleration, [joint.v for joint in robot.joints]),
    ):
        if values is not None:
            target[entries] = np.nan_to_num(values.T)
    scene.couplings.expand(q, v, a)
    for base, body in zip(robot.bases, motion.bodies, strict=True):
        q[base.q] = configuration_of(robot, body.pose).T
        v[base.v] = 0.0 if body.twist is None else np.nan_to_num(body.twist).T
    efforts = np.full((count, len(robot.joints)), np.nan)
    if motion.effort is not None:
        efforts[:] = motion.effort
    times = (motion.stamps - motion.stamps[0]) * NANOSECOND
    z = _internal_states(scene, source, count)
    states = [State(float(t), *each) for t, *each in zip(times, q.T, v.T, z, strict=True)]
    multipliers = _multipliers(source, rows, count)
    lacking = ["no multipliers in the motion: no forces of constraints"] * (multipliers is None)
    balance = read_columns(source, BALANCE)
    if balance is None or len(balance) != count:
        balance = np.full((count, len(BALANCE)), np.nan)
    return ViewedMotion(times, states, a.T, efforts, multipliers, balance, tuple(lacking))


def still(scene: Scene) -> ViewedMotion:
    """The first state of a scene alone."""
    nv, joints = scene.robot.model.nv, len(scene.robot.joints)
    x = scene.initial._replace(t=0.0)
    x = x._replace(z=np.nan_to_num(x.z))
    efforts, balance = np.full((1, joints), np.nan), np.full((1, len(BALANCE)), np.nan)
    return ViewedMotion(np.zeros(1), [x], np.zeros((1, nv)), efforts, None, balance, ())


def _internal_states(scene: Scene, source: Source, count: int) -> Array:
    first = np.nan_to_num(scene.initial.z)
    columns = read_columns(source, scene.internals.names)
    if columns is None:
        return np.tile(first, (count, 1))
    return np.where(np.isnan(columns), first, columns)


def _multipliers(source: Source, rows: tuple[str, ...], count: int) -> Array | None:
    if not rows:
        return np.zeros((count, 0))
    columns = read_columns(source, rows)
    if columns is None or len(columns) != count or np.isnan(columns).any():
        return None
    return columns
