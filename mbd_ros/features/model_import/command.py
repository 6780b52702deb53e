"""The commands `mbd-ros import-opensim` and `import-mjcf`: a model as a URDF and a scene."""

import argparse
from pathlib import Path

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import say_all
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of both commands."""
    parser.add_argument(
        "model", type=path_word, help="Model of OpenSim (.osim, .osim.gz) or of MuJoCo (.xml)."
    )
    parser.add_argument(
        "-o",
        "--output",
        type=path_word,
        default=Path(),
        metavar="DIR",
        help="Folder for <name>.urdf, <name>.yaml and <name>.left_out.txt. By default it is the "
        "current folder.",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files, print what they leave out of the model, and return the exit code."""
    from mbd_ros.features.model_import.job import import_opensim

    with about(arguments.model):
        say_all(import_opensim(arguments.model, arguments.output))
    return OK
