"""Words of `mbd-ros loads`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.inverse.command import (
    add_derivatives,
    add_stance,
    add_time_range,
    add_wrench_axes,
)
from mbd_ros.jobs.lines import say
from mbd_ros.scene.locate import path_word


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
        help="CSV (.gz), .npz, .parquet or .sto (required)",
    )
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


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.jobs.inverse.derivatives import Derivatives
    from mbd_ros.jobs.inverse.job import stance_of
    from mbd_ros.jobs.inverse.observed import Task
    from mbd_ros.jobs.loads.job import LoadsTask, loads_to
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
    task = LoadsTask(motion, given.body, given.joint, given.muscle_forces, given.at, given.units)
    loads_to(load_scene(given.scene), task, given.out, say)
    return OK
