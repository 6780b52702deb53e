"""Command line of `mbd-ros excite`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, add_options
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_JOB = "mbd_ros.features.identification.excite.job:excite"
_FILES = "mbd_ros.features.identification.excite.trajectory_files:excite_to"
_OPTIONS = ("period", "harmonics", "share", "evaluations", "seed")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `excite` to a parser."""
    add_scene(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="Folder for the trajectory (required)."
    )
    add_options(parser, _JOB, *_OPTIONS)
    add_option(parser, _FILES, "rate")


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.identification.excite.trajectory_files import excite_to
    from mbd_ros.scene.reader import load_scene

    options = {name: getattr(arguments, name) for name in _OPTIONS}
    scene = load_scene(arguments.scene)
    excite_to(scene, arguments.out, options, say, rate=arguments.rate)
    return OK
