"""Feedback gains that hold a robot on a motion: `mbd-ros follow`."""

from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import NANOSECOND
from mbd_ros.errors import DataError
from mbd_ros.features.control.regulator import Tolerated, check_scene, read_reference, regulate
from mbd_ros.features.control.tracking_tube import tube_level
from mbd_ros.files.plan import PLAN, plan_table, plan_words
from mbd_ros.files.table import MAIN, Result, Table, time_columns
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.control.tracking_plan import TrackingPlan
from mbd_ros.motion.columns import joint_columns
from mbd_ros.motion.recordings import Source, metadata_of, name_of
from mbd_ros.scene.built_scene import Scene

_MOST_DISTURBANCES = 100_000


def follow(
    scene: Scene,
    motion: Source,
    *,
    position: float = 0.1,
    velocity: float = 1.0,
    effort: float | None = None,
    tube: int = 48,
    watch: Watch = False,
) -> Result:
    """Compute a time-varying linear quadratic regulator that returns a robot to a motion.

    The cost is the integral of |e_q / position|² + |e_v / velocity|² + |du / effort|² along the
    motion. Where the last state can be held, its cost from then on is added.

    Args:
        scene: A scene whose actuators take the torque of their joint.
        motion: Result or file with positions, velocities, and efforts or commands of actuators.
        position: Tolerated deviation of positions [rad or m].
        velocity: Tolerated deviation of velocities [rad/s or m/s].
        effort: Tolerated deviation of efforts [N·m or N]. By default the limit of each input, or
            its largest value in the motion; but at most a twentieth of what makes a closed
            contact slip or lift.
        tube: Number of random disturbances that test how far the motion may be off; 0 for none.
        watch: True for a line on a terminal, or a function of a label and a share.

    Returns:
        Table `samples` with the motion, and table `plan` with the gains.

    Raises:
        DataError: The motion lacks a column, or the scene cannot be followed.
    """
    tolerated = _check(Tolerated(position, velocity, effort))
    if not 0 <= tube <= _MOST_DISTURBANCES:
        raise DataError(f"tube: {tube} disturbances, accepted are 0 .. {_MOST_DISTURBANCES}")
    check_scene(scene)
    with about(name_of(motion)), watching(watch):
        regulated = regulate(scene, read_reference(scene, motion), tolerated)
        plan = regulated.plan
        if tube:
            level = tube_level(
                regulated.disturbed,
                plan,
                regulated.widest,
                regulated.fastest,
                rests=regulated.rests,
                count=tube,
                with_progress=lambda i: progress(i, tube, "tube"),
            )
            plan = plan.with_level(level)
    inputs = {"motion": motion, **tolerated._asdict()}
    metadata = {**metadata_of("follow", scene, inputs, {}), PLAN: plan_words(plan)}
    return Result({MAIN: _motion_table(scene, plan), PLAN: plan_table(plan)}, metadata)


def follow_to(scene: Scene, motion: Path, out: Path, options: dict[str, Any], say: Say) -> None:
    """Read a motion, and write the plan with its gains."""
    refuse_overwriting(out, motion)
    check_place(out)
    result = follow(scene, motion, **options, watch=True)
    result.to(out, among=(".npz", ".parquet"))
    description = result.metadata[PLAN]
    say(f"{result[PLAN].rows} samples, gains of {', '.join(description['inputs'])} -> {out}")
    say(_tube_line(description["level"], result, options.get("tube", 48)))


def _tube_line(level: float, result: Result, count: int) -> str:
    if not count:
        return "tube: not computed"
    if not level:
        return "tube: none, no disturbance returns"
    cost = result[PLAN]["cost"]
    d = cost.shape[1] // 2
    reach = np.sqrt(level / np.linalg.eigvalsh(cost[:, :d, :d])[:, -1].max())
    return f"tube: cost to go below {level:.6g}, such as positions that are off by {reach:.3g}"


def _check(tolerated: Tolerated) -> Tolerated:
    for name, value in tolerated._asdict().items():
        if value is not None and not 0.0 < value < np.inf:
            raise DataError(f"{name}: {value:g} must be finite and > 0")
    return tolerated


def _motion_table(scene: Scene, plan: TrackingPlan) -> Table:
    joints = [scene.robot.joint(name) for name in plan.joints]
    driven = [scene.robot.joint(name) for name in plan.inputs]
    stamps = np.round(plan.times / NANOSECOND).astype(np.int64)
    columns = [*time_columns(stamps), *joint_columns(joints, "position", plan.q)]
    columns += joint_columns(joints, "velocity", plan.v)
    return Table([*columns, *joint_columns(driven, "effort", plan.u)])
