"""Tables of marker kinematics: positions of joints, and distances of markers."""

import numpy as np

from mbd_ros.core.kinematics.free_bases import world_pose
from mbd_ros.core.kinematics.poses import with_steady_signs
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.urdf import parse_urdf
from mbd_ros.core.model.urdf_reading import joint_kinds
from mbd_ros.core.state import Array, BodyMotion
from mbd_ros.features.markers.marker_cost import Seen
from mbd_ros.features.markers.marker_fit import Fit
from mbd_ros.features.markers.marker_kinematics import MarkerKinematics
from mbd_ros.files.body_columns import motion_columns
from mbd_ros.files.table import Column, Table
from mbd_ros.files.times import TIME
from mbd_ros.motion.columns import joint_columns
from mbd_ros.scene.built_scene import Scene

RESIDUALS = "residuals"


def sample_table(scene: Scene, times: Array, q: Array) -> Table:
    """Positions of all joints, locked ones too, and poses of free bodies.

    Args:
        scene: The scene.
        times: [s], shape (N,).
        q: Configurations, shape (N, nq).
    """
    robot = scene.robot
    columns = joint_columns(robot.joints, "position", q[:, [joint.q for joint in robot.joints]])
    slides = _locked_slides(robot) if robot.locked else frozenset()
    for name, value in robot.locked.items():
        unit = "m" if name in slides else "rad"
        columns.append(Column(f"{name}.position", np.full(len(times), value), unit))
    for base in robot.bases:
        pose = with_steady_signs(world_pose(robot, q[:, base.q]))
        columns += motion_columns(BodyMotion(base.name, pose, None, None), base.frame)
    return Table([Column(TIME, times, "s"), *columns])


def residual_table(solver: MarkerKinematics, times: Array, fit: Fit, seen: Seen) -> Table:
    """Objective and distance of each marker.

    Args:
        solver: Has the labels.
        times: [s], shape (N,).
        fit: The fit.
        seen: What was seen.
    """
    apart = np.where(seen.weights > 0.0, np.linalg.norm(fit.misses, axis=2), np.nan)
    there = np.isfinite(apart)
    squares, count = np.where(there, apart, 0.0) ** 2, np.maximum(there.sum(axis=1), 1)
    names = [label.replace(".", "_") for label in solver.labels]
    return Table(
        [
            Column(TIME, times, "s"),
            Column("objective", fit.objective, "m^2"),
            Column("remainder", fit.remainder, "rad or m"),
            Column("rms", np.sqrt(squares.sum(axis=1) / count), "m"),
            Column("max", np.where(there, apart, 0.0).max(axis=1, initial=0.0), "m"),
            *(Column(f"{n}.distance", apart[:, i], "m") for i, n in enumerate(names)),
        ]
    )


def _locked_slides(robot: Robot) -> frozenset[str]:
    """Names of locked joints that slide, which the model has no more."""
    found = []
    for recipe in robot.recipes:
        kinds = joint_kinds(parse_urdf(recipe.text, recipe.source, recipe.inertias))
        names = recipe.rename or {}
        found += [
            recipe.scoped(names.get(joint, joint))
            for joint, kind in kinds.items()
            if kind == "prismatic"
        ]
    return frozenset(found)
