"""The command `mbd-ros moment-arms`: lengths, speeds and moment arms of paths."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.motion.options import MOTION, add_topic
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `moment-arms`."""
    add_scene(parser)
    parser.add_argument("motion", type=path_word, help=f"{MOTION} Speeds need its velocities.")
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="CSV (.gz), .npz, .parquet or .sto for the result (required).",
    )
    add_topic(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compute the moment arms, write them and return the exit code."""
    from mbd_ros.features.muscles.moment_arms.job import moment_arms_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    moment_arms_to(scene, arguments.motion, arguments.out, arguments.topic, say)
    return OK
