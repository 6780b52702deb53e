"""Words of `mbd-ros loads`."""

import argparse
from typing import TYPE_CHECKING

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.motion.options import (
    add_derivatives,
    add_stance,
    add_time_range,
    add_wrench_axes,
)
from mbd_ros.scene.schema.locate import path_word

if TYPE_CHECKING:
    from mbd_ros.features.loads.fem.finite_elements import MeshTask


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `loads` understands."""
    add_scene(parser)
    parser.add_argument("motion", type=path_word, help="as for `inverse`")
    _add_body(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet or .sto; with --mesh .inp (CalculiX, Abaqus), .feb "
        "(FEBio) or .vtu (a series for ParaView) (required)",
    )
    _add_mesh(parser)
    parser.add_argument("--wrenches", type=path_word, help="as for `inverse`")
    parser.add_argument("--external", type=path_word, help="external loads of OpenSim (.xml)")
    parser.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of a bag (default: %(default)s)",
    )
    parser.add_argument(
        "--bounds",
        action="store_true",
        help="efforts within the limits of actuators, stops and friction within their laws",
    )
    add_time_range(parser)
    add_wrench_axes(parser)
    add_derivatives(parser)
    add_stance(parser)


def _add_body(parser: argparse.ArgumentParser) -> None:
    """Which body, and what is known of it."""
    parser.add_argument(
        "--body",
        required=True,
        help="link whose loads are wanted, with all that fixed joints tie to it (required)",
    )
    parser.add_argument(
        "--joint",
        nargs="+",
        default=(),
        help="fixed joints at which the body ends too; it always ends at those that move",
    )
    parser.add_argument(
        "--muscle-forces",
        type=path_word,
        help="table with <muscle>.force or .tension [N] (default: those of the motion)",
    )
    parser.add_argument(
        "--at", type=float, nargs="+", default=(), help="instants to mark beside the peaks [s]"
    )
    parser.add_argument(
        "--units",
        choices=("m", "mm"),
        default="m",
        help="m: N, m, kg, s, Pa; mm: N, mm, t, s, MPa (default: %(default)s)",
    )


def _add_mesh(parser: argparse.ArgumentParser) -> None:
    """The solid that takes the loads; lengths, stresses and densities in --units."""
    parser.add_argument(
        "--mesh", type=path_word, help="solid elements, such as .msh, .vtu or .inp (extra fem)"
    )
    parser.add_argument(
        "--mesh-pose",
        type=float,
        nargs=6,
        default=(),
        metavar=("X", "Y", "Z", "ROLL", "PITCH", "YAW"),
        help="axes of the mesh in those of the link (default: the same)",
    )
    parser.add_argument(
        "--attach",
        nargs="+",
        default=(),
        metavar="LOAD=NODES",
        help="nodes of a load: the name of a set, or a radius about its point",
    )
    parser.add_argument("--radius", type=float, help="of loads that --attach does not name")
    parser.add_argument("--support", help="load whose nodes are held (default: the first)")
    parser.add_argument(
        "--coupling",
        choices=("rigid", "distributing"),
        default="rigid",
        help="how nodes share a load (default: %(default)s)",
    )
    parser.add_argument(
        "--amplitudes",
        action="store_true",
        help=".inp: one step over the whole motion in place of one for each instant",
    )
    parser.add_argument("--young", type=float, help="Young's modulus; required with --mesh")
    parser.add_argument(
        "--poisson", type=float, default=0.3, help="Poisson's ratio (default: %(default)s)"
    )
    parser.add_argument(
        "--density", type=float, help="default: that which gives the mesh the mass of the body"
    )


def _mesh_task(arguments: argparse.Namespace) -> "MeshTask | None":
    """What is asked of the mesh; None without one."""
    if arguments.mesh is None:
        return None
    from mbd_ros.errors import DataError
    from mbd_ros.features.loads.fem.finite_elements import MeshTask

    if arguments.young is None:
        raise DataError("--mesh goes with --young, in Pa, or in MPa with --units mm")
    pairs = [word.partition("=") for word in arguments.attach]
    for name, equals, nodes in pairs:
        if not (name and equals and nodes):
            raise DataError(f"--attach {name}: accepted: LOAD=SET or LOAD=RADIUS")
    names = ("young", "poisson", "density", "radius", "support", "coupling", "amplitudes")
    given = {name: getattr(arguments, name) for name in names}
    attach = {name: nodes for name, _, nodes in pairs}
    return MeshTask(arguments.mesh, pose=arguments.mesh_pose, attach=attach, **given)


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.loads.job import LoadsTask, loads_to
    from mbd_ros.motion.derivatives import Derivatives
    from mbd_ros.motion.samples import Task
    from mbd_ros.motion.stance import stance_of
    from mbd_ros.scene.reader import load_scene

    given = arguments
    between = None if given.time_range is None else tuple(given.time_range)
    motion = Task(
        given.motion,
        Derivatives(given.derivatives, given.cutoff, given.half_width),
        given.wrenches,
        given.topic,
        bounds=given.bounds,
        external=given.external,
        time_range=between,
        stance=stance_of(given.stance, given.stance_gap, given.stance_speed),
        wrench_axes=given.wrench_axes,
    )
    words = given.body, given.joint, given.muscle_forces, given.at, given.units
    task = LoadsTask(motion, *words, _mesh_task(given))
    loads_to(load_scene(given.scene), task, given.out, say)
    return OK
