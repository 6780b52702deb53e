"""Words of `mbd-ros follow`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `follow` understands."""
    add_scene(parser)
    parser.add_argument(
        "motion",
        type=path_word,
        help="result or table with positions, velocities, and efforts or commands of actuators",
    )
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help=".npz or .parquet (required)"
    )
    parser.add_argument(
        "--position",
        type=float,
        default=0.1,
        help="tolerated deviation of positions, rad or m (default: %(default)s)",
    )
    parser.add_argument(
        "--velocity",
        type=float,
        default=1.0,
        help="of velocities, rad/s or m/s (default: %(default)s)",
    )
    parser.add_argument(
        "--effort",
        type=float,
        help="of efforts, N·m or N (default: the limit of each input, or its largest; less beside "
        "held contacts)",
    )
    parser.add_argument(
        "--tube",
        type=int,
        default=48,
        help="random disturbances that test how far a motion may be off; 0: none "
        "(default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.control.job import follow_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    options = {name: getattr(arguments, name) for name in _OPTIONS}
    follow_to(scene, arguments.motion, arguments.out, options, say)
    return OK


_OPTIONS = ("position", "velocity", "effort", "tube")
