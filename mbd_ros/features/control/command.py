"""The command `mbd-ros follow`: feedback gains that hold a robot on a motion."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_options
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_JOB = "mbd_ros.features.control.job:follow"
_OPTIONS = ("position", "velocity", "effort", "tube")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `follow`."""
    add_scene(parser)
    parser.add_argument(
        "motion",
        type=path_word,
        help="Result or table with positions, velocities, and efforts or commands of actuators.",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help=".npz or .parquet for the motion and its gains (required).",
    )
    add_options(parser, _JOB, *_OPTIONS)


def run(arguments: argparse.Namespace) -> int:
    """Compute the gains, write them and return the exit code."""
    from mbd_ros.features.control.job import follow_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    options = {name: getattr(arguments, name) for name in _OPTIONS}
    follow_to(scene, arguments.motion, arguments.out, options, say)
    return OK
