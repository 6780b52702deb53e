"""Commands `mbd-ros import-opensim` and `import-mjcf`: a model as a description and a scene."""

import argparse
from pathlib import Path

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import say_all
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that both understand."""
    parser.add_argument("model", type=path_word, help="MODEL.osim, MODEL.osim.gz or MODEL.xml")
    parser.add_argument(
        "-o",
        "--output",
        type=path_word,
        default=Path(),
        metavar="DIR",
        help="folder for <name>.urdf, <name>.yaml and <name>.left_out.txt; default: this one",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files and say what was left out; the exit code."""
    from mbd_ros.features.model_import.job import import_opensim

    with about(arguments.model):
        say_all(import_opensim(arguments.model, arguments.output))
    return OK
