"""Words of `mbd-ros moment-arms`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `moment-arms` understands."""
    add_scene(parser)
    parser.add_argument(
        "motion", type=path_word, help="as for `inverse`; without velocities no speeds are given"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet or .sto (required)",
    )
    parser.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of a bag (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.muscles.moment_arms.job import moment_arms_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    moment_arms_to(scene, arguments.motion, arguments.out, arguments.topic, say)
    return OK
