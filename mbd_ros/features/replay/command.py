"""The command `mbd-ros replay`: a bag through the live node, with a table of errors."""

import argparse

from mbd_ros.errors import FAILED, OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.options import add_option, add_options
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word

_ORDER = "mbd_ros.features.replay.job:Replay"
_JOB = "mbd_ros.features.replay.job:replay"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `replay`."""
    add_option(parser, _ORDER, "bag", "bag")
    add_scene(parser)
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="Bag for the node's output (required)."
    )
    add_option(parser, _ORDER, "rate")
    add_options(parser, _JOB, "reference", "skip")
    add_options(parser, _ORDER, "cutoff", "topic")


def run(arguments: argparse.Namespace) -> int:
    """Play the bag, print the errors and return the exit code."""
    from mbd_ros.features.replay.job import Replay, replay

    names = ("bag", "scene", "out", "rate", "topic", "cutoff")
    order = Replay(**{name: getattr(arguments, name) for name in names})
    result = replay(order, arguments.reference, arguments.skip, say=say)
    return OK if result.metadata["answered"] == result.metadata["played"] else FAILED
