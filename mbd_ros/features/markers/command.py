"""The command `mbd-ros kinematics`: joint positions from recorded markers."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_options
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_JOB = "mbd_ros.features.markers.job:kinematics"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `kinematics`."""
    add_scene(parser)
    parser.add_argument(
        "markers", type=path_word, help="Recorded markers: .trc, .c3d, CSV, .npz or .parquet."
    )
    parser.add_argument(
        "task",
        type=path_word,
        nargs="?",
        help="Task file with a section kinematics, or a setup file of OpenSim's inverse "
        "kinematics (.xml).",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="Motion as .mot, CSV, .npz or .parquet (required).",
    )
    parser.add_argument(
        "--residuals",
        type=path_word,
        help="Also write the objective and the distances of the markers into this table.",
    )
    add_options(parser, _JOB, "begin", "end", "unit", "axes", "smoothness")
    parser.add_argument(
        "--no-limits",
        action="store_true",
        help="Let joints pass the limits of their description.",
    )


def run(arguments: argparse.Namespace) -> int:
    """Fit the motion, write it and return the exit code."""
    from mbd_ros.features.markers.job import kinematics_to
    from mbd_ros.features.markers.marker_kinematics import NO_TASK
    from mbd_ros.scene.reader import load_scene

    names = ("begin", "end", "unit", "axes", "smoothness")
    options = {name: getattr(arguments, name) for name in names}
    if arguments.no_limits:
        options["limits"] = False
    kinematics_to(
        load_scene(arguments.scene),
        arguments.markers,
        arguments.out,
        arguments.residuals,
        say,
        task=arguments.task or NO_TASK,
        **options,
    )
    return OK
