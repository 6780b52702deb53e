"""Lengths, speeds and moment arms of paths in a recorded motion: `mbd-ros moment-arms`."""

from pathlib import Path as File

import numpy as np

from mbd_ros.core.kinematics.paths.paths import Path, PathBatch, PathSamples
from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.files.table import MAIN, Column, Result, Table, time_columns
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.columns import joint_columns
from mbd_ros.motion.derivatives import Derivatives, differentiate
from mbd_ros.motion.recordings import Source, metadata_of, name_of, read_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.path_search import QuickestSearch

_ROUNDING = 1.0e-12  # m or -, arms of joints that do not change a path


def moment_arms(scene: Scene, motion: Source, *, topic: str = "/joint_states") -> Result:
    """Compute lengths, speeds and moment arms of all paths of a scene in a motion.

    The moment arm about an independent coordinate q is -dl/dq, with the other independent
    coordinates fixed and dependent joints following: the effort of a tension of 1 N.

    Args:
        scene: A scene with paths.
        motion: Result, file or bag with the positions of its joints.
        topic: JointState topic of a bag.

    Returns:
        Table `samples`: `time`, `<joint>.position`; `<path>.length`, `.speed` if the motion has
        velocities, and the moment arms `<path>.<joint>`, without those that are always 0. The
        path of a muscle has the name of the muscle.

    Raises:
        DataError: A file cannot be read or does not fit the scene.
        SolveError: A geodesic over a surface is not samples_of_paths.
    """
    paths = _named(scene)
    if not paths:
        raise DataError(f"{scene.name}: has no paths; add the section paths or muscles")
    where = name_of(motion)
    recorded = _recorded(scene, motion, topic)
    complete, has_speeds = _complete(recorded)
    samples = differentiate(scene, where, complete, Derivatives("given")).samples
    at, y = IndependentCoordinates(scene.robot, scene.couplings), samples[1].copy()
    y[:, at.joint_y] = recorded.position[:, : len(at.joint_y)]  # functions of angles as recorded
    batch = PathBatch(scene.robot, scene.couplings, paths, QuickestSearch())
    with about(where):
        samples_of_paths = batch.evaluate(y, samples[2] if has_speeds else None)
    joints = [scene.robot.joint(name) for name in scene.couplings.independent]
    columns = [*time_columns(samples.stamps)]
    columns += joint_columns(joints, "position", y[:, at.joint_y])
    arms = samples_of_paths.arms[:, :, at.joint_w]
    for i, name in enumerate(batch.names):
        columns += _columns(name, i, samples_of_paths, has_speeds)
        for joint, arm in zip(joints, arms[:, i].T, strict=True):
            if np.abs(arm).max() > _ROUNDING:
                unit = "-" if joint.kind == "prismatic" else "m"
                columns.append(Column(f"{name}.{joint.name}", np.array(arm), unit))
    about_it = metadata_of("moment-arms", scene, {"motion": motion, "topic": topic}, {})
    return Result({MAIN: Table(columns)}, about_it)


def moment_arms_to(scene: Scene, motion: File, out: File, topic: str, say: Say) -> None:
    """Read a motion, and write lengths, speeds and moment arms.

    Args:
        motion: Table or bag with the motion.
        out: Path whose suffix chooses the format.
        topic: JointState topic of a bag.
        say: Called with each line for people.
    """
    refuse_overwriting(out, motion)
    check_place(out)
    result = moment_arms(scene, motion, topic=topic)
    result.to(out)
    say(f"{result[MAIN].rows} samples of {len(_named(scene))} paths -> {out}")


def _named(scene: Scene) -> dict[str, Path]:
    """Return the paths of the scene and of its muscles, by the names of their columns."""
    by_muscle = {id(muscle.path): muscle.name for muscle in scene.muscles}
    paths = {by_muscle.get(id(p), name): p for name, p in scene.parts.get("paths", {}).items()}
    known = {id(path) for path in paths.values()}
    unnamed = [muscle for muscle in scene.muscles if id(muscle.path) not in known]
    return paths | {muscle.name: muscle.path for muscle in unnamed}


def _columns(name: str, i: int, samples: PathSamples, has_speeds: bool) -> list[Column]:
    columns = [Column(f"{name}.length", np.array(samples.lengths[:, i]), "m")]
    if has_speeds:
        columns.append(Column(f"{name}.speed", np.array(samples.speeds[:, i]), "m/s"))
    return columns


def _recorded(scene: Scene, motion: Source, topic: str) -> Motion:
    robot, names = scene.robot, scene.couplings.independent
    recording = read_motion(
        motion,
        names,
        topic=topic,
        required=names,
        bodies={base.name: base.frame for base in robot.bases},
        members=robot.members,
        sliding=robot.prismatic_joints,
        assumed=lambda name: float(scene.initial.q[robot.joint(name).q]),
    )
    return recording.motion


def _complete(motion: Motion) -> tuple[Motion, bool]:
    """Fill missing values of the motion with zeros; also return whether it has velocities."""
    has_speeds = motion.velocity is not None and not np.isnan(motion.velocity).any()
    still: Array = np.zeros(motion.position.shape)
    bodies = []
    for body in motion.bodies:
        has_speeds &= body.twist is not None
        zero = np.zeros((len(motion.stamps), 6))
        twist = zero if body.twist is None else body.twist
        bodies.append(body._replace(twist=twist, acceleration=zero))
    velocity = motion.velocity if has_speeds else still
    complete = motion._replace(velocity=velocity, acceleration=still, bodies=tuple(bodies))
    return complete, has_speeds
