"""The command `mbd-ros loads`: loads on one body of a recorded motion."""

import argparse
from typing import TYPE_CHECKING

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, add_options
from mbd_ros.jobs.progress import say
from mbd_ros.motion.options import (
    MOTION,
    add_bounds,
    add_derivatives,
    add_external,
    add_stance,
    add_time_range,
    add_topic,
    add_wrench_axes,
    add_wrenches,
)
from mbd_ros.scene.schema.locate import path_word

if TYPE_CHECKING:
    from mbd_ros.features.loads.fem.finite_elements import MeshTask

_LOADS = "mbd_ros.features.loads.job:LoadsTask"
_MESH = "mbd_ros.features.loads.fem.finite_elements:MeshTask"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `loads`."""
    add_scene(parser)
    parser.add_argument("motion", type=path_word, help=MOTION)
    _add_body(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet or .sto; with --mesh .inp (CalculiX, Abaqus), .feb "
        "(FEBio) or .vtu (a series for ParaView) (required).",
    )
    _add_mesh(parser)
    add_wrenches(parser)
    add_external(parser)
    add_topic(parser)
    add_bounds(parser)
    add_time_range(parser)
    add_wrench_axes(parser)
    add_derivatives(parser)
    add_stance(parser)


def _add_body(parser: argparse.ArgumentParser) -> None:
    """Declare the body and what is known of it."""
    add_option(parser, _LOADS, "body", required=True)
    add_option(parser, _LOADS, "joints", "--joint", dest="joint")
    add_options(parser, _LOADS, "muscle_forces", "at", "units")


def _add_mesh(parser: argparse.ArgumentParser) -> None:
    """Declare the solid that takes the loads; lengths, stresses and densities are in --units."""
    add_option(parser, _MESH, "mesh")
    axes = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")
    add_option(parser, _MESH, "pose", "--mesh-pose", dest="mesh_pose", nargs=6, metavar=axes)
    add_option(parser, _MESH, "attach", nargs="+", default=(), type=str, metavar="LOAD=NODES")
    add_options(parser, _MESH, "radius", "support", "coupling", "amplitudes")
    add_options(parser, _MESH, "young", "poisson", "density")


def _mesh_task(arguments: argparse.Namespace) -> "MeshTask | None":
    """Return the mesh and its material; None if the command names no mesh."""
    if arguments.mesh is None:
        return None
    from mbd_ros.errors import DataError
    from mbd_ros.features.loads.fem.finite_elements import MeshTask

    if arguments.young is None:
        raise DataError("--mesh goes with --young, in Pa, or in MPa with --units mm")
    pairs = [text.partition("=") for text in arguments.attach]
    for name, equals, nodes in pairs:
        if not (name and equals and nodes):
            raise DataError(f"--attach {name}: accepted: LOAD=SET or LOAD=RADIUS")
    names = ("young", "poisson", "density", "radius", "support", "coupling", "amplitudes")
    options = {name: getattr(arguments, name) for name in names}
    attach = {name: nodes for name, _, nodes in pairs}
    return MeshTask(arguments.mesh, pose=arguments.mesh_pose, attach=attach, **options)


def run(arguments: argparse.Namespace) -> int:
    """Compute the loads, write them and return the exit code."""
    from mbd_ros.features.loads.job import LoadsTask, loads_to
    from mbd_ros.motion.derivatives import Derivatives
    from mbd_ros.motion.samples import Task
    from mbd_ros.motion.stance import stance_of
    from mbd_ros.scene.reader import load_scene

    time_range = arguments.time_range
    motion = Task(
        arguments.motion,
        Derivatives(arguments.derivatives, arguments.cutoff, arguments.half_width),
        arguments.wrenches,
        arguments.topic,
        bounds=arguments.bounds,
        external=arguments.external,
        time_range=None if time_range is None else tuple(time_range),
        stance=stance_of(arguments.stance, arguments.stance_gap, arguments.stance_speed),
        wrench_axes=arguments.wrench_axes,
    )
    task = LoadsTask(
        motion,
        arguments.body,
        arguments.joint,
        arguments.muscle_forces,
        arguments.at,
        arguments.units,
        _mesh_task(arguments),
    )
    loads_to(load_scene(arguments.scene), task, arguments.out, say)
    return OK
