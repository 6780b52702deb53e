"""The command `mbd-ros scale`: a scene that is scaled to a person."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `scale`."""
    add_scene(parser)
    parser.add_argument(
        "static", type=path_word, help="Recorded markers of a person who stands still."
    )
    parser.add_argument("task", type=path_word, help="Task file with a section scale.")
    parser.add_argument(
        "-o",
        "--out",
        type=path_word,
        required=True,
        help="Folder for the URDF and the scene file (required).",
    )


def run(arguments: argparse.Namespace) -> int:
    """Scale the scene, write it and return the exit code."""
    from mbd_ros.features.markers.scale.job import scale_to
    from mbd_ros.scene.reader import load_scene

    scene = load_scene(arguments.scene)
    scale_to(scene, arguments.static, arguments.task, arguments.out, say)
    return OK
